"""Dirac-Feynman path integral grid filter for ROS 2."""

__version__ = '0.1.0'
