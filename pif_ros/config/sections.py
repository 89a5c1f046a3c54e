"""
The parameters, section by section: the fields are their names and defaults.

The node declares them, and the README prints them, from here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pif_ros.config.kinds import (BETWEEN, BOOL, BOOLS, COUNT, DURATION, FREQUENCY, INTEGER,
                                  INTEGERS, LIMITS, LITTLE, NAME, NAMES, NOT_NEGATIVE, NUMBER,
                                  NUMBERS, one_of, parameter, PART, POSITIVE, SEED, SHARE, SPAN,
                                  STEPS, TEXT)
from pif_ros.core.continuous import SCHEMES


@dataclass(frozen=True)
class ModelConfig:
    """How the world moves."""

    name: str = parameter('coupled_trigonometric', NAME, 'a named system, or an entry point of '
                          'group `pif_ros.systems` of an installed package')
    params: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class GridConfig:
    """Where the density lives."""

    lower: tuple[float, ...] = parameter((-6.0, -6.0), NUMBERS, 'lower edge on each axis, '
                                         'in the units of the state')
    upper: tuple[float, ...] = parameter((6.0, 6.0), NUMBERS, 'upper edge on each axis, '
                                         'in the units of the state')
    shape: tuple[int, ...] = parameter((62, 62), INTEGERS, 'cells on each axis')
    periodic: tuple[bool, ...] = parameter((), BOOLS, 'axes on which the upper edge is the lower '
                                           'again; empty: none')


@dataclass(frozen=True)
class RegionConfig:
    """Which cells of the grid are worked on."""

    kind: str = parameter('auto', one_of('auto', 'full', 'active'), 'df: all cells; only those '
                          'where the belief is, and finer ones where it is narrow, for which the '
                          'grid is the world and its widest cells; auto: active where the model '
                          'has inputs, or changes with time and never comes again')
    negligible: float = parameter(1e-5, LITTLE, "active: share of a patch's mass that may be left "
                                  'out in each step')
    resolution: float = parameter(1.3, POSITIVE, 'active: cells per standard deviation below '
                                  'which cells are halved', 'cells')
    finest: int = parameter(4, INTEGER, 'active: how often each axis may be halved')


@dataclass(frozen=True)
class PriorConfig:
    """What is believed before the first measurement."""

    type: str = parameter(  # noqa: A003
        'gaussian', one_of('gaussian', 'uniform'), 'shape of the prior')
    mean: tuple[float, ...] = parameter((0.0, 0.0), NUMBERS, 'mean, where gaussian, '
                                        'in the units of the state')
    covariance_diagonal: tuple[float, ...] = parameter(
        (10.0, 10.0), NUMBERS, 'variances, where gaussian, in these units squared')


@dataclass(frozen=True)
class FilterConfig:
    """Which filter."""

    type: str = parameter(  # noqa: A003
        'df', one_of('df', 'dfy', 'particle', 'ekf', 'ekf_continuous', 'ukf'), 'Dirac-Feynman '
        'filter, the same for a measured path y(t) (Dirac-Feynman-Yau), or what they are compared '
        'with: bootstrap particle filter, extended Kalman filter, the same for a measured path, '
        'unscented Kalman filter')
    average_cells: bool = parameter(True, BOOL, 'df, dfy: average a likelihood that is narrower '
                                    'than a cell over the cell, instead of taking it at the '
                                    'centre')
    significance: float = parameter(0.0, PART, 'df: correct only cells with more than '
                                    "this share of the densest one's density, and empty the "
                                    'others; 0: all')
    scheme: str = parameter('symmetric', one_of(*SCHEMES), "dfy: how the path's increments and "
                            'the steps are put together')
    particles: int = parameter(5000, COUNT, 'particle: how many')
    seed: int = parameter(0, SEED, 'particle: what its random numbers start from')
    resample_below: float = parameter(0.5, SHARE, 'particle: effective size, as a share of '
                                      'the particles, below which they are resampled')


@dataclass(frozen=True)
class KernelConfig:
    """How one step is made."""

    time_step: float = parameter(0.01, SPAN, 'length of a step', 's')
    r: float = parameter(0.5, NUMBER, 'where between the two ends of a step the drift is taken, '
                         '0 to 1')
    s: float = parameter(-1.0, NUMBER, 'the same of a vielbein that depends on the state, which '
                         "decides what the model means: 0 is Ito's sense, 0.5 Stratonovich's; -1: "
                         'as the model has it')
    jacobian: str = parameter('determinant', one_of('determinant', 'exponential'),
                              "exact Jacobian, or the papers' expansion of it")
    extent: int = parameter(0, INTEGER, "largest move on each axis, the papers' setting; 0: as "
                            'wide as the kernel needs', 'cells')
    weights: str = parameter('auto', one_of('auto', 'sampled', 'moments'), 'density at the '
                             "cells' centres, or exact moments where the noise is thin")
    tolerance: float = parameter(1e-5, POSITIVE, "share of a step's tail that is left out")
    noise_inflation: float = parameter(0.0, NOT_NEGATIVE, "alpha of the papers' way with thin "
                                       "noise, g = alpha dx instead of the model's; 0: none")
    form: str = parameter('auto', one_of('auto', 'tabulated', 'split'), 'df: a weight per pair of '
                          'cells, or an operator per axis, which is made in no time, takes less '
                          'memory and is more accurate where the noise of a step is wider than '
                          'half a cell; auto: that where it can be')
    macro_error: float = parameter(0.0, PART, 'df: a gap between measurements is crossed in steps '
                                   'of 2, 4, 8 ... time steps, as long as each differs by less '
                                   'than this (in L1) from two of half its length; 0: never')
    precision: str = parameter('double', one_of('double', 'single'), 'df: of the weights of a '
                               'split kernel and of densities on their way through it; single '
                               'halves the memory, and saves time from 100,000 cells on')


@dataclass(frozen=True)
class OperatorConfig:
    """What saves work with a kernel."""

    steps: int = parameter(1, STEPS, 'df: kernel steps that are composed into one operator')
    file: str = parameter('', TEXT, 'df: where the kernel is kept: loaded if it is there, made '
                          'and saved if not; it serves any sensor; empty: nowhere')
    wavelet: str = parameter('', TEXT, 'df: wavelet of PyWavelets in whose basis the operator is '
                             'applied, such as `sym8`; empty: none')
    level: int = parameter(2, COUNT, 'df: how often that basis is halved')
    threshold: float = parameter(1e-4, PART, 'df: elements below it are left out in that '
                                 'basis')


@dataclass(frozen=True)
class GateConfig:
    """Which of a source's measurements are not taken."""

    tail_probability: float = parameter(0.0, PART, 'a measurement is rejected that is among the '
                                        'share of all, as they are expected, of the least '
                                        'density; 0: none')
    max_consecutive_rejections: int = parameter(5, COUNT, 'with the last of so many in a row '
                                                'comes a recovery')


