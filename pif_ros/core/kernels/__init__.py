"""
How probability moves in one step: the Dirac-Feynman kernels, as operators with ``@``.

A kernel is an operator K with K[j, i] the probability that cell i moves to cell j in one step:
densities move as K @ p, and a column sums to 1, less what leaves the grid.
"""

from pif_ros.core.kernels.formula import KernelSettings, log_transition_density
from pif_ros.core.kernels.tabulated import dirac_feynman, stored_elements

__all__ = ['KernelSettings', 'dirac_feynman', 'log_transition_density', 'stored_elements']
