"""
Continuous-continuous filtering: what is measured is a path, known at some stamps.

dy = h(x, t) dt + n dw  [PMC, Eq. 1]: a sensor's function is here the slope that the path is
expected to have, and its covariance, C = n W n^T, is that of the path's noise per second.
"""

from pif_ros.core.continuous.dirac_feynman_yau import DiracFeynmanYauFilter, SCHEMES
from pif_ros.core.continuous.kalman_bucy import ExtendedKalmanBucyFilter
from pif_ros.core.continuous.path import PathBelief

__all__ = ['DiracFeynmanYauFilter', 'ExtendedKalmanBucyFilter', 'PathBelief', 'SCHEMES']
