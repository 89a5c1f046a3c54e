"""
Whole paths drawn from the exponential of minus the action of states and measurements.

[TM, section 9.2], for smoothing, and for states too many for a grid.  The sampler is one of our
own, since what is drawn is a path, and general samplers do not know it: here the precision of a
path is a band, so that preconditioned moves cost no more than the path is long; all chains move as
one array, by the model's own functions, without a second model that can be differentiated.  And
what gradients cannot do, to change between humps of the posterior (signs that no sensor sees), is
done by a particle filter that is conditioned on the path, or by exchanges with chains that feel
less of the measurements; neither knows of any symmetry.
"""

from pif_ros.core.path_monte_carlo.diagnostics import effective_sample_size, split_r_hat
from pif_ros.core.path_monte_carlo.posterior import PathPosterior
from pif_ros.core.path_monte_carlo.sampler import PathSample, sample
from pif_ros.core.path_monte_carlo.settings import SamplerSettings

__all__ = ['effective_sample_size', 'PathPosterior', 'PathSample', 'sample', 'SamplerSettings',
           'split_r_hat']
