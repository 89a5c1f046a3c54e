"""From what a user sets to the filter that runs; no ROS."""

from pif_ros.config.bank import FilterOfMany
from pif_ros.config.build import build_filter, build_tracker, find_grid, find_system, state_axes
from pif_ros.config.filters import describe, gaussian_of, OF_A_PATH, remarks, uniform_of
from pif_ros.config.identity import identity
from pif_ros.config.kinds import ConfigError
from pif_ros.config.sections import ControlConfig, DiagnosticsConfig, SourceConfig
from pif_ros.config.table import Config, specifications

__all__ = ['Config', 'ConfigError', 'ControlConfig', 'DiagnosticsConfig', 'FilterOfMany',
           'OF_A_PATH', 'SourceConfig', 'build_filter', 'build_tracker', 'describe', 'find_grid',
           'find_system', 'gaussian_of', 'identity', 'remarks', 'specifications', 'state_axes',
           'uniform_of']
