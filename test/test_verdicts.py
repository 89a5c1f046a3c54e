"""What a gate rejects is accounted for, also where a replay thinks better of it."""

from types import SimpleNamespace

from hypothesis import given, settings
from hypothesis import strategies as st
from pif_ros.accounts import Accounts
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Correction, CorrectionFailed, Measurement
from pif_ros.inbox import Inbox
from pif_ros.verdicts import ROOM, surprise, Verdicts
import pytest
from scipy import stats

SECOND = 1_000_000_000
CONFIG = Config.from_parameters({
    'model.name': 'ornstein_uhlenbeck', 'grid.lower': [-6], 'grid.upper': [6], 'grid.shape': [60],
    'prior.mean': [0.5], 'prior.covariance_diagonal': [0.4], 'kernel.time_step': 0.05,
    'measurements.names': ['near', 'far'], 'measurements.near.gate.tail_probability': 0.01,
    'measurements.far.gate.tail_probability': 0.001,
    'measurements.far.gate.max_consecutive_rejections': 2, 'time.history': 10.0})
TRACKER = build_tracker(CONFIG)


def inbox_of(tracker=None):
    """Return an inbox, its accounts, what it has said, and what puts a measurement into it."""
    accounts, said = Accounts(['near', 'far']), []
    if tracker is None:
        tracker = TRACKER
        tracker.reset()
    inbox = Inbox(tracker, accounts, CONFIG, lambda kind, text: said.append((kind, text)))

    def put(measurement):
        account = accounts.sources[measurement.source]
        account.received += 1
        inbox.put(SimpleNamespace(name=measurement.source, what='measurement', account=account),
                  measurement)

    return inbox, accounts.sources, said, put


def settle(inbox):
    """Let an inbox work until nothing waits."""
    while inbox.has_work:
        inbox.work()


def check_sums(inbox, sources):
    waiting = len(inbox.queue)
    assert sum(account.received for account in sources.values()) == waiting + sum(
        account.accepted + account.rejected.total() + account.dropped
        for account in sources.values())
    for account in sources.values():
        assert account.accepted >= 0 and min(account.rejected.values(), default=0) >= 0


@pytest.mark.parametrize('deviations', [0.0, 0.5, 3.0, 12.0])
def test_surprise_is_in_standard_deviations_of_a_gaussian(deviations):
    measurement = Measurement(0, 'near', (0.0,))
    log_peak = stats.norm(2.0, 0.3).logpdf(2.0)
    log_evidence = stats.norm(2.0, 0.3).logpdf(2.0 + 0.3 * deviations)
    assert surprise(Correction(measurement, log_evidence, log_peak)) == pytest.approx(deviations)
    # what is more likely than it can be, by rounding, surprises nobody
    assert surprise(Correction(measurement, log_peak + 1e-9, log_peak)) == 0


MEASUREMENTS = st.lists(
    st.builds(Measurement, st.integers(0, 2 * SECOND), st.sampled_from(['near', 'far']),
              st.tuples(st.sampled_from([0.3, 0.5, 3.0, 5.0, -5.0]) | st.floats(-6, 6))),
    min_size=1, max_size=20, unique=True)


@given(MEASUREMENTS, st.randoms(use_true_random=False))
@settings(max_examples=60, deadline=None)
def test_the_sums_always_hold_and_in_the_end_what_is_refused_is_that_of_arrival_in_order(
        seen, random):
    inbox, sources, _, put = inbox_of()
    random.shuffle(seen)
    for measurement in seen:
        put(measurement)
        if random.random() < 0.7:
            settle(inbox)
            check_sums(inbox, sources)
    settle(inbox)
    check_sums(inbox, sources)
    ordered = dict.fromkeys(sources, 0)
    TRACKER.reset()
    for measurement in sorted(seen):
        TRACKER.observe(measurement)
    TRACKER.estimate()
    for made in TRACKER.corrections:
        ordered[made.measurement.source] += made.gated
    assert {name: account.rejected['gate'] for name, account in sources.items()} == ordered


def test_a_late_measurement_clears_one_that_was_rejected_without_it():
    inbox, sources, said, put = inbox_of()
    put(Measurement(0, 'near', (0.5,)))
    put(Measurement(SECOND, 'far', (5.0,)))
    settle(inbox)
    assert (sources['far'].accepted, sources['far'].rejected['gate']) == (0, 1)
    assert any(kind == 'far: gate' for kind, _ in said)
    # what came between: with it the second rejection in a row brings the recovery
    put(Measurement(SECOND - 1000, 'far', (5.1,)))
    settle(inbox)
    assert (sources['far'].accepted, sources['far'].rejected['gate']) == (1, 1)
    check_sums(inbox, sources)


def test_one_at_which_a_sensor_raises_in_a_replay_is_a_fault_and_no_longer_refused():
    inbox, sources, _, put = inbox_of()
    gated = Measurement(SECOND, 'far', (5.0,))
    put(Measurement(0, 'near', (0.5,)))
    put(gated)
    settle(inbox)
    assert sources['far'].rejected['gate'] == 1
    healthy = TRACKER.guard

    class Moody:
        recovery, only_watches = healthy.recovery, healthy.only_watches

        def correct(self, filter_, predicted, y, source, at_ns, watch):
            if source == 'far':
                raise ArithmeticError('such a number')
            return healthy.correct(filter_, predicted, y, source, at_ns, watch)

    TRACKER.guard = Moody()
    try:
        put(Measurement(1000, 'near', (0.4,)))
        with pytest.raises(CorrectionFailed):
            settle(inbox)
    finally:
        TRACKER.guard = healthy
    assert (sources['far'].accepted, sources['far'].rejected['gate'],
            sources['far'].rejected['fault']) == (0, 0, 1)
    check_sums(inbox, sources)


def test_a_restart_lets_all_verdicts_stand():
    inbox, sources, _, put = inbox_of()
    same = [Measurement(0, 'near', (0.5,)), Measurement(SECOND, 'far', (5.0,))]
    for _ in range(2):
        for measurement in same:
            put(measurement)
        settle(inbox)
        inbox.restart(None, None)
    assert (sources['far'].received, sources['far'].rejected['gate']) == (2, 2)
    check_sums(inbox, sources)


def test_what_no_replay_can_reach_is_forgotten():
    accounts = Accounts(['near']).sources
    verdicts = Verdicts(accounts)
    for k in range(100 * ROOM):
        accounts['near'].accepted += 1
        verdicts.take(Correction(Measurement(k, 'near', (0.0,)), -40.0, 0.0, 0.0, True))
        verdicts.forget(k - 10)
    assert accounts['near'].rejected['gate'] == 100 * ROOM and accounts['near'].accepted == 0
    assert len(verdicts._found) <= 2 * ROOM
