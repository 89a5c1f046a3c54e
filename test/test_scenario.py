"""What a simulator plays, without ROS."""

import dataclasses
from pathlib import Path

import numpy as np
from pif_ros.config import build_tracker, Config, ConfigError
from pif_ros.scenario import BEGIN_NS, drawn, scenario, Settings
import pytest
import yaml

FOLDER = Path(__file__).resolve().parents[1] / 'config'
FILES = sorted(FOLDER.glob('*.yaml'))

LINE = {'model.name': 'ornstein_uhlenbeck', 'grid.lower': [-4.0], 'grid.upper': [4.0],
        'grid.shape': [40], 'prior.mean': [0.5], 'prior.covariance_diagonal': [0.25],
        'kernel.time_step': 0.1}
PLANE = {'model.name': 'position_2d', 'measurements.main.sensor': 'position',
         'measurements.main.params.sigma': 0.3, 'prior.covariance_diagonal': [1.0, 1.0],
         'kernel.time_step': 0.1}


def played(parameters=LINE, **settings):
    """Return what is simulated of some parameters and settings."""
    return scenario(Config.from_parameters(parameters),
                    Settings.from_values({'duration': 1.0, **settings}))


def same(one, other):
    """Return whether two simulations are the same to the last bit."""
    return all(a.tobytes() == b.tobytes() for a, b in (
        (one.elapsed_ns, other.elapsed_ns), (one.truth, other.truth),
        *((one.measurements[name], other.measurements[name]) for name in one.measurements)))


def test_the_same_seed_gives_the_same_bits_and_another_gives_others():
    first = played(seed=3)
    assert same(first, played(seed=3))
    other = played(seed=4)
    assert np.all(other.truth != first.truth)
    assert np.all(other.measurements['main'] != first.measurements['main'])


def test_the_truth_is_the_same_whatever_is_measured_of_it():
    more = {**PLANE, 'measurements.names': ['main', 'more'], 'measurements.more.sensor': 'range',
            'measurements.more.params.landmark': [1.0, 2.0], 'measurements.more.params.sigma': 1.0}
    one, two = played(PLANE), played(more)
    assert one.truth.tobytes() == two.truth.tobytes()
    assert one.measurements['main'].tobytes() == two.measurements['main'].tobytes()
    errors = two.measurements['more'][:, 0] - np.hypot(*(two.truth - [1.0, 2.0]).T)
    # that the two errors are the same numbers would be a correlation of 1, not of 1 / sqrt(11)
    assert abs(np.corrcoef(errors, two.measurements['main'][:, 0] - two.truth[:, 0])[0, 1]) < 0.9


def test_the_truth_is_the_same_however_the_filter_saves_its_work():
    one, two = played(), played({**LINE, 'operator.steps': 10})
    assert one.truth.tobytes() == two.truth.tobytes()


def test_a_simulation_has_a_measurement_at_its_beginning_and_at_each_interval():
    simulation = played(rate=8.0, duration=2.6)
    assert simulation.elapsed_ns.tolist() == [125_000_000 * k for k in range(21)]
    assert simulation.truth.shape == (21, 1) and simulation.measurements['main'].shape == (21, 1)
    assert played(duration=1.0).elapsed_ns.tolist() == [100_000_000 * k for k in range(11)]


def test_a_simulation_begins_where_it_is_told_to_or_in_the_prior():
    assert played(start=[1.5]).truth[0] == [1.5]
    starts = [played(seed=seed).truth[0, 0] for seed in range(10)]
    assert len(set(starts)) == 10 and np.all(np.abs(np.array(starts) - 0.5) < 4 * 0.5)
    rng = np.random.default_rng(1)
    of_prior = np.array([drawn(Config.from_parameters(LINE), rng) for _ in range(2_000)])
    # a mean has the standard error 0.5 / sqrt(2000), a standard deviation 0.5 / sqrt(4000)
    assert of_prior.mean() == pytest.approx(0.5, abs=5 * 0.011)
    assert of_prior.std() == pytest.approx(0.5, abs=5 * 0.008)
    config = Config.from_parameters({**LINE, 'prior.type': 'uniform'})
    uniform = np.array([drawn(config, rng) for _ in range(2_000)])
    assert -4 <= uniform.min() < -3.9 and 3.9 < uniform.max() <= 4


