"""Any tracker on a recording: ranges and odometry in the order in which they came."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.estimates import Measurement
from pif_ros.core.tracker import Tracker
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import Track
from pif_ros.plaza.schedule import Span, steps

Array = NDArray[np.float64]


def played(recording: Recording, span: Span, tracker: Tracker[Any]) -> Iterator[int]:
    """
    Yield the stamp of each range that is on time, once the tracker has been given it.

    Before it the tracker has been given all else that has arrived until then: late ranges, and
    odometry where its model takes any.  Its sources are called beacon_<id>.
    """
    for step in steps(recording, span, odometry=bool(tracker.filter.model.inputs)):
        for i in step.odometry:
            tracker.control(int(recording.odometry_stamps_ns[i]), recording.odometry[i])
        for i in step.ranges:
            stamp = int(recording.range_stamps_ns[i])
            tracker.observe(Measurement(
                stamp, f'beacon_{recording.beacon_ids[i]}', (float(recording.ranges[i]),)))
            if stamp == recording.arrivals_ns[i]:
                yield stamp


def estimates(recording: Recording, span: Span, tracker: Tracker[Any]) -> Track:
    """Return one estimate per range that was on time."""
    rows = []
    for stamp in played(recording, span, tracker):
        belief = tracker.estimate().belief
        rows.append((stamp, belief.mean(), belief.covariance()))
    return track_of(rows)


def track_of(rows: Sequence[tuple[int, Array, Array]]) -> Track:
    """Return stamps, each with the mean and covariance of x, y and perhaps heading, as a track."""
    stamps, means, covariances = zip(*rows)
    return Track(np.array(stamps, dtype=np.int64), np.array(means), np.array(covariances))
