"""Many targets in one process: each has what a filter node has, and their work is one."""

import functools
import time
from types import SimpleNamespace

from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
import numpy as np
from pif_ros import interface, pace, stopwatch, timekeeper
from pif_ros.config import build_tracker, Config, ConfigError
from pif_ros.core.batch import Batch
from pif_ros.core.estimates import Measurement
from pif_ros.core.tracker import Tracker
from pif_ros.diagnostics import timing_status
from pif_ros.filter_bank import FilterBank
from pif_ros.filter_node import FORECASTS_TAKE
from pif_ros.pace import Rest
import pytest
from ros import DEEP, nanoseconds, PLANE, SECOND, stamp_into, write_parameters
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger
import yaml

T = 1_000 * SECOND
MS = 1_000_000
NAMES = ('alpha', 'bravo', 'charlie')
#: What bravo has of its own.
OWN = {'prior.mean': [-1.0, 1.0], 'measurements.main.params.sigma': 0.8}
TRACK = [(0, 0.1, -0.2), (70, 0.3, 0.0), (200, -0.1, 0.4), (333, 0.4, 0.9), (1500, 0.6, 1.1)]


@pytest.fixture
def make(graph, tmp_path):
    """Return what makes a bank of parameters for all, for the bank and for single targets."""
    def made(shared=PLANE, targets=NAMES, *arguments, own=None):
        tree = {'/**': {'ros__parameters': dict(shared)},
                **{f'/{name}/filter_node': {'ros__parameters': dict(told)}
                   for name, told in (own or {}).items()}}
        if targets is not None:
            tree['filter_bank'] = {'ros__parameters': {'targets': targets if isinstance(
                targets, str) else list(targets)}}
        path = tmp_path / 'bank.yaml'
        path.write_text(yaml.safe_dump(tree), encoding='utf-8')
        with graph.refusals():
            bank = FilterBank(context=graph.context, use_global_arguments=False,
                              cli_args=['--ros-args', '--params-file', str(path), *arguments])
        for node in bank.nodes:
            graph.add(node)
        return bank
    return made


@pytest.fixture
def products(monkeypatch):
    """Return the numbers of targets in each product of several, from now on, uncompiled."""
    monkeypatch.setattr('pif_ros.core.compiler.compiler', lambda: None)
    widths, product = [], Batch._product

    def counting(self, K, P, other):
        widths.append(P.shape[1])
        return product(self, K, P, other)

    monkeypatch.setattr(Batch, '_product', counting)
    return widths


def measure(bank, name, stamp_ns, *values):
    """Let a measurement wait that a target has received."""
    target = bank.targets[name]
    inlet = next(iter(sources(target)))
    inlet.account.received += 1
    target.inbox.put(inlet, Measurement(stamp_ns, 'main', values))


def work(bank):
    """Work until nothing waits, as the executor lets the bank do."""
    while any(target.inbox.has_work for target in bank.targets.values()):
        bank._work()


def sources(target):
    """Return a target's sources out of its subscriptions."""
    return [subscription.callback.args[0] for subscription in target.subscriptions
            if hasattr(subscription.callback, 'args')]


def poses(graph, bank):
    """Return the poses that come from each target from now on."""
    peer, heard = graph.peer(), {name: [] for name in bank.targets}
    for name, into in heard.items():
        peer.create_subscription(PoseWithCovarianceStamped, f'/{name}/filter_node/pose',
                                 into.append, DEEP)
    graph.until(lambda: all(publisher.get_subscription_count() for target in bank.targets.values()
                            for publisher in target.publishers
                            if publisher.topic_name.endswith('filter_node/pose')), 'a meeting')
    return heard


def alone(**own):
    """Return the tracker of a filter node with these parameters."""
    return build_tracker(Config.from_parameters({**PLANE, **own}))


def assert_same_bits(found: Tracker, wanted: Tracker):
    found, wanted = found.estimate(), wanted.estimate()
    assert (found.stamp_ns, found.total_log_evidence) == (wanted.stamp_ns,
                                                          wanted.total_log_evidence)
    np.testing.assert_array_equal(found.belief.density.view(np.int64),
                                  wanted.belief.density.view(np.int64))


# What each has

