"""Exact answers and plain numerical ones, which owe nothing to the package."""

import numpy as np
from scipy.linalg import expm
from scipy.sparse import diags
from scipy.sparse.linalg import expm_multiply


def linear_moments(F, g, t):
    """Return the transition matrix and the covariance of dx = F x dt + e dv [Van Loan 1978]."""
    n = len(F)
    block = expm(t * np.block([[-F, g], [np.zeros((n, n)), F.T]]))
    transition = block[n:, n:].T
    return transition, transition @ block[:n, n:]


def gaussian(x, mean, covariance):
    """Return the density of N(mean, covariance) at states (n, ...)."""
    d = x - np.reshape(mean, (-1,) + (1,) * (x.ndim - 1))
    S = np.atleast_2d(covariance)
    square = np.einsum('i...,ij,j...->...', d, np.linalg.inv(S), d)
    return np.exp(-square / 2) / np.sqrt(np.linalg.det(2 * np.pi * S))


def kalman(F, g, mean, covariance, measurements):
    """
    Return means, covariances and log evidences of the continuous-discrete Kalman filter.

    measurements: (seconds since the one before, y, H, R) each.
    """
    m, P = np.array(mean, dtype=float), np.array(covariance, dtype=float)
    found = []
    for seconds, y, H, R in measurements:
        transition, noise = linear_moments(F, g, seconds)
        m, P = transition @ m, transition @ P @ transition.T + noise
        v, S = y - H @ m, H @ P @ H.T + R
        log_evidence = np.log(gaussian(v, np.zeros(len(v)), S))
        m = m + P @ H.T @ np.linalg.inv(S) @ v
        P = P - P @ H.T @ np.linalg.inv(S) @ H @ P
        found.append((m, P, log_evidence))
    return map(np.array, zip(*found))


def fokker_planck(drift, sigma, start, t, width, half):
    """
    Return points and the density at t of a scalar dx = f(x) dt + sigma dv from a point.

    Finite volumes of one width, half of them on either side of the start, closed at the ends; the
    error is of second order in the width and none in time.
    """
    x = start + width * np.arange(-half, half + 1)
    edge = (x[1:] + x[:-1]) / 2
    leaves_right = drift(edge) / 2 / width + sigma**2 / 2 / width**2
    leaves_left = -drift(edge) / 2 / width + sigma**2 / 2 / width**2
    stays = -np.append(leaves_right, 0) - np.append(0, leaves_left)
    generator = diags([leaves_right, stays, leaves_left], offsets=[-1, 0, 1], format='csc')
    p = np.zeros(len(x))
    p[half] = 1 / width
    return x, expm_multiply(t * generator, p)
