"""
What must hold of the node whatever happens to it, each shown by a command.

Each module with a run() is a proof: run(share) does that share of the whole, returns lines that
say what was done, how often, and what was measured, and raises AssertionError where something does
not hold.  All of it is seeded, and stands on the tests' own ROS (test/ros.py).
"""

from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / 'test'))
