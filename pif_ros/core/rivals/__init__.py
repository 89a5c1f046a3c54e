"""Filters to compare with, behind the same two verbs."""

from pif_ros.core.rivals.cloud import ParticleBelief
from pif_ros.core.rivals.gaussian import ExtendedKalmanFilter, GaussianBelief
from pif_ros.core.rivals.particles import ParticleFilter
from pif_ros.core.rivals.unscented import UnscentedKalmanFilter

__all__ = ['ExtendedKalmanFilter', 'GaussianBelief', 'ParticleBelief', 'ParticleFilter',
           'UnscentedKalmanFilter']
