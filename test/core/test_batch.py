"""Many beliefs through one kernel at a time: each as alone, to the bit."""

from unittest import mock

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from pif_ros.core.batch import Batch
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings, OperatorSettings, SplitKernel
from pif_ros.core.models import StateModel
from pif_ros.core.systems import coupled_trigonometric, lorenz_63, ornstein_uhlenbeck
import pytest
from scipy import sparse

SECOND = 1_000_000_000
STEP = 10_000_000
SEEDS = st.integers(0, 2**32 - 1)
PLANE = coupled_trigonometric().model
#: A drift that comes back every 25 steps, so that targets may be in different phases of it.
PERIODIC = StateModel(('x',), lambda x, t: np.sin(8 * np.pi * t) - x, [[1.0]], [[1.0]],
                      time_dependent=True, period=0.25)
LINE, BOX = Grid((-4,), (4,), (60,)), Grid((-6, -6), (6, 6), (70, 64))
SPACE = Grid((-30, -30, -5), (30, 30, 55), (12, 13, 14))


def made():
    """Return filters whose kernels are there."""
    filters = {
        'tabulated': DiracFeynmanFilter(PLANE, BOX, {}, KernelSettings(0.01)),
        'split': DiracFeynmanFilter(PLANE, BOX, {}, KernelSettings(0.01, form='split')),
        'of several steps': DiracFeynmanFilter(PLANE, BOX, {}, KernelSettings(0.01),
                                               operator=OperatorSettings(steps=3)),
        'longer steps': DiracFeynmanFilter(
            ornstein_uhlenbeck().model, LINE, {},
            KernelSettings(0.01, form='split', macro_error=1e-2)),
        'changing with time': DiracFeynmanFilter(PERIODIC, LINE, {}, KernelSettings(0.01)),
        'three axes': DiracFeynmanFilter(lorenz_63(sigma_x=10.0).model, SPACE, {},
                                         KernelSettings(0.05, form='split')),
    }
    for filter_ in filters.values():
        filter_.predict(filter_.uniform(), 0, STEP // 2)
    return filters


with mock.patch('pif_ros.core.compiler.compiler', return_value=None):
    FILTERS = made()
#: Those whose operators are no sparse arrays of doubles: compiled where there is a compiler.
OTHERS = {
    **{f'{kind}, compiled': filter_ for kind, filter_ in made().items()
       if kind in ('split', 'three axes')},
    'in a wavelet basis': DiracFeynmanFilter(
        PLANE, Grid((-6, -6), (6, 6), (16, 16)), {}, KernelSettings(0.01),
        operator=OperatorSettings(wavelet='sym4', level=1)),
}
ALL = {**FILTERS, **OTHERS}


def densities(grid, count, seed):
    """Return random densities with cells that are empty."""
    p = np.random.default_rng(seed).random((count, *grid.shape))
    p[p < 0.3] = 0
    return [GridBelief(grid, each).normalised() for each in p]


def assert_same_bits(found, wanted):
    np.testing.assert_array_equal(found.density.view(np.int64), wanted.density.view(np.int64))
    assert found.density.flags.c_contiguous


def test_the_cases_are_what_they_are_called():
    for kind in ('split', 'three axes', 'longer steps'):
        assert all(map(sparse.issparse, FILTERS[kind].kernel_at(0).factors))
    assert isinstance(OTHERS['split, compiled'].kernel_at(0), SplitKernel)
    assert FILTERS['longer steps'].time_step_ns > STEP
    changing = FILTERS['changing with time']
    assert changing.kernel_at(0) is changing.kernel_at(25 * STEP) is not changing.kernel_at(STEP)


@pytest.mark.parametrize('kind', ALL)
@given(SEEDS)
def test_each_is_predicted_as_alone_to_the_bit_whatever_the_spans(kind, seed):
    filter_, rng = ALL[kind], np.random.default_rng(seed)
    batch = Batch(filter_)
    # a batch that was larger, and smaller, has arrays of other sizes to work in
    for count in rng.integers(1, 7, 2):
        beliefs = densities(filter_.grid, count, seed)
        begin = rng.choice([0, STEP, 3 * STEP, STEP // 3, 1_700_000_000 * SECOND], count)
        length = rng.choice([0, STEP // 4, STEP, 4 * STEP, 5 * STEP + 1], count)
        spans = [(int(a), int(a + b)) for a, b in zip(begin, length)]
        found = batch.predict(beliefs, spans)
        for belief, span, each in zip(beliefs, spans, found):
            assert_same_bits(each, filter_.predict(belief, *span))


@pytest.mark.parametrize('kind', FILTERS)
def test_a_batch_of_one_camera_is_to_the_bit_what_each_is_alone(kind):
    filter_ = FILTERS[kind]
    beliefs = densities(filter_.grid, 16, 3)
    for belief, found in zip(beliefs, Batch(filter_).predict(beliefs, [(0, 7 * STEP + 3)] * 16)):
        assert_same_bits(found, filter_.predict(belief, 0, 7 * STEP + 3))


@pytest.mark.parametrize(('spans', 'widths'), [
    ([(0, 3 * STEP)] * 5, [5, 5, 5]),
    ([(0, 2 * STEP + 1)] * 5, [5, 5, 5]),
    ([(7, 2 * STEP), (0, 2 * STEP), (0, STEP)], [3, 2]),
    ([(0, STEP), (0, 0), (0, STEP)], [2]),
], ids=['the same', 'with a rest', 'others', 'nothing for one'])
def test_each_step_is_one_product_for_all_who_take_it(products, spans, widths):
    Batch(FILTERS['tabulated']).predict(densities(BOX, len(spans), 1), spans)
    assert products == widths


def test_a_split_kernel_is_one_product_for_each_order_of_its_axes(products):
    spans = [(0, STEP), (STEP, 2 * STEP), (0, STEP)]
    Batch(FILTERS['split']).predict(densities(BOX, 3, 1), spans)
    assert products == [2, 1]


def test_a_model_that_changes_with_time_is_one_product_for_each_phase(products):
    spans = [(0, STEP), (STEP, 2 * STEP), (25 * STEP, 26 * STEP)]
    Batch(FILTERS['changing with time']).predict(densities(LINE, 3, 1), spans)
    assert products == [2, 1]


def test_the_kernel_by_rows_holds_the_weights_of_the_kernel_itself():
    filter_ = FILTERS['tabulated']
    kernel = filter_.kernel_at(0)
    blocks = Batch(filter_)._cut(kernel).blocks
    assert len(blocks) > 1
    assert all(np.shares_memory(block.data, kernel.data) for block in blocks)
    assert all(np.shares_memory(block.indices, kernel.indices) for block in blocks)


def test_a_kernel_that_holds_at_one_time_only_is_not_kept():
    batch = Batch(FILTERS['changing with time'])
    batch.predict(densities(LINE, 2, 1), [(0, 3 * STEP)] * 2)
    assert batch._cuts == {}


def test_what_is_given_and_what_was_returned_stays_as_it_is():
    batch, beliefs = Batch(FILTERS['split']), densities(BOX, 3, 2)
    spans = [(0, STEP), (STEP, 2 * STEP), (0, 5)]
    before = [belief.density.copy() for belief in beliefs]
    found = batch.predict(beliefs, spans)
    copies = [belief.density.copy() for belief in found]
    batch.predict(densities(BOX, 3, 4), spans)
    np.testing.assert_array_equal([belief.density for belief in beliefs], before)
    np.testing.assert_array_equal([belief.density for belief in found], copies)


def test_a_span_that_runs_back_is_refused():
    with pytest.raises(ValueError, match='^spans: expected stamps from 5 on, got 3$'):
        Batch(FILTERS['split']).predict(densities(BOX, 2, 2), [(0, STEP), (5, 3)])


def test_nobody_is_predicted_to_nothing():
    assert Batch(FILTERS['split']).predict([], []) == []