@dataclass(frozen=True)
class SourceConfig:
    """Where a measurement comes from; every name in measurements.names has one."""

    topic: str = parameter('measurement', NAME, 'topic to subscribe to')
    type: str = parameter(  # noqa: A003
        'std_msgs/msg/Float64MultiArray', NAME, 'any installed message type')
    fields: tuple[str, ...] = parameter((), NAMES, 'paths of the fields that make y, such as '
                                        '`pose.pose.position.x` or `ranges[0]`; empty: `data`')
    sensor: str = parameter('', TEXT, "which of the system's sensors; empty: its first")
    params: Mapping[str, Any] = field(default_factory=dict)
    enabled: bool = parameter(True, BOOL, 'whether its measurements are taken; if not, they are '
                              'counted as disabled', live=True)
    gate: GateConfig = field(default_factory=GateConfig)
    outlier_probability: float = parameter(0.0, PART, 'share of its measurements that say nothing '
                                           'of the state, and may be anything')


@dataclass(frozen=True)
class MeasurementsConfig:
    """All that is measured."""

    names: tuple[str, ...] = parameter(('main',), NAMES, 'names of the sources')
    queue_length: int = parameter(1000, COUNT, 'measurements that may wait, here and in DDS; '
                                  'the oldest is dropped and counted')
    sources: Mapping[str, SourceConfig] = field(default_factory=lambda: {'main': SourceConfig()})


@dataclass(frozen=True)
class LostConfig:
    """When the filter is said to be lost."""

    false_alarm_rate: float = parameter(1e-5, PART, 'how often, per measurement, a filter that is '
                                        'not lost may be said to be; 0: never watched, nor is a '
                                        'target of a filter_bank but for recovery.when_lost')


@dataclass(frozen=True)
class RecoveryConfig:
    """What brings back a filter that is locked out."""

    share: float = parameter(0.1, BETWEEN, 'how much of another belief is mixed in')
    belief: str = parameter('uniform', one_of('uniform', 'prior'), 'which: that which knows '
                            'nothing but the grid, or the prior')
    when_lost: bool = parameter(False, BOOL, 'not only after too many rejections in a row, but '
                                'whenever the filter is found to be lost')


