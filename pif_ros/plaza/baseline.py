"""The extended Kalman filter on the ranges of a recording, as late as they came."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.rivals import ExtendedKalmanFilter, GaussianBelief
from pif_ros.core.tracker import Measurement, Tracker
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import Track
from pif_ros.plaza.schedule import Span, steps


def extended_kalman_track(recording: Recording, span: Span, model: StateModel,
                          sensors: Mapping[int, Sensor], mean: ArrayLike, covariance: ArrayLike,
                          history: float) -> Track:
    """
    Return one estimate per range that was on time.

    sensors: one per beacon; mean (2,), covariance (2, 2): the prior at the first range; history:
    seconds within which late ranges are still used, from the next estimate on.
    """
    named = {str(beacon): sensor for beacon, sensor in sensors.items()}
    prior = GaussianBelief(np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float))
    tracker = Tracker(ExtendedKalmanFilter(model, named, time_step=1.0), prior, history)
    stamps, beliefs = [], []
    for i in (i for step in steps(recording, span) for i in step.ranges):
        stamp = int(recording.range_stamps_ns[i])
        tracker.observe(Measurement(
            stamp, str(recording.beacon_ids[i]), (float(recording.ranges[i]),)))
        if stamp == recording.arrivals_ns[i]:
            stamps.append(stamp)
            beliefs.append(tracker.estimate().belief)
    return Track(np.array(stamps, dtype=np.int64), np.array([b.mean() for b in beliefs]),
                 np.array([b.covariance() for b in beliefs]))
