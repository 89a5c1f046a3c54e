"""
Named systems: state models with the sensors that see them.

A system is a function of its constants, by the papers' own names, that returns a System.  An
installed package adds its own through entry points of group ``pif_ros.systems``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pif_ros.core.systems.coupled import (coupled_trigonometric, cubic_bearing, lorenz_63,
                                          multiplicative_4d)
from pif_ros.core.systems.robots import (bearing_sensor, heading_sensor, position_2d,
                                         position_sensor, range_sensor, unicycle_2d)
from pif_ros.core.systems.scalar import (arctangent_sensor, benes, cosine_drift, cubic_sensor,
                                         double_well, geometric_brownian_motion,
                                         ornstein_uhlenbeck, sine_cubic_drift, wiener)
from pif_ros.core.systems.system import System

#: Every system by its name.
SYSTEMS: Mapping[str, Callable[..., System]] = {
    system.__name__: system for system in (
        wiener, ornstein_uhlenbeck, benes, geometric_brownian_motion, double_well, cosine_drift,
        sine_cubic_drift, cubic_bearing, coupled_trigonometric, multiplicative_4d,
        arctangent_sensor, cubic_sensor, lorenz_63, position_2d, unicycle_2d)}

__all__ = ['SYSTEMS', 'System', 'arctangent_sensor', 'bearing_sensor', 'benes', 'cosine_drift',
           'coupled_trigonometric', 'cubic_bearing', 'cubic_sensor', 'double_well',
           'geometric_brownian_motion', 'heading_sensor', 'lorenz_63', 'multiplicative_4d',
           'ornstein_uhlenbeck', 'position_2d', 'position_sensor', 'range_sensor',
           'sine_cubic_drift', 'unicycle_2d', 'wiener']