def test_the_truth_stays_on_the_grid_unless_it_may_leave():
    wide = {**LINE, 'grid.lower': [-0.6], 'grid.upper': [1.2], 'prior.covariance_diagonal': [0.01]}
    kept = [played(wide, seed=seed).truth for seed in range(8)]
    free = [played(wide, seed=seed, inside=False).truth for seed in range(8)]
    assert all(truth.min() >= -0.6 and truth.max() <= 1.2 for truth in kept)
    assert any(truth.min() < -0.6 or truth.max() > 1.2 for truth in free)


def test_a_periodic_axis_has_no_edge_to_leave_by():
    circle = {**LINE, 'model.name': 'wiener', 'grid.periodic': [True], 'grid.lower': [-0.1],
              'grid.upper': [0.1], 'prior.mean': [0.0], 'prior.covariance_diagonal': [1e-4]}
    assert np.abs(played(circle).truth).max() > 0.1


@pytest.mark.parametrize('kind', ['dfy', 'ekf_continuous'])
def test_a_filter_of_paths_gets_a_path_that_begins_at_0(kind):
    of_path = played({**LINE, 'filter.type': kind}, duration=20.0)
    y, x = of_path.measurements['main'], of_path.truth
    assert y[0] == 0.0
    assert same(of_path, played(duration=20.0, path=True))
    # what is left is noise of variance 0.25 per second, and the rule's error, which is less
    left = np.diff(y[:, 0]) - (x[1:, 0] + x[:-1, 0]) / 2 * 0.1
    assert left.var() == pytest.approx(0.025, rel=0.4)


def test_what_is_measured_of_states_has_the_sensors_noise():
    simulation = played(duration=40.0)
    errors = simulation.measurements['main'] - simulation.truth
    # a variance of 401 numbers has the relative standard error sqrt(2 / 401)
    assert errors.var() == pytest.approx(0.25, rel=5 * 0.07)


def test_the_truth_moves_in_the_sense_in_which_the_filter_takes_the_noise():
    growth = {**LINE, 'model.name': 'geometric_brownian_motion', 'grid.lower': [0.0],
              'grid.upper': [50.0], 'prior.mean': [1.0], 'model.params.sigma': 0.4}
    ito, other = (played({**growth, 'kernel.s': s}, start=[1.0]).truth[-1, 0] for s in (0, 1.0))
    # over a second the drift of log x is larger by s sigma^2 = 0.16
    assert np.log(other / ito) == pytest.approx(0.16, rel=0.05)


@pytest.mark.parametrize('parameters, settings, name', [
    (LINE, {'seed': -1}, 'seed'), (LINE, {'seed': 1.5}, 'seed'), (LINE, {'seed': True}, 'seed'),
    (LINE, {'duration': 0.0}, 'duration'), (LINE, {'duration': 0.05}, 'duration'),
    (LINE, {'rate': -1.0}, 'rate'), (LINE, {'start': [1.0, 2.0]}, 'start'),
    (LINE, {'start': [9.0]}, 'start'), (LINE, {'substeps': 0}, 'substeps'),
    (LINE, {'inside': 'no'}, 'inside'), (LINE, {'durations': 1.0}, 'durations'),
    ({**LINE, 'grid.lower': [0.4], 'grid.upper': [0.6]}, {}, 'duration'),
    ({**LINE, 'model.name': 'x'}, {}, 'model.name'),
    ({**LINE, 'prior.mean': [0.0, 1.0]}, {}, 'prior.mean'),
])
def test_what_cannot_be_simulated_is_refused_in_one_line_by_its_name(parameters, settings, name):
    with pytest.raises(ConfigError) as refused:
        played(parameters, **settings)
    line = str(refused.value)
    assert line.startswith(f'{name}: expected ') and '\n' not in line


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.stem)
def test_every_example_can_be_simulated_for_as_long_as_it_says(path):
    own = (yaml.safe_load(path.read_text()).get('simulate') or {}).get('ros__parameters', {})
    settings = dataclasses.replace(Settings.from_values(own), substeps=5)
    config = Config.from_yaml(path)
    simulation = scenario(config, settings)
    assert simulation.elapsed_ns[-1] == pytest.approx(settings.duration * 1e9, rel=1e-9)
    assert np.all(np.isfinite(simulation.truth))
    for name, sensor in build_tracker(config).filter.sensors.items():
        assert simulation.measurements[name].shape == (len(simulation.elapsed_ns), sensor.size)
        assert np.all(np.isfinite(simulation.measurements[name]))


