"""The compiled engine beside numpy and scipy: operators in blocks, the correction, precision."""

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from pif_ros.core import compiler
from pif_ros.core import posterior as posteriors
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import blocks, KernelSettings, loops, single, split_kernel
from pif_ros.core.kernels.blocks import BlockFactor
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.posterior import NEGLIGIBLE, posterior
from pif_ros.core.systems import coupled_trigonometric, lorenz_63
import pytest
from scipy import sparse

SYSTEM = coupled_trigonometric()
STEP = 10_000_000
HERE = compiler.is_available()
needs_a_compiler = pytest.mark.skipif(not HERE, reason='numba is not installed')
WAYS = [pytest.param(True, marks=needs_a_compiler), False]


@pytest.fixture
def without(monkeypatch):
    """Return what runs a function as if there were no compiler."""
    def run(function, *arguments):
        with monkeypatch.context() as patch:
            patch.setattr(compiler, 'is_available', lambda: False)
            return function(*arguments)
    return run


@pytest.fixture(params=WAYS, ids=['compiled', 'plain'])
def either_way(request, monkeypatch):
    """Run a test with the compiler, and once more without."""
    monkeypatch.setattr(compiler, 'is_available', lambda: request.param)


def box(cells):
    return Grid((-6.0, -6.0), (6.0, 6.0), (cells, cells))


def filter_(cells, **kernel):
    return DiracFeynmanFilter(SYSTEM.model, box(cells), {'squares': SYSTEM.sensors['squares']()},
                              KernelSettings(0.01, form='split', **kernel))


def run(made, steps):
    """Return the belief and the summed log evidence after steps with a measurement each."""
    rng, total = np.random.default_rng(0), 0.0
    belief = made.gaussian([0, 0], 10 * np.eye(2))
    for k in range(steps):
        belief = made.predict(belief, k * STEP, (k + 1) * STEP)
        y = (2.0, 1.0) + rng.standard_normal(2)
        belief, log_evidence = made.correct(belief, y, 'squares', (k + 1) * STEP)
        total += log_evidence
    return belief, total


# Operators in blocks

@needs_a_compiler
@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.floats(0, 1))
@settings(max_examples=60, deadline=None)
def test_an_operator_in_blocks_is_its_dense_matrix(seed, size, density):
    rng = np.random.default_rng(seed)
    dense = np.where(rng.random((size, size)) < density, rng.normal(size=(size, size)), 0)
    made, p = BlockFactor.of(sparse.csc_array(dense)), rng.normal(size=size)
    np.testing.assert_array_equal(made.toarray(), dense)
    np.testing.assert_array_equal(made.T.toarray(), dense.T)
    assert made.nnz == np.count_nonzero(dense) and made.shape == dense.shape
    # sums of at most 40 products of about 1, in any order
    np.testing.assert_allclose(made @ p, dense @ p, atol=40 * 1e-15)
    np.testing.assert_array_equal((made @ np.stack([-p, p], axis=1))[:, 1], made @ p)


@needs_a_compiler
@pytest.mark.parametrize('model, grid', [
    (SYSTEM.model, box(41)),
    (SYSTEM.model, Grid((-6.0, -6.0), (6.0, 6.0), (30, 7), (False, True))),
    (StateModel(('a', 'b'), lambda x, t: 40 * np.sin(7 * x), np.eye(2)), box(33)),
    (StateModel(('a', 'b'), lambda x, t: -x, np.array([[1.0, 0], [0.5, 1]])), box(40)),
    (lorenz_63(sigma_x=10.0).model, Grid((-30.0, -30.0, -5.0), (30.0, 30.0, 55.0), (17, 20, 23))),
], ids=['plane', 'periodic', 'strong', 'correlated', 'space'])
def test_a_compiled_kernel_moves_as_sparse_arrays_do_to_the_bit(model, grid, without):
    how = KernelSettings(0.01)
    fast, plain = split_kernel(model, grid, how), without(split_kernel, model, grid, how)
    assert all(isinstance(factor, BlockFactor) for factor in fast.factors)
    assert not any(isinstance(factor, BlockFactor) for factor in plain.factors)
    assert fast.nnz == plain.nnz
    p = np.random.default_rng(1).random(grid.size)
    # every sum in the order of its columns, and rounded as often
    np.testing.assert_array_equal(fast @ p, plain @ p)
    np.testing.assert_allclose(fast.T @ p, plain.T @ p, rtol=1e-13)


@needs_a_compiler
def test_an_operator_that_would_be_mostly_zeros_in_blocks_stays_as_it_is():
    rng = np.random.default_rng(0)
    scattered = sparse.csc_array(np.eye(400)[:, rng.permutation(400)])
    assert blocks.compiled(scattered) is scattered
    assert isinstance(blocks.compiled(sparse.csc_array(np.eye(400))), BlockFactor)