def test_each_target_is_to_the_bit_what_a_node_of_its_own_is(graph, make):
    bank = make(own={'bravo': OWN})
    trackers = {name: alone(**OWN if name == 'bravo' else {}) for name in NAMES}
    heard, peer = poses(graph, bank), graph.peer()
    senders = {name: peer.create_publisher(PointStamped, f'/{name}/fix', DEEP) for name in NAMES}
    graph.until(lambda: all(s.get_subscription_count() for s in senders.values()), 'a meeting')
    for k, (ms, x, y) in enumerate(TRACK):
        for name in NAMES[:3 if k % 2 else 2]:
            message = PointStamped()
            stamp_into(message.header.stamp, T + ms * MS)
            message.point.x, message.point.y = x, y + (name == 'charlie')
            senders[name].publish(message)
            trackers[name].observe(Measurement(T + ms * MS, 'main', (x, message.point.y)))
        for name in NAMES[:3 if k % 2 else 2]:
            graph.until(lambda: heard[name] and nanoseconds(
                heard[name][-1].header.stamp) == T + ms * MS, 'a pose')
    for name in NAMES:
        assert_same_bits(bank.targets[name].tracker, trackers[name])
        mean = trackers[name].estimate().belief.mean()
        at = heard[name][-1].pose.pose.position
        np.testing.assert_array_equal([at.x, at.y], mean)
        assert bank.targets[name].accounts.sources['main'].accepted == len(heard[name])


def test_each_target_has_all_topics_and_services_of_a_filter_node_in_its_namespace(make):
    bank = make(targets=['alpha'])
    [alpha] = bank.targets.values()
    expected = {own.name.replace('~', '/alpha/filter_node') for own in interface.SERVICES}
    assert alpha.get_fully_qualified_name() == '/alpha/filter_node'
    found = {name if name.startswith('/') else f'/alpha/{name}' for name in expected}
    assert found <= {service.service_name for service in alpha.services}
    assert {own.name.replace('~', '/alpha/filter_node') for own in interface.PUBLICATIONS} <= {
        publisher.topic_name for publisher in alpha.publishers}
    assert {'/alpha/fix', '/alpha/initialpose'} <= {
        subscription.topic_name for subscription in alpha.subscriptions}


def test_all_are_below_the_namespace_of_the_process(make):
    bank = make(PLANE, None, '-r', '__ns:=/fleet', '-r', '__node:=bank',
                '-p', 'targets:=[alpha, bravo]')
    assert [node.get_fully_qualified_name() for node in bank.nodes] == [
        '/fleet/bank', '/fleet/alpha/filter_node', '/fleet/bravo/filter_node']


def test_targets_are_also_told_beside_the_file(make):
    bank = make(PLANE, ['alpha'], '-p', 'filter_bank:targets:=[bravo, charlie]',
                own={'bravo': OWN})
    assert list(bank.targets) == ['bravo', 'charlie']
    assert bank.get_parameter('targets').value == ['bravo', 'charlie']
    assert bank.targets['bravo'].config.prior.mean == (-1, 1)
    assert bank.targets['charlie'].config.prior.mean == (0.5, -0.5)


def test_a_reset_of_one_leaves_the_others_as_they_are(graph, make):
    bank = make()
    for name in NAMES:
        measure(bank, name, T, 0.1, 0.2)
    bank._work()
    client = graph.peer().create_client(Trigger, '/alpha/filter_node/reset')
    assert graph.call(client, Trigger.Request()).success
    assert [bank.targets[name].tracker.stamp_ns for name in NAMES] == [None, T, T]


# What they share

def test_one_kernel_is_in_memory_and_one_table_of_likelihoods_for_the_same_sensors(make):
    bank = make(own={'bravo': OWN})
    alpha, bravo, charlie = (bank.targets[name].tracker.filter for name in NAMES)
    assert alpha is charlie is not bravo
    assert bravo.kernel_at(0) is alpha.kernel_at(0)


def test_a_frame_that_measures_all_is_predicted_through_once_and_a_backlog_frame_by_frame(
        make, products):
    bank = make()
    for ms, x, y in TRACK:
        for name in NAMES:
            measure(bank, name, T + ms * MS, x, y)
    products.clear()
    work(bank)
    # 70, 130, 133 and 1167 ms in steps of 100 ms and rests
    assert products == [3] * (1 + 2 + 2 + 12)
    assert not any(target.inbox.has_work for target in bank.targets.values())
    exact = alone()
    for ms, x, y in TRACK:
        exact.observe(Measurement(T + ms * MS, 'main', (x, y)))
    for name in NAMES:
        assert_same_bits(bank.targets[name].tracker, exact)


