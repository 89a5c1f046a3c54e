"""A filter node whose predictions take so many seconds each: SECONDS_PER_PREDICTION."""

from __future__ import annotations

import os
import sys
import time
from typing import Any

from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.node import main

#: What each prediction takes at least, in seconds.
SECONDS = 'SECONDS_PER_PREDICTION'


def slow_down(seconds: float) -> None:
    """Let every prediction to a later stamp take at least so long, as a larger grid would."""
    predict = DiracFeynmanFilter.predict

    def slow(filter_: Any, belief: Any, from_ns: int, to_ns: int, *rest: Any) -> Any:
        began = time.monotonic()
        belief = predict(filter_, belief, from_ns, to_ns, *rest)
        while to_ns > from_ns and time.monotonic() - began < seconds:
            pass
        return belief

    setattr(DiracFeynmanFilter, 'predict', slow)


if __name__ == '__main__':
    slow_down(float(os.environ[SECONDS]))
    sys.exit(main())
