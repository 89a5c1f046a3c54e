"""What holds after every event, whatever it was."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

#: What the mass of a belief may lack of 1 after a correction.
MASS_ERROR = 1e-9
#: Of a covariance, what rounding may make of an eigenvalue 0, as a share of the largest one.
ROUNDING = 1e-12


def densities(belief: Any) -> list[Any]:
    """Return the arrays in which a belief keeps its density, on a grid or in patches."""
    return [patch.density for patch in getattr(belief, 'patches', [belief])]


def check_same(found: Any, expected: Any) -> None:
    """Check that two estimates are the same to the last bit."""
    assert found.stamp_ns == expected.stamp_ns, (
        f'a belief at {found.stamp_ns}, expected {expected.stamp_ns}')
    places = [[patch.window for patch in getattr(estimate.belief, 'patches', [])]
              for estimate in (found, expected)]
    assert places[0] == places[1], 'a belief in other places'
    bits = [[density.tobytes() for density in densities(estimate.belief)]
            for estimate in (found, expected)]
    assert bits[0] == bits[1], 'another belief'


def check_belief(belief: Any, corrected: bool) -> None:
    """Check that a belief is a density, of mass 1 after a correction, with a true covariance."""
    for density in densities(belief):
        assert np.isfinite(density).all(), 'a density that is not finite'
        assert (density >= 0).all(), 'a negative density'
    # active cells tell what they left out as negligible since the correction
    mass = belief.mass + getattr(belief, 'dropped', 0.0)
    assert not corrected or abs(mass - 1) <= MASS_ERROR, f'a mass of {mass!r} after a correction'
    if belief.mass > 0:
        check_covariance(belief.covariance())


def check_covariance(covariance: Any) -> None:
    """Check that a matrix is finite, symmetric and positive semi-definite."""
    assert np.isfinite(covariance).all(), f'covariance: not finite: {covariance.tolist()}'
    largest = float(np.abs(covariance).max(initial=0.0))
    assert np.abs(covariance - covariance.T).max() <= ROUNDING * largest, (
        f'covariance: not symmetric: {covariance.tolist()}')
    assert np.linalg.eigvalsh(covariance)[0] >= -ROUNDING * largest, (
        f'covariance: a negative eigenvalue: {covariance.tolist()}')


def check_pose(message: Any) -> None:
    """Check that a published pose has finite numbers, a rotation and a true covariance."""
    position, turn = message.pose.pose.position, message.pose.pose.orientation
    numbers = (position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w)
    assert all(map(math.isfinite, numbers)), f'a pose that is not finite: {numbers}'
    length = math.hypot(turn.x, turn.y, turn.z, turn.w)
    assert abs(length - 1) <= 1e-12, f'a quaternion of length {length!r}'
    check_covariance(np.array(message.pose.covariance).reshape(6, 6))


def check_account(name: str, account: Any, queued: int) -> None:
    """Check that received = accepted + rejected + dropped + queued."""
    found = account.accepted + account.rejected.total() + account.dropped + queued
    assert account.received == found, f'{name}: {queued} queued, {account}'