def test_poses_are_predicted_to_now_together_and_corrections_to_what_was_published(
        graph, make, products):
    bank = make({**PLANE, 'use_sim_time': True, 'publish.rate': 1.0, 'time.max_ahead': 2.0})
    heard, peer = poses(graph, bank), graph.peer()
    clock = peer.create_publisher(Clock, '/clock', DEEP)
    graph.until(lambda: clock.get_subscription_count() >= 4, 'a meeting')

    def tick(now_ns):
        message = Clock()
        stamp_into(message.clock, now_ns)
        clock.publish(message)
        graph.until(lambda: all(t.now() == now_ns for t in bank.targets.values()), 'the time')

    def wait_for(stamp_ns):
        graph.until(lambda: all(h and nanoseconds(h[-1].header.stamp) == stamp_ns
                                for h in heard.values()), f'poses at {stamp_ns}')

    tick(T)
    products.clear()
    for name in NAMES:
        measure(bank, name, T, 0.1, 0.2)
    bank._work()
    assert products == []
    # whether the timer fires at this tick or was called for an earlier one, each is told once
    tick(T + 1050 * MS)
    bank._on_timer(Rest(FORECASTS_TAKE, 1.0), list(bank.targets.values()))
    wait_for(T + 1050 * MS)
    assert products == [3] * 11
    products.clear()
    for name in NAMES:
        measure(bank, name, T + 200 * MS, 0.0, 0.2)
    bank._work()
    # to the measurement, and from there to the pose that was published
    graph.until(lambda: [len(h) for h in heard.values()] == [3] * 3, 'corrected poses')
    assert products == [3] * 2 + [3] * 9
    exact = alone()
    exact.observe(Measurement(T, 'main', (0.1, 0.2)))
    exact.observe(Measurement(T + 200 * MS, 'main', (0.0, 0.2)))
    mean = exact.forecast(T + 1050 * MS).belief.mean()
    for each in heard.values():
        assert nanoseconds(each[-1].header.stamp) == T + 1050 * MS
        at = each[-1].pose.pose.position
        np.testing.assert_array_equal([at.x, at.y], mean)


def test_what_cannot_be_predicted_together_is_predicted_alone(make, monkeypatch):
    bank, exact = make(), alone()
    monkeypatch.setattr(bank._bank, 'foresee', lambda asked: 1 / 0)
    for ms, x, y in TRACK:
        exact.observe(Measurement(T + ms * MS, 'main', (x, y)))
        for name in NAMES:
            measure(bank, name, T + ms * MS, x, y)
    work(bank)
    for name in NAMES:
        assert_same_bits(bank.targets[name].tracker, exact)


def test_a_measurement_that_makes_a_sensor_fail_harms_its_target_alone(make, monkeypatch):
    bank, exact = make(), alone()
    correct = type(bank.targets['alpha'].tracker.filter).correct
    monkeypatch.setattr(
        type(bank.targets['alpha'].tracker.filter), 'correct',
        lambda self, p, y, *more: 1 / 0 if y[0] == 9 else correct(self, p, y, *more))
    for name in NAMES:
        measure(bank, name, T, 9.0 if name == 'bravo' else 0.1, 0.2)
        measure(bank, name, T + SECOND, 0.3, 0.2)
    work(bank)
    exact.observe(Measurement(T, 'main', (0.1, 0.2)))
    exact.observe(Measurement(T + SECOND, 'main', (0.3, 0.2)))
    assert_same_bits(bank.targets['alpha'].tracker, exact)
    accounts = {name: bank.targets[name].accounts.sources['main'] for name in NAMES}
    assert [account.accepted for account in accounts.values()] == [2, 1, 2]
    assert accounts['bravo'].rejected == {'fault': 1}


def test_targets_without_a_kernel_are_a_bank_too(make):
    shared = {**PLANE, 'filter.type': 'ekf'}
    bank, exact = make(shared, own={'bravo': OWN}), alone(**{'filter.type': 'ekf'})
    for ms, x, y in TRACK:
        exact.observe(Measurement(T + ms * MS, 'main', (x, y)))
        for name in NAMES:
            measure(bank, name, T + ms * MS, x, y)
    work(bank)
    np.testing.assert_array_equal(bank.targets['alpha'].tracker.estimate().belief.mean(),
                                  exact.estimate().belief.mean())
    assert bank.targets['bravo'].tracker.filter is not bank.targets['alpha'].tracker.filter


# What is refused

