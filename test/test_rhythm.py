"""Missing messages, told from jitter, pauses, changes of rate and bursts by the stamps alone."""

import numpy as np
import pytest

from friction_estimator.core.intake.rhythm import SLOWER_LOOKS, Rhythm
from friction_estimator.core.sample import NS_PER_S

START = 1_700_000_000 * NS_PER_S


def stamped(count, rate_hz, jitter=0.0, seed=0):
    rng = np.random.default_rng(seed)
    step = NS_PER_S / rate_hz
    return (START + step * (np.arange(count) + jitter * rng.uniform(-1, 1, count))).astype(np.int64)


def looked(rhythm, stamps, size=1000):
    return sum(rhythm.look(stamps[k : k + size].tolist()) for k in range(0, stamps.size, size))


@pytest.mark.parametrize("rate_hz", [10.0, 200.0, 1000.0, 5000.0])
@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("lost", [0.0, 0.001, 0.1, 0.3])
def test_lost_messages_are_counted_within_one_percent(rate_hz, jitter, lost):
    stamps = stamped(20_000, rate_hz, jitter)
    keep = np.random.default_rng(1).random(stamps.size) >= lost
    keep[:2000] = keep[-1] = True
    found = looked(Rhythm(), stamps[keep])
    wanted = int((~keep).sum())
    assert found <= 1.01 * wanted
    # Where stamps are late and early by half a period all the time, single losses cannot be told from that.
    assert found >= (0.99 * wanted if jitter < 0.2 else 0.75 * wanted if lost > 0.01 else 0)


def test_once_the_rhythm_is_known_most_may_be_missing():
    rhythm = Rhythm()
    stamps = stamped(40_000, 1000.0)
    looked(rhythm, stamps[:1000])
    rest = stamps[1000:]
    keep = np.random.default_rng(2).random(rest.size) < 0.05
    keep[-1] = True
    assert abs(looked(rhythm, rest[keep], 50) - (~keep).sum()) <= 0.01 * (~keep).sum()


def test_bursts_have_no_rhythm():
    """A driver that stamps two messages at a time as they come."""
    pairs = stamped(2000, 500.0)
    rhythm = Rhythm()
    assert looked(rhythm, np.sort(np.concatenate([pairs, pairs + 100_000]))) == 0
    assert np.isnan(rhythm.period_ns)


def test_pauses_repeats_disorder_and_jumps_are_no_loss():
    rhythm = Rhythm()
    stamps = stamped(3000, 500.0)
    assert looked(rhythm, stamps) == 0
    later = stamps + 100 * NS_PER_S
    assert looked(rhythm, later) == 0  # a pause
    assert looked(rhythm, np.repeat(later + 10 * NS_PER_S, 3)) == 0
    blocks = (later + 20 * NS_PER_S).reshape(-1, 10).copy()
    np.random.default_rng(3).permuted(blocks, axis=1, out=blocks)
    assert looked(rhythm, blocks.ravel()) == 0
    assert looked(rhythm, stamps) == 0  # a bag that loops
    assert looked(rhythm, np.zeros(1000, np.int64)) == 0


def test_where_the_subscriber_stood_still_a_long_step_is_loss():
    stamps = stamped(10_000, 1000.0)
    for pauses, wanted in ((True, 0), (False, 5000)):
        rhythm = Rhythm()
        rhythm.look(stamps[:2000].tolist())
        assert rhythm.look(stamps[7000:8000].tolist(), pauses=pauses) == wanted


def test_a_new_rate_is_taken_up():
    """A faster one at once; a slower one after a while, since it cannot be told from a loss."""
    rhythm = Rhythm()
    looked(rhythm, stamped(1000, 100.0))
    assert looked(rhythm, stamped(5000, 1000.0) + 20 * NS_PER_S) == 0
    assert rhythm.period_ns == pytest.approx(1e6)
    looked(rhythm, stamped(100 * SLOWER_LOOKS, 100.0) + 40 * NS_PER_S, 100)
    assert rhythm.period_ns == pytest.approx(1e7)
    before = rhythm.missing
    looked(rhythm, stamped(1000, 100.0) + 60 * NS_PER_S)
    assert rhythm.missing == before


def test_slow_topics_wait_for_enough_stamps():
    rhythm = Rhythm()
    stamps = stamped(200, 5.0)
    stamps = np.delete(stamps, [50, 120])
    assert sum(rhythm.look([int(stamp)]) for stamp in stamps) == 2
