"""
How probability moves in one step: the Dirac-Feynman kernels, as operators with ``@``.

A kernel is an operator K with K[j, i] the probability that cell i moves to cell j in one step:
densities move as K @ p, and a column sums to 1, less what leaves the grid.
"""

from pif_ros.core.kernels.forms import (chosen_form, longer_kernel, step_kernel, step_remarks,
                                        stored_weights)
from pif_ros.core.kernels.formula import log_transition_density
from pif_ros.core.kernels.ladder import ladder, turned
from pif_ros.core.kernels.loops import warm_up as compile_loops
from pif_ros.core.kernels.operators import kernel_of, Operator, operator_of, OperatorSettings
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.kernels.split import split_kernel, SplitKernel
from pif_ros.core.kernels.tabulated import dirac_feynman, stored_elements

__all__ = ['KernelSettings', 'Operator', 'OperatorSettings', 'SplitKernel', 'chosen_form',
           'compile_loops', 'dirac_feynman', 'kernel_of', 'ladder', 'log_transition_density',
           'longer_kernel', 'operator_of', 'split_kernel', 'step_kernel', 'step_remarks',
           'stored_elements', 'stored_weights', 'turned']