@pytest.mark.parametrize(('targets', 'got'), [
    (None, 'none'), (['alpha', 'alpha'], "['alpha', 'alpha']"), (['a/b'], "'a/b'"),
    (['2nd'], "'2nd'"), (['alpha', 'bra vo'], "'bra vo'"), (['a__b'], "'a__b'"), ([''], "''"),
    ([1, 2], '1'), ('', "''"),
    ([], 'none')], ids=str)
def test_targets_that_are_no_names_are_refused_in_one_line(make, targets, got):
    with pytest.raises(ConfigError) as error:
        make(targets=targets)
    assert str(error.value) == ('targets: expected names of namespaces, at least one and each '
                                f'once, got {got}')


@pytest.mark.parametrize(('told', 'line'), [
    ({'grid.shape': [20, 22]}, 'grid.shape: expected [20, 24] as /alpha/filter_node has, since '
     'all targets are on one kernel, got [20, 22]'),
    ({'model.params.diffusion': 0.6}, 'model.params.diffusion: expected 0.5 as /alpha/filter_node '
     'has, since all targets are on one kernel, got 0.6'),
    ({'kernel.time_step': 0.2}, 'kernel.time_step: expected 0.1 as /alpha/filter_node has, since '
     'all targets are on one kernel, got 0.2'),
    ({'prior.mean': [1.0]}, 'prior.mean: expected 2 values, one for each state, got [1.0]'),
    ({'measurements.main.params.sigma': -1.0}, 'sigma: expected'),
    ({'gird.shape': [20, 24]}, 'gird.shape: expected a known parameter'),
], ids=lambda value: next(iter(value)) if isinstance(value, dict) else '')
def test_what_makes_no_filter_on_the_kernel_of_all_is_refused_by_target_and_name(
        make, graph, told, line):
    with pytest.raises(ConfigError) as error:
        make(own={'charlie': told})
    assert str(error.value).startswith('/charlie/filter_node: ')
    assert line in str(error.value) and '\n' not in str(error.value)


def test_what_is_meant_for_the_targets_is_refused_where_only_the_bank_is_told(
        graph, tmp_path):
    path = write_parameters(tmp_path / 'bank.yaml', {**PLANE, 'targets': ['alpha']}, 'filter_bank')
    with pytest.raises(ConfigError, match='^grid.lower: expected among the parameters of /\\*\\* '
                       'or of a target such as /alpha/filter_node, got it among those of '
                       '/filter_bank$'), graph.refusals():
        FilterBank(context=graph.context, use_global_arguments=False,
                   cli_args=['--ros-args', '--params-file', str(path)])


def test_a_target_that_is_lost_says_so(graph, make):
    bank = make({**PLANE, 'recovery.when_lost': True}, ['alpha'])
    [target] = bank.targets.values()
    was_lost, said, report = [], [], target.report
    target.report = lambda kind, text: (said.append(kind), report(kind, text))
    for k in range(20):
        measure(bank, 'alpha', T + k * MS, 0.5, -0.5)
        work(bank)
    for k in range(12):
        measure(bank, 'alpha', T + (30 + k) * MS, -2.0, 2.5)
        work(bank)
        was_lost.append(target.tracker.newest.watch.lost)
    assert True in was_lost and said.count('lost') == 1


def test_a_target_tells_how_long_the_work_for_all_takes_and_what_was_skipped(
        make, monkeypatch):
    bank = make({**PLANE, 'publish.rate': 1000.0}, ['alpha', 'bravo'])
    now_ns = time.time_ns()
    for name in bank.targets:
        measure(bank, name, now_ns, 0.5, -0.5)
    work(bank)
    foresee, now = bank._foresee, [100.0]
    clock = SimpleNamespace(monotonic=lambda: now[0], perf_counter=lambda: now[0])
    for module in (pace, stopwatch):
        monkeypatch.setattr(module, 'time', clock)

    def slow(asked):
        now[0] += 0.005
        foresee(asked)

    bank._foresee, tick = slow, ticks(bank)[1000.0]
    for _ in range(4):
        # those are too soon that come within fifteen ms after one that took five of its periods
        tick()
        now[0] += 0.006
    assert now[0] == pytest.approx(100.034)
    for target in bank.targets.values():
        values = timing_status(target.facts()).values
        assert all(f'{kind}, ms (median, longest)' in values
                   for kind in ('work', 'predict', 'correct', 'forecast', 'publish'))
        assert values['poses skipped'] == '2'
        assert values['forecast, ms (median, longest)'] == '5.00, 5.00'


