"""
How probability moves in one step: the Dirac-Feynman kernels, as operators with ``@``.

A kernel is an operator K with K[j, i] the probability that cell i moves to cell j in one step:
densities move as K @ p, and a column sums to 1, less what leaves the grid.
"""

from pif_ros.core.kernels.formula import log_transition_density
from pif_ros.core.kernels.operators import kernel_of, Operator, operator_of, OperatorSettings
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.kernels.tabulated import dirac_feynman, stored_elements

__all__ = ['KernelSettings', 'Operator', 'OperatorSettings', 'dirac_feynman', 'kernel_of',
           'log_transition_density', 'operator_of', 'stored_elements']