@needs_a_compiler
def test_what_is_not_worth_carrying_is_left_out_and_no_more(without):
    how, grid = KernelSettings(0.01), box(160)
    fast = split_kernel(SYSTEM.model, grid, how)
    plain = without(split_kernel, SYSTEM.model, grid, how)
    p = q = GridBelief.gaussian(grid, (2.0, -3.0), 0.02 * np.eye(2)).density.ravel()
    assert grid.size >= blocks.SPARED
    for k in range(10):
        p, q = fast @ p, plain @ q
    assert np.count_nonzero(p) < grid.size / 2 < np.count_nonzero(q)
    assert 0 < np.abs(p - q).sum() < 1e-20 * q.sum()
    # ten steps of two factors leave out the share of all cells each time at most; where both have
    # something they differ by what has come from there
    np.testing.assert_allclose(p, q, rtol=1e-13,
                               atol=20 * grid.size * blocks.LEAST_SHARE * q.max())


@needs_a_compiler
@pytest.mark.parametrize('seed', range(30))
def test_whatever_an_operator_reaches_is_reached_where_most_cells_are_empty(seed):
    rng, size = np.random.default_rng(seed), blocks.SPARED + 997
    # near cells, some across a seam, others nowhere: whole tiles of rows take from none
    rows = rng.choice(size, size // 3, replace=False)
    rows = rows[(rows < 4000) | (rows > 9000)]
    columns = (rows + rng.integers(-30, 31, len(rows))) % size
    K = sparse.csr_array((rng.uniform(size=len(rows)), (rows, columns)), (size, size))
    factors = BlockFactor.of(K), BlockFactor.of(K.T.tocsr())
    p = np.zeros(size)
    held = rng.choice(size, 50, replace=False)
    p[held] = 10.0 ** rng.uniform(-20, 0, len(held))
    np.testing.assert_allclose(blocks.product(factors, p), K.T @ (K @ p), rtol=1e-14, atol=0)
    assert np.count_nonzero(K.T @ (K @ p)) > 3


@needs_a_compiler
def test_two_far_humps_are_carried_as_each_alone():
    grid = box(200)
    K = split_kernel(SYSTEM.model, grid, KernelSettings(0.01))
    one, two = (GridBelief.gaussian(grid, mean, 0.02 * np.eye(2)).density.ravel()
                for mean in ((-4.0, 4.0), (4.0, -4.0)))
    both = K @ (one + 1e-6 * two)
    np.testing.assert_allclose(both, K @ one + 1e-6 * (K @ two), rtol=1e-13,
                               atol=grid.size * blocks.LEAST_SHARE * one.max())
    assert both[two > 0.1 * two.max()].min() > 0


# The correction

@needs_a_compiler
@given(st.integers(0, 2**32 - 1), st.integers(1, 700))
@settings(max_examples=80, deadline=None)
def test_the_compiled_posterior_is_the_plain_one_to_rounding(seed, size):
    rng = np.random.default_rng(seed)
    p, log_l = rng.random(size), rng.normal(scale=10**rng.uniform(-1, 2), size=size)
    p[rng.random(size) < rng.uniform(0, 0.9)] = 0
    log_l[rng.random(size) < 0.05] = rng.choice([np.nan, -np.inf, -1e6])
    plain, compiled = both_ways(p, log_l)
    if plain is None:
        assert compiled is None
        return
    # the largest of some hundred sums and exponentials, an ulp or two each
    np.testing.assert_allclose(compiled[0], plain[0], rtol=1e-12, atol=2 * NEGLIGIBLE)
    assert compiled[1] == pytest.approx(plain[1], rel=1e-12, abs=1e-12)


@needs_a_compiler
@pytest.mark.parametrize('p, log_l', [
    ([0.0, 1e-200, 1.0], [0.0, -1.0, -2000.0]), ([1.0, 0.0], [-5000.0, 0.0]),
    ([0.0, 0.0], [1.0, 2.0]), ([1.0, 1.0], [np.nan, np.nan]), ([1.0, 1.0], [np.nan, -3.0]),
    ([1.0, 0.5], [-np.inf, -np.inf])])
def test_an_outlier_or_no_likelihood_at_all_ends_alike_either_way(p, log_l):
    plain, compiled = both_ways(np.array(p), np.array(log_l))
    if plain is None:
        assert compiled is None
    else:
        np.testing.assert_allclose(compiled[0], plain[0], rtol=1e-12, atol=1e-200)
        assert compiled[1] == pytest.approx(plain[1], rel=1e-12)


def both_ways(p, log_l):
    """Return the posteriors without and with the compiler."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, 'is_available', lambda: False)
        plain = posterior(p, log_l, 0.1)
    return plain, posterior(p, log_l, 0.1)


@needs_a_compiler
def test_a_filter_gives_the_same_belief_and_evidence_either_way(without):
    fast, plain = run(filter_(50), 60), without(run, filter_(50), 60)
    # a step takes some ten roundings of a share of 1e-16, and what was corrected is forgotten
    np.testing.assert_allclose(fast[0].density, plain[0].density, rtol=1e-11,
                               atol=1e-13 * plain[0].density.max())
    assert fast[1] == pytest.approx(plain[1], rel=1e-12)


@needs_a_compiler
@pytest.mark.parametrize('sensor', [
    Sensor(lambda x, t: np.arctan2(x[1:], x[:1]), [[0.01]], angular=(True,)),
    Sensor(lambda x, t: np.log(x[:1]), [[0.1]]),
    Sensor(lambda x, t: x[:1] * x[1:], [[1e-3]]),
    Sensor(lambda x, t: x + t, 1e-3 * np.eye(2), time_dependent=True)],
    ids=['angular', 'undefined on half of the grid', 'narrower than a cell',
         'narrower than a cell, and changing'])
def test_other_sensors_give_the_same_either_way(sensor, without):
    made = DiracFeynmanFilter(SYSTEM.model, box(30), {'other': sensor}, KernelSettings(0.01))
    start, y = made.gaussian([0.5, 0.2], np.eye(2)), np.full(sensor.size, 0.3)
    with np.errstate(invalid='ignore', divide='ignore'):
        fast = made.correct(start, y, 'other', STEP)
        plain = without(made.correct, start, y, 'other', STEP)
    np.testing.assert_allclose(fast[0].density, plain[0].density, rtol=1e-12, atol=1e-200)
    assert fast[1] == pytest.approx(plain[1], rel=1e-12)


@needs_a_compiler
@pytest.mark.parametrize('changes', [False, True])
@pytest.mark.parametrize('precision', ['double', 'single'])
def test_nothing_is_compiled_after_the_filter_was_described(precision, changes, monkeypatch):
    made = filter_(150, precision=precision)
    if changes:
        made = replace(made, model=replace(SYSTEM.model, time_dependent=True))
    for module in (loops, posteriors):
        module._loops.cache_clear()
    made.describe()
    monkeypatch.setattr(compiler.compiler(), 'njit', None)
    run(made, 2)


# Precision

def test_single_precision_differs_from_double_by_its_rounding_alone(either_way):
    steps = 200
    (double, evidence), (narrow, other) = (run(filter_(50, precision=precision), steps)
                                           for precision in ('double', 'single'))
    p, q = double.density, narrow.density
    # each step rounds a weight, a product and at most five sums on either axis, and the density
    # on its way in: 15 times 2^-24 of a cell's density at most; a correction divides by a sum of
    # them, which doubles that, and from then on it is carried along without growing
    most = steps * 2 * 15 * 2.0**-24
    l1 = np.abs(p - q).sum() * double.grid.cell_volume
    assert 0 < l1 < most
    # roundings to either side: they add up like the root of their number
    assert l1 < most / np.sqrt(steps)
    assert other == pytest.approx(evidence, abs=most)
    assert narrow.density.dtype == float


def test_single_precision_loses_no_mass_over_many_steps(either_way):
    grid = box(40)
    K = split_kernel(SYSTEM.model, grid, KernelSettings(0.01, precision='single'))
    D = split_kernel(SYSTEM.model, grid, KernelSettings(0.01))
    p = q = GridBelief.gaussian(grid, (0.0, 0.0), np.eye(2)).density.ravel()
    for _ in range(500):
        p, q = K @ p, D @ q
    # a column sums to 1 within 5 roundings of 2^-25 at most and 2^-25 or so on the average
    assert p.sum() == pytest.approx(q.sum(), rel=500 * 2 * 2.0**-25)


def test_a_density_in_single_precision_has_no_slow_numbers_whatever_its_unit(either_way):
    shares = np.array([1e-40, 1e-26, 1e-24, 0.5, 1.0, 0.0])
    for unit in (1e-200, 1.0, 1e200):
        narrow, densest = single.narrow(shares * unit)
        assert narrow.dtype == np.float32
        np.testing.assert_allclose(narrow, [0, 0, 1e-24, 0.5, 1, 0], rtol=1e-7)
        np.testing.assert_allclose(single.widen(narrow, densest) / unit, narrow, rtol=1e-7)
    np.testing.assert_array_equal(single.widen(*single.narrow(np.zeros(5))), 0)
    many, densest = single.narrow(np.outer(shares, [1.0, 3.0]))
    np.testing.assert_allclose(densest, [1, 3])


def test_single_precision_halves_the_memory(either_way):
    double, narrow = (filter_(60, precision=precision).kernel_at(0)
                      for precision in ('double', 'single'))
    assert double.nnz == narrow.nnz and narrow.nbytes < 0.75 * double.nbytes
    assert all(factor.dtype == np.float32 for factor in narrow.factors)


def test_single_precision_is_refused_where_the_kernel_is_tabulated():
    with pytest.raises(ValueError, match="^precision: expected 'double' where .* got 'single'$"):
        DiracFeynmanFilter(SYSTEM.model, box(20), {}, KernelSettings(0.01, precision='single'))
    with pytest.raises(ValueError, match="^precision: expected 'double' or 'single', got 'half'"):
        KernelSettings(0.01, precision='half')


def test_the_loops_take_as_many_cells_at_once_as_the_blocks_have():
    assert loops.LANES == 8