def test_targets_of_another_rate_do_not_wait_for_those_that_are_slow(make, monkeypatch):
    bank = make({**PLANE, 'publish.rate': 10.0}, ['alpha', 'bravo'],
                own={'bravo': {'publish.rate': 20.0}})
    now_ns, now = time.time_ns(), [100.0]
    for name in bank.targets:
        measure(bank, name, now_ns, 0.5, -0.5)
    work(bank)
    monkeypatch.setattr(pace, 'time', SimpleNamespace(monotonic=lambda: now[0]))
    foresee = bank._foresee

    def slow(asked):
        now[0] += 0.015
        foresee(asked)

    bank._foresee, of = slow, ticks(bank)
    for rate in (10.0, 20.0, 10.0, 20.0, 20.0):
        # sixty ms of rest are less than a period of the one, and more than one of the other
        of[rate]()
    assert [target.skipped for target in bank.targets.values()] == [0, 2]


def ticks(bank):
    """Return what the timers of forecasts call, by their rates in Hz."""
    return {1e9 / timer.timer_period_ns: timer.callback for target in bank.targets.values()
            for timer in target.timers if isinstance(timer.callback, functools.partial)}


def test_no_target_is_predicted_to_a_clock_that_was_set_before_it_has_seen_that(
        graph, make, monkeypatch):
    bank = make({**PLANE, 'publish.rate': 20.0, 'diagnostics.rate': 0.0}, ['alpha', 'bravo'])
    now_ns = bank.targets['alpha'].now()
    for name, target in bank.targets.items():
        target.now()
        measure(bank, name, now_ns, 0.5, -0.5)
    work(bank)
    steady = timekeeper.steady_ns
    monkeypatch.setattr(timekeeper, 'steady_ns', lambda: steady() - 3 * SECOND)
    bank._on_timer(Rest(FORECASTS_TAKE, 0.05), list(bank.targets.values()))
    assert [target.restarts for target in bank.targets.values()] == [1, 1]


def test_no_target_tells_by_an_older_clock_what_it_found_before_it_was_set(
        graph, make, monkeypatch):
    bank = make({**PLANE, 'publish.rate': 20.0, 'diagnostics.rate': 0.0}, ['alpha'])
    [target] = bank.targets.values()
    now_ns = target.now()
    measure(bank, 'alpha', now_ns - 200 * MS, 0.1, -0.2)
    work(bank)
    bank._on_timer(Rest(FORECASTS_TAKE, 0.05), [target])
    assert target._poses.epoch.newest_ns >= now_ns
    measure(bank, 'alpha', now_ns - 180 * MS, 0.1, -0.2)
    steady = timekeeper.steady_ns
    # as if the system's clock had been set back by an hour
    monkeypatch.setattr(timekeeper, 'steady_ns', lambda: steady() + 3600 * SECOND)
    work(bank)
    assert target.restarts == 1
    assert target._poses.epoch.newest_ns <= target.tracker.stamp_ns < now_ns - 3599 * SECOND


def test_nothing_is_foreseen_by_a_clock_that_was_set_back(graph, make, products, monkeypatch):
    bank = make({**PLANE, 'publish.rate': 20.0, 'diagnostics.rate': 0.0}, ['alpha', 'bravo'])
    now_ns = {name: target.now() for name, target in bank.targets.items()}
    for ahead in (-200, -180):
        products.clear()
        for name in bank.targets:
            measure(bank, name, now_ns[name] + ahead * MS, 0.1, -0.2)
        if ahead == -180:
            steady = timekeeper.steady_ns
            monkeypatch.setattr(timekeeper, 'steady_ns', lambda: steady() + 600 * SECOND)
        work(bank)
    assert [target.restarts for target in bank.targets.values()] == [1, 1]
    # a step and its rest, and not six thousand of them
    assert len(products) < 10


def test_after_a_gap_a_target_begins_from_the_prior_as_a_node_does(graph, make):
    bank = make({**PLANE, 'time.max_gap': 10.0}, ['alpha'])
    [target] = bank.targets.values()
    for stamp_ns in (T, T + 100 * SECOND):
        measure(bank, 'alpha', stamp_ns, 0.1, -0.2)
        work(bank)
    one = alone()
    one.observe(Measurement(T + 100 * SECOND, 'main', (0.1, -0.2)))
    assert target.inbox.gaps == 1
    assert_same_bits(target.tracker, one)
