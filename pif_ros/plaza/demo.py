"""Finds a real robot by its radio ranges: player, filter node, table and pictures at once."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import os
from pathlib import Path
import sys

from pif_ros.plaza.recording import NAMES
from pif_ros.process import failed, logs_to_stdout, Signals

_NAME = 'plaza_demo'


def main(args: Sequence[str] | None = None) -> int:
    """Run it: 0 if all went well, 1 if the filter failed, 2 at bad arguments, 130 at a signal."""
    stopped = Signals()
    logs_to_stdout()
    wanted = _arguments(args)
    _stay_local(wanted.out)

    # imported here, so that a signal during the two seconds that this takes is not lost
    from pif_ros.plaza.demonstration import demonstrate, FilterFailed
    try:
        demonstrate(wanted, stopped)
    except (ValueError, OSError) as error:
        status = 1 if isinstance(error, TimeoutError) else 2
        return failed(_NAME, str(error), status)
    except FilterFailed as error:
        return failed(_NAME, str(error), 130 if stopped() else 1)
    return failed(_NAME, 'stopped', 130) if stopped() else 0


def _arguments(args: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='plaza_demo', description=__doc__)
    parser.add_argument('--out', type=Path, required=True, help='folder for what is found')
    parser.add_argument('--recording', choices=NAMES, default=NAMES[0])
    parser.add_argument('--path', type=Path, help='its file, if not the one that gtsam ships')
    parser.add_argument('--speed', type=float, default=0.0,
                        help='1: real time; 0: as fast as the filter keeps up (default)')
    parser.add_argument('--start', type=float, default=0.0, help='seconds into the recording')
    parser.add_argument('--duration', type=float, default=0.0, help='seconds; 0: to the end')
    parser.add_argument('--odometry', action='store_true',
                        help='use it too: position and heading from ranges and odometry')
    return parser.parse_args(args)


def _stay_local(out: Path) -> None:
    """Keep the traffic on this machine, and apart from that of other runs, unless told not to."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 101))
    os.environ.setdefault('ROS_LOG_DIR', str(out / 'log'))


if __name__ == '__main__':
    sys.exit(main())
