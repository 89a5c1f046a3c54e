"""The papers' examples of measured paths, in small  [PMC, section 6]."""

import numpy as np
from pif_ros.core.continuous import DiracFeynmanYauFilter, ExtendedKalmanBucyFilter, SCHEMES
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.systems import arctangent_sensor, cubic_sensor
import pytest

SECOND = 1_000_000_000
#: [PMC, section 6.2]: 200 steps of 0.01 s, cells of 0.01
LINE, EPS, STEPS = Grid((-1.5,), (1.5,), (300,)), 0.01, 200


def moved(drift, sigma, slope, x, eps, substeps, rng):
    """Return states later, and what h has added up to on the way."""
    total, dt, before = 0.0, eps / substeps, slope(x)
    for _ in range(substeps):
        x = x + drift(x) * dt + sigma * np.sqrt(dt) * rng.standard_normal(np.shape(x))
        after = slope(x)
        total, before = total + (before + after) / 2 * dt, after
    return x, total


def swaying(x):
    return 1.2 * np.cos(3 * x)


def simulated(drift, sigma, slope, sigma_y, eps, steps, seed):
    """Return a truth from N(0, 0.01) and the increments of its path."""
    rng, found = np.random.default_rng(seed), []
    x = rng.normal(0, 0.1)
    for _ in range(steps):
        x, total = moved(drift, sigma, slope, x, eps, 10, rng)
        found.append((x, total + sigma_y * np.sqrt(eps) * rng.normal()))
    return np.array(found).T


def believed(filter_, increments, eps):
    """Return means and standard deviations from N(0, 0.01) on, and the total log evidence."""
    [name], step = filter_.sensors, round(eps * SECOND)
    belief, _ = filter_.correct(filter_.gaussian([0.0], [[0.01]]), [0.0], name, 0)
    found, total = [], 0.0
    for k, y in enumerate(np.cumsum(increments)):
        belief = filter_.predict(belief, k * step, (k + 1) * step)
        belief, log_evidence = filter_.correct(belief, [y], name, (k + 1) * step)
        found.append((belief.mean()[0], np.sqrt(belief.covariance()[0, 0])))
        total += log_evidence
    return (*np.array(found).T, total)


def by_particles(increments, sigma_y, count=4000):
    """Return the means of many particles with five Euler steps in each of the first example's."""
    rng, found = np.random.default_rng(99), []
    x = rng.normal(0, 0.1, size=count)
    for dy in increments:
        x, total = moved(swaying, 0.3, np.arctan, x, EPS, 5, rng)
        log_w = -(dy - total)**2 / (2 * sigma_y**2 * EPS)
        w = np.exp(log_w - log_w.max())
        w /= w.sum()
        found.append(w @ x)
        places = (np.arange(count) + rng.random()) / count
        x = x[np.minimum(np.searchsorted(np.cumsum(w), places), count - 1)]
    return np.array(found)


def filters_of(system, grid, eps):
    sensors = {name: sensor() for name, sensor in system.sensors.items()}
    kernel = KernelSettings(eps)
    found = {scheme: DiracFeynmanYauFilter(system.model, grid, sensors, kernel, scheme)
             for scheme in SCHEMES}
    return found | {'extended': ExtendedKalmanBucyFilter(system.model, sensors, eps)}