def test_there_is_time_before_the_first_measurement():
    assert BEGIN_NS > 0


# What drives a model with inputs

YARD = {'model.name': 'unicycle_2d', 'model.params.sigma_position': 1e-6,
        'model.params.sigma_heading': 1e-6, 'filter.type': 'ekf',
        'grid.lower': [-90.0, -90.0, -4.0], 'grid.upper': [90.0, 90.0, 4.0],
        'grid.shape': [4, 4, 4], 'prior.mean': [0.0, 0.0, 0.0],
        'prior.covariance_diagonal': [1.0, 1.0, 1.0], 'kernel.time_step': 0.1,
        'measurements.main.sensor': 'position', 'measurements.main.params.sigma': 0.3}


def test_what_drives_is_the_same_for_the_same_seed_and_begins_with_the_simulation():
    one, two, other = (played(YARD, seed=seed, rate=5.0) for seed in (3, 3, 4))
    assert one.controls == two.controls != other.controls and same(one, two)
    assert one.controls.stamps_ns == tuple(BEGIN_NS + 200_000_000 * k for k in range(6))
    assert one.controls.hold_ns == 1_000_000_000
    assert played().controls.values == ()


def test_the_truth_is_driven_by_what_is_sent():
    simulation = played(YARD, start=[0.0, 0.0, 0.5], drive=[2.0, 0.5], wander=[0.5, 0.2])
    x = simulation.truth[0]
    for (v, omega), found in zip(simulation.controls.values, simulation.truth[1:]):
        # Euler's ten steps of 10 ms: off by omega v h^2 / 2 each, 1e-3 in ten intervals
        middle = x[2] + omega * 0.05
        x = x + 0.1 * np.array([v * np.cos(middle), v * np.sin(middle), omega])
        np.testing.assert_allclose(found, x, atol=5e-3)
    assert np.hypot(*x[:2]) > 1.0


def test_a_control_that_holds_for_less_than_an_interval_drives_for_as_long_as_it_holds():
    parameters = {**YARD, 'control.hold': 0.5}
    simulation = played(parameters, start=[0.0] * 3, rate=0.5, duration=20.0, drive=[1.0, 0.0],
                        wander=[1e-9, 1e-9])
    # half a metre in each of ten intervals
    np.testing.assert_allclose(simulation.truth[-1], [5.0, 0.0, 0.0], atol=1e-4)


def test_a_control_wanders_about_its_mean_and_forgets_itself_in_five_seconds():
    u = np.array(played(YARD, duration=20_000.0, rate=1.0, inside=False, substeps=1,
                        drive=[1.0, -2.0], wander=[0.5, 0.1]).controls.values)
    # 20000 s hold about 20000 / (2 * 5) independent values: errors of 1 / sqrt(2000) of each
    np.testing.assert_allclose(u.mean(axis=0), [1.0, -2.0], atol=5 * 0.5 / 2000**0.5)
    np.testing.assert_allclose(u.std(axis=0), [0.5, 0.1], rtol=5 / 4000**0.5)
    correlation = np.corrcoef(u[:-5, 0], u[5:, 0])[0, 1]
    assert correlation == pytest.approx(np.exp(-1), abs=5 / 2000**0.5)


@pytest.mark.parametrize(('parameters', 'settings', 'line'), [
    (YARD, {'drive': [1.0]}, 'drive: expected 2 values, one for each input (v, omega), got [1.0]'),
    (YARD, {'wander': [1.0] * 3}, 'wander: expected 2 values, one for each input (v, omega)'),
    (LINE, {'drive': [1.0]}, 'drive: expected 0 values, one for each input (the model has none)')])
def test_refuses_what_cannot_drive(parameters, settings, line):
    with pytest.raises(ConfigError) as refused:
        played(parameters, **settings)
    assert str(refused.value).startswith(line)
