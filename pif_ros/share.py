"""Where the files are that come with the package."""

from __future__ import annotations

import os
from pathlib import Path
import sys


def find(name: str) -> Path:
    """
    Return the path of a file of the package, such as 'config/plaza_range_only.yaml'.

    Looked for beside the package (a checkout), then in the share folders of the ROS workspaces
    that are sourced, then in the share folder of this Python (pip).  Raises FileNotFoundError.
    """
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    folders = [Path(__file__).resolve().parent.parent]
    folders += [Path(prefix) / 'share' / 'pif_ros' for prefix in prefixes if prefix]
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    raise FileNotFoundError(f'{name}: expected in {", ".join(map(str, folders))}')