@dataclass(frozen=True)
class ControlConfig:
    """What drives a model that has inputs."""

    topic: str = parameter('control', NAME, 'topic to subscribe to where the model has inputs; a '
                           'stamp is the start of the interval for which the control holds')
    type: str = parameter(  # noqa: A003
        'geometry_msgs/msg/TwistStamped', NAME, 'any installed message type; without a header '
        'it is stamped at its arrival')
    fields: tuple[str, ...] = parameter(
        ('twist.linear.x', 'twist.angular.z'), NAMES, "paths of the fields that are the model's "
        'inputs, in their order')
    hold: float = parameter(1.0, SPAN, 'for how long a control holds where no other follows; '
                            'after that it is 0', 's')


@dataclass(frozen=True)
class PoseConfig:
    """What is published as a pose."""

    axes: tuple[str, ...] = parameter((), NAMES, 'states that are x, y, z, roll, pitch, yaw, in '
                                      "that order; '': not estimated; empty: the first two")
    estimator: str = parameter('mean', one_of('mean', 'mode', 'heaviest_mode'), 'point that is '
                               'published, and whose covariance: the mean; the densest point and '
                               'the second moments about it; mean and covariance of the heaviest '
                               'of the modes', live=True)
    unestimated_variance: float = parameter(0.0, NOT_NEGATIVE, 'variance on the axes of the pose '
                                            'that are not estimated')


@dataclass(frozen=True)
class PublishConfig:
    """How often the pose is predicted to now."""

    rate: float = parameter(20.0, FREQUENCY, 'poses predicted to now; 0: only after '
                            'corrections', 'Hz')


@dataclass(frozen=True)
class DensityConfig:
    """How often the density goes out, and what of it."""

    rate: float = parameter(1.0, NOT_NEGATIVE, 'densities, where someone listens; 0: none', 'Hz',
                            live=True)
    axes: tuple[str, ...] = parameter((), NAMES, 'states whose marginal is published; empty: all')


@dataclass(frozen=True)
class ModesConfig:
    """What of the density is a hump, and how often that goes out."""

    rate: float = parameter(5.0, NOT_NEGATIVE, 'modes and markers, where someone listens; less '
                            'often where finding them takes a tenth of the time; 0: none', 'Hz',
                            live=True)
    share: float = parameter(0.95, PART, 'modes are the connected parts of the smallest region '
                             'that holds this share of the mass, each with what lies around it')


@dataclass(frozen=True)
class TimeConfig:
    """How far time may be out of order."""

    history: float = parameter(1.0, DURATION, 'how late a measurement may be and still be put '
                               'where it belongs', 's')
    history_memory: float = parameter(256.0, POSITIVE, 'most memory for the beliefs kept for that',
                                      'MB')
    max_ahead: float = parameter(1.0, DURATION, 'how far a stamp may be ahead of the clock', 's')
    max_forecast: float = parameter(60.0, DURATION, 'how far beyond the newest measurement the '
                                    'pose is predicted', 's')
    max_gap: float = parameter(600.0, DURATION, 'longest gap between measurements that is '
                               'predicted through; after a longer one the prior holds again', 's')


@dataclass(frozen=True)
class DiagnosticsConfig:
    """
    How often the node tells how it is, and from where on that is a warning, and an error.

    Each limit is a pair: WARN from the first number on, ERROR from the second on.
    """

    rate: float = parameter(1.0, FREQUENCY, 'how often, besides at once when it gets worse; '
                            '0: never', 'Hz')
    max_age: tuple[float, ...] = parameter((2.0, 10.0), LIMITS, 'for how long a source may be '
                                           'silent, WARN and ERROR', 's')
    max_delay: tuple[float, ...] = parameter((0.5, 5.0), LIMITS, 'how old stamps may be when they '
                                             'come, WARN and ERROR', 's')
    max_refused: tuple[float, ...] = parameter((0.1, 0.5), LIMITS, 'share of the last 50 messages '
                                               'of a source that were not taken or never came, '
                                               'WARN and ERROR')
    max_lost_mass: tuple[float, ...] = parameter((0.05, 0.5), LIMITS, 'share of the belief that '
                                                 'has left the grid, WARN and ERROR')
    max_edge_mass: tuple[float, ...] = parameter((0.05, 0.5), LIMITS, 'share of it in the '
                                                 "grid's outermost cells, WARN and ERROR")
    max_busy: tuple[float, ...] = parameter((0.7, 0.95), LIMITS, 'share of the time that the work '
                                            'may take, WARN and ERROR')
