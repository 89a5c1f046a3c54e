"""A small recording with the layout, the beacons and the oddities of the real ones."""

from pathlib import Path

import numpy as np
from scipy.io import savemat

SCALE, SIGMA = 1.07, 0.5
BEACONS = np.array([
    [0.0, -46.623, 11.026], [1.0, 11.036, -6.959], [6.0, 22.053, 23.848], [5.0, -17.665, 59.009]])
START, SILENCE = 100.0, (140.0, 180.0)
LATE = (184.0, 190.0)


def where(t: np.ndarray) -> np.ndarray:
    """Return x, y and heading of a drive round a circle, once in two minutes."""
    angle = 2.0 * np.pi * (t - START) / 120.0
    return np.stack([-15.0 + 12.0 * np.cos(angle), 20.0 + 12.0 * np.sin(angle),
                     (angle + 1.5 * np.pi) % (2.0 * np.pi) - np.pi], axis=-1)


def tables() -> dict[str, np.ndarray]:
    """Return all tables; of the ranges in LATE every other one comes after the rest of them."""
    t = np.concatenate([np.arange(100.5, SILENCE[0], 0.25), np.arange(SILENCE[1], 219.0, 0.25)])
    late = (t >= LATE[0]) & (t < LATE[1]) & (np.arange(len(t)) % 8 >= 4)
    t = np.concatenate([t[~late & (t < LATE[1])], t[late], t[t >= LATE[1]]])
    beacons = BEACONS[np.round(t * 4).astype(int) % 4]
    distance = np.linalg.norm(where(t)[:, :2] - beacons[:, 1:], axis=1)
    noise = np.random.default_rng(7).normal(0.0, SIGMA, len(t))
    truth = np.arange(START, 220.0, 0.2)
    turns = 2.0 * np.pi / 120.0 * np.diff(truth)
    return {'GT': np.column_stack([truth, where(truth)]), 'TL': BEACONS,
            'DR': np.column_stack([truth[1:], 12.0 * turns, turns]),
            'TD': np.column_stack([t, np.full(len(t), 2.0), beacons[:, 0],
                                   SCALE * distance + noise])}


def write(file: Path, **changed: np.ndarray | None) -> Path:
    """Write the tables to a .mat file, some of them changed or, where None, left out."""
    savemat(file, {k: v for k, v in {**tables(), **changed}.items() if v is not None})
    return file
