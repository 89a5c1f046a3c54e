"""
Whole paths drawn from the exponential of minus the action of states and measurements.

[TM, section 9.2], for smoothing, and for states too many for a grid.  The sampler is one of our
own.  What is drawn is a path, and that a general sampler does not know: here its precision is a
band, so that preconditioned moves cost no more than the path is long; hundreds of chains move at
once as one array, with the model's own functions and no second, differentiable, model; and what a
gradient cannot do, to change between humps of the posterior (signs that no sensor sees), a
particle filter that is conditioned on the path does.
"""

from pif_ros.core.path_monte_carlo.diagnostics import effective_sample_size, split_r_hat
from pif_ros.core.path_monte_carlo.posterior import PathPosterior
from pif_ros.core.path_monte_carlo.sampler import PathSample, sample
from pif_ros.core.path_monte_carlo.settings import SamplerSettings

__all__ = ['effective_sample_size', 'PathPosterior', 'PathSample', 'sample', 'SamplerSettings',
           'split_r_hat']
