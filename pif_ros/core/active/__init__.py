"""The grid filter that works where the belief is, and nowhere else."""

from pif_ros.core.active.belief import ActiveBelief, Patch
from pif_ros.core.active.filter import ActiveGridFilter, unsuited
from pif_ros.core.active.settings import RegionSettings
from pif_ros.core.active.window import Window

__all__ = ['ActiveBelief', 'ActiveGridFilter', 'Patch', 'RegionSettings', 'unsuited', 'Window']