@pytest.mark.parametrize('sigma_y, distances, coverages', [
    # rms distance from the particles' mean, whose own error is about 0.001: the figures of the
    # full example, 20,000 particles and 100 seeds, are .001, .002, .006, .006, .018 and .004
    (0.05, {'symmetric': 0.003, 'splitting': 0.004, 'post': 0.009, 'pre': 0.009,
            'pre_printed': 0.025, 'extended': 0.008}, 0.12),
    # and .001, .003, .041, .039, .049, .002 where the noise is small
    (0.0125, {'symmetric': 0.003, 'splitting': 0.005, 'post': 0.06, 'pre': 0.06,
              'pre_printed': 0.07, 'extended': 0.004}, 0.05),
])
def test_the_arctangent_sensor_is_filtered_as_well_as_by_many_particles(
        sigma_y, distances, coverages):
    filters = filters_of(arctangent_sensor(sigma_y=sigma_y), LINE, EPS)
    found, inside = {name: [] for name in filters}, []
    for seed in range(2):
        truth, increments = simulated(swaying, 0.3, np.arctan, sigma_y, EPS, STEPS, seed)
        reference = by_particles(increments, sigma_y)
        for name, filter_ in filters.items():
            mean, deviation, _ = believed(filter_, increments, EPS)
            found[name].append(np.sqrt(np.mean((mean - reference)**2)))
            if name == 'symmetric':
                inside.append(np.abs(truth - mean) < 2 * deviation)
    for name, largest in distances.items():
        assert np.mean(found[name]) < largest
    if sigma_y == 0.0125:
        for name in ('post', 'pre', 'pre_printed'):
            assert np.mean(found[name]) > 8 * np.mean(found['symmetric'])
    assert abs(np.mean(inside) - 0.954) < coverages


def test_where_the_extended_filter_is_stuck_the_cubic_sensor_is_followed():
    # [PMC, section 6.3]: at the mean 0 of the start, x^3 is flat, and its gain stays 0
    eps, grid = 0.001, Grid((-15,), (15,), (3000,))
    filters = filters_of(cubic_sensor(), grid, eps)
    truth, increments = simulated(lambda x: 0 * x, 1.0, lambda x: x**3, 1.0, eps, 2000, 2)
    stuck, _, _ = believed(filters['extended'], increments, eps)
    # but for the rounding of its slope
    assert np.abs(stuck).max() < 1e-6
    mean, deviation, _ = believed(filters['symmetric'], increments, eps)
    # in the second half, when there is something to see
    ours, its = (np.sqrt(np.mean((truth - m)[1000:]**2)) for m in (mean, stuck))
    assert ours < its / 2
    assert np.mean(np.abs(truth - mean) < 2 * deviation) > 0.9


def test_the_schemes_agree_on_the_evidence_as_steps_get_short():
    system = arctangent_sensor(sigma_y=0.05)
    _, increments = simulated(swaying, 0.3, np.arctan, 0.05, EPS / 4, 4 * STEPS, 1)
    sums = {}
    for scheme in ('symmetric', 'splitting', 'post', 'pre'):
        sums[scheme] = [believed(filters_of(system, LINE, eps)[scheme],
                                 increments.reshape(-1, round(eps / EPS * 4)).sum(axis=1), eps)[2]
                        for eps in (EPS, EPS / 4)]
    for scheme in ('splitting', 'post', 'pre'):
        coarse, fine = np.abs(np.subtract(sums[scheme], sums['symmetric']))
        # of first order, of 776 and 3654
        assert fine < coarse / 2.5
        assert coarse < 0.3


def test_extended_kalman_bucy_tends_to_its_differential_equations():
    system, found = arctangent_sensor(sigma_y=0.05), []
    _, fine = simulated(swaying, 0.3, np.arctan, 0.05, EPS / 16, 4 * STEPS, 3)
    for count in (1, 4, 16):
        eps, increments = EPS / 16 * count, fine.reshape(-1, count).sum(axis=1)
        mean, deviation, _ = believed(filters_of(system, LINE, eps)['extended'], increments, eps)
        m, P, steps = 0.0, 0.01, []
        for dy in increments:
            # dm = f dt + P H C^-1 (dy - h dt), dP = (2 F P + g - P H C^-1 H P) dt  [PMC, Eq. 44]
            F, H = -3.6 * np.sin(3 * m), 1 / (1 + m**2)
            m, P = (m + swaying(m) * eps + P * H / 0.0025 * (dy - np.arctan(m) * eps),
                    P + (2 * F * P + 0.09 - (P * H)**2 / 0.0025) * eps)
            steps.append((m, P))
        m, P = np.array(steps).T
        found.append([np.abs(mean - m).mean(), np.abs(deviation**2 - P).mean()])
    # of first order, as is Euler's scheme
    for coarse, fine in zip(found[:0:-1], found[-2::-1]):
        assert np.divide(coarse, fine) == pytest.approx([4, 4], abs=1)
    assert np.all(np.less(found[0], [4e-4, 4e-6]))
