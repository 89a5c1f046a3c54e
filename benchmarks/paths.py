"""How well sampled paths mix, and whether they agree with smoothing on the grid."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
import time

from benchmarks.progress import Progress
from benchmarks.report import Goal, Row, Table
from benchmarks.timing import Effort
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.path_monte_carlo import (PathPosterior, PathSample, sample, SamplerSettings,
                                           split_r_hat)
from pif_ros.core.rivals import ParticleFilter
from pif_ros.core.simulation import measure, simulate
from pif_ros.core.smoothing import smooth
from pif_ros.core.systems import coupled_trigonometric, sine_cubic_drift

Array = NDArray[np.float64]

#: R-hat at which chains count as mixed  [Vehtari et al. 2021].
MIXED = 1.01
#: Deviations from the truth, in standard errors, as a root mean square: 1 where they are honest.
HONEST = 2.0
PARTICLES, REPEATS = 100_000, 8


@dataclass(frozen=True, eq=False)
class Window:
    """
    A posterior over paths, what it is called, and what is known of it.

    exact: returns the averages, (stamps, 3 n); filtered: returns the means at the last stamp of
    some particle filters (filters, n), and their seconds per step; mixes: whether these settings
    are meant to mix it well.
    """

    name: str
    setting: str
    posterior: PathPosterior
    settings: SamplerSettings
    exact: Callable[[], Array] | None = None
    filtered: Callable[[], tuple[Array, Array]] | None = None
    mixes: bool = True


def run(effort: Effort) -> Table:
    """Sample each window, and hold its averages against the grid or large particle filters."""
    rows, goals = [], []
    for window in (*_windows(effort), _ring(effort, 0.0), _ring(effort, 0.5),
                   _ring(effort, 0.0, signs_known=False)):
        drawn, seconds = _timed(window)
        exact = window.exact() if window.exact else None
        rows.append(_row(window, drawn, seconds, exact))
        if window.mixes:
            goals.append(Goal(f'R-hat of {window.name}, {window.setting}', MIXED,
                              float(drawn.r_hat.max())))
        if exact is not None:
            goals.append(Goal(f'deviation of {window.name} from the grid', HONEST,
                              _deviation(drawn, exact)))
        if window.filtered:
            means, cost = window.filtered()
            rows.append(_particle_row(drawn, means, cost))
            goals.append(Goal(f'deviation of {window.name} from particle filters', HONEST,
                              _last_deviation(drawn, means)))
    return Table('Path integral Monte Carlo', rows, [
        'median: one round of all chains, with its particle moves, Hamiltonian moves and '
        'exchanges; of a particle filter, one step',
        'R-hat, ESS: the worst of all states at all stamps, rank-normalised, of split chains; of '
        'a particle filter, the posterior variance of a mean at the last stamp over that of '
        f'{REPEATS} seeds, the worst of all states',
        'mixed after: seconds, warm-up included, until R-hat of every state was below '
        f'{MIXED} and stayed so, looked at every tenth of the draws; blank for never',
        'deviation: root mean square over stamps and states of the error of x, |x| and x^2 '
        'against the smoother on the grid, in estimated standard errors; of the ring, of x at the '
        f'last stamp against {REPEATS} particle filters'], goals)


def _windows(effort: Effort) -> Iterator[Window]:
    """Yield the windows that a grid can smooth, with and without particle moves."""
    for name, system, grid, h, steps, start, mean in (
            ('sine_cubic_drift', sine_cubic_drift(), Grid((-8,), (8,), (640,)), 0.02, 50,
             [1.0], [0.5]),
            ('coupled_trigonometric', coupled_trigonometric(),
             Grid((-6.5, -6.5), (6.5, 6.5), (130, 130)), 0.05, 50, [1.2, -0.8], [0.5, 0.0])):
        [(source, make)] = system.sensors.items()
        kernel, sensors = KernelSettings(h, tolerance=1e-8), {source: make()}
        prior = (np.array(mean), np.eye(len(mean)))
        measured = _measured(system.model, sensors[source], source, start, h, steps)
        posterior = PathPosterior(system.model, sensors, kernel, *prior, measured, 0)
        filter_ = DiracFeynmanFilter(system.model, grid, sensors, kernel, average_cells=False)
        settings = SamplerSettings(chains=4, draws=effort.scaled(1000, 50),
                                   warm_up=effort.scaled(100, 20), particles=256)
        setting = f'{steps} steps of {h:g} s, r = 1/2'
        yield Window(name, setting, posterior, settings,
                     partial(_smoothed, filter_, prior, measured))
        yield Window(name, f'{setting}, gradients alone', posterior,
                     replace(settings, particles=0), mixes=False)


def _measured(model: StateModel, sensor: Sensor, source: str, start: object, h: float,
              steps: int) -> list[tuple[int, str, Array]]:
    """Return the measurements of a simulated path, one at the end of each step."""
    rng, times = np.random.default_rng(2), h * np.arange(steps + 1)
    path = simulate(model, start, times, rng, substeps=10)  # type: ignore[arg-type]
    return [(round(t * 1e9), source, measure(sensor, x, t, rng))
            for t, x in zip(times[1:], path[1:])]


def _averages(x: Array) -> Array:
    """Return what is compared of states (n, ...): (3 n, ...)."""
    return np.concatenate([x, np.abs(x), np.square(x)])


def _smoothed(filter_: DiracFeynmanFilter, prior: tuple[Array, Array],
              measured: list[tuple[int, str, Array]]) -> Array:
    """Return the averages over the smoothed densities on the grid, (stamps, 3 n)."""
    grid = filter_.grid
    found = smooth(filter_, GridBelief.gaussian(grid, *prior), measured, 0)
    return np.stack([_averages(grid.points) @ (belief.density.ravel() * grid.cell_volume)
                     for belief in found.beliefs])


def _timed(window: Window) -> tuple[PathSample, Array]:
    """Return a sample, and the seconds since the beginning after each round."""
    clock: list[float] = []
    progress = Progress(f'paths: {window.name}, {window.setting}')

    def told(share: float) -> None:
        clock.append(time.perf_counter() - began)
        progress.show(share)

    began = time.perf_counter()
    drawn = sample(window.posterior, window.settings, seed=1, progress=told)
    return drawn, np.array(clock)


def _row(window: Window, drawn: PathSample, seconds: Array, exact: Array | None) -> Row:
    rounds, least = np.diff(seconds), float(drawn.effective_sample_size.min())
    settings = window.settings
    return Row(window.name, f'{window.setting}, {settings.chains} chains of {settings.draws}',
               float(np.median(rounds)), float(np.percentile(rounds, 99)), accuracy={
                   'R-hat': float(drawn.r_hat.max()), 'ESS': least,
                   'ESS per s': least / float(seconds[-1]),
                   'mixed after': _mixed_after(drawn, seconds),
                   'deviation': None if exact is None else _deviation(drawn, exact)})


def _mixed_after(drawn: PathSample, seconds: Array) -> float | None:
    """Return the seconds after which chains had mixed, and stayed so; None for never."""
    draws, found = drawn.paths.shape[1], None
    for share in range(10, 0, -1):
        count = draws * share // 10
        if count < 4 or split_r_hat(drawn.paths[:, :count]).max() > MIXED:
            return found
        found = float(seconds[len(seconds) - draws + count - 1])
    return found


def _deviation(drawn: PathSample, exact: Array) -> float:
    average = drawn.average(_averages)
    return float(np.sqrt(np.mean(np.square((average.mean - exact) / average.standard_error))))


# The ring of ten


def _ring_drift(x: Array, t: float) -> Array:
    """Return the drift of coupled_trigonometric continued around a ring of ten states."""
    f = x[np.arange(10) - 1] - x[(np.arange(10) + 1) % 10]
    f[0::2] += np.cos(x[0::2])
    f[1::2] += np.sin(x[1::2])
    return f


def _ring_jacobian(x: Array, t: float) -> Array:
    D, here = np.zeros((10,) + x.shape), np.arange(10)
    D[here, here - 1], D[here, (here + 1) % 10] = 1, -1
    D[here[0::2], here[0::2]], D[here[1::2], here[1::2]] = -np.sin(x[0::2]), np.cos(x[1::2])
    return D


def _ring(effort: Effort, r: float, signs_known: bool = True) -> Window:
    """Return ten coupled states with correlated noise, of which five squares are seen."""
    apart, h, steps = np.abs(np.subtract.outer(np.arange(10), np.arange(10))), 0.05, 30
    model = StateModel(tuple(f'x{i + 1}' for i in range(10)), _ring_drift, np.eye(10),
                       0.5**np.minimum(apart, 10 - apart), drift_jacobian=_ring_jacobian)
    sensor, start = Sensor(lambda x, t: x[0::2]**2, np.eye(5)), np.full(10, 1.5)
    mean, variance = (start, 0.1) if signs_known else (np.zeros(10), 1.0)
    measured = _measured(model, sensor, 'squares', start, h, steps)
    posterior = PathPosterior(model, {'squares': sensor}, KernelSettings(h, r=r), mean,
                              variance * np.eye(10), measured, 0)
    easy = signs_known and r == 0
    setting = f'{steps} steps of {h:g} s, r = {r:g}' + ', N(0, 1) at first' * (not signs_known)
    return Window('ring of ten', setting, posterior, SamplerSettings(
        chains=4, draws=effort.scaled(1500 if r == 0 else 200, 50),
        warm_up=effort.scaled(200, 40), particles=50 if signs_known else 0, moves=2,
        temperatures=12 if signs_known else 16, least_share=0.1 if signs_known else 0.03),
        filtered=partial(_filtered, posterior, effort.scaled(PARTICLES)) if easy else None,
        mixes=easy)


def _filtered(posterior: PathPosterior, particles: int) -> tuple[Array, Array]:
    """Return the means at the last stamp of some particle filters, and their seconds per step."""
    means, seconds = [], []
    for seed in range(REPEATS):
        filter_ = ParticleFilter(posterior.model, posterior.sensors, posterior.kernel.time_step,
                                 particles=particles, seed=seed)
        began, now = time.perf_counter(), 0
        belief = filter_.gaussian(posterior.mean, posterior.covariance)
        for m in posterior.ordered:
            belief = filter_.predict(belief, now, m.stamp_ns)
            belief, _ = filter_.correct(belief, m.values, m.source, m.stamp_ns)
            now = m.stamp_ns
        seconds.append((time.perf_counter() - began) / len(posterior.ordered))
        means.append(belief.mean())
    return np.array(means), np.array(seconds)


def _last_deviation(drawn: PathSample, means: Array) -> float:
    average = drawn.average(lambda x: x)
    error = np.hypot(average.standard_error[-1],
                     means.std(axis=0, ddof=1) / np.sqrt(len(means)))
    return float(np.sqrt(np.mean(np.square((average.mean[-1] - means.mean(axis=0)) / error))))


def _particle_row(drawn: PathSample, means: Array, seconds: Array) -> Row:
    """Return what the means of a particle filter are worth, in independent draws."""
    worth = float((np.diagonal(drawn.covariance()[-1]) / means.var(axis=0, ddof=1)).min())
    cost = float(np.median(seconds))
    return Row('particle filter', f'of {PARTICLES:,}, ring of ten, r = 0, to the last stamp',
               cost, float(seconds.max()), accuracy={
                   'ESS': worth, 'ESS per s': worth / cost / (len(drawn.stamps_ns) - 1),
                   'deviation': _last_deviation(drawn, means)})
