"""Figures of a record in pieces are those of the whole arrays, to the bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_estimator.core import metrics, sums
from friction_estimator.core.fit.points import TOP_SPEED, Points
from friction_estimator.core.sample import NS_PER_S, Samples

lengths = st.one_of(st.integers(1, 300), st.sampled_from([8191, 8192, 8193, 65_537, 131_075, 200_001]))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(n=lengths, piece=st.integers(1, 9000), seed=st.integers(0, 99))
def test_sums_and_quantiles(n, piece, seed):
    rng = np.random.default_rng(seed)
    piece = max(piece, n // 200)  # a long record in single samples takes seconds, and says no more than a short one
    values = rng.standard_normal(n) * 10.0 ** rng.integers(-9, 9, n)
    assert sums.total((values[part] for part in sums.parts(n, piece)), n) == np.sum(values)
    where = rng.random(n) < 0.7
    kept = values[where]
    assert sums.total(sums.chosen(values, where), kept.size) == np.sum(kept)
    for q in (0.5, 0.98, 0.995):
        ties = np.round(rng.standard_normal(n), 1)
        for one in (values, ties):
            pieces = (one[part] for part in sums.parts(n, piece))
            assert sums.upper_quantile(pieces, n, q) == float(np.quantile(one, q))
    for one in (np.abs(values), np.abs(ties)):
        assert sums.median_size(lambda one=one: (one[part] for part in sums.parts(n, piece))) == float(np.median(one))


@pytest.mark.parametrize(("told", "words"), [(5, "more than 4"), (3, "fewer than 4")])
def test_a_sum_of_another_number_of_values_is_refused(told, words):
    def summed():
        total = sums.Total(4)
        total.add(np.ones(told))
        return total.value

    with pytest.raises(ValueError, match=words):
        summed()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(n=lengths.filter(lambda n: n > 1), begin=st.floats(0, 1), piece=st.integers(1, 9000), seed=st.integers(0, 99))
def test_an_error_taken_in_turn_is_that_of_all(n, begin, piece, seed):
    rng = np.random.default_rng(seed)
    measured, predicted = rng.standard_normal((2, n))
    first = int(begin * (n - 2))
    error = metrics.NrmseInTurn(measured, first)
    for part in sums.parts(n, max(piece, n // 200)):
        error.take(predicted[part])
    assert error.value == metrics.nrmse(measured[first:], predicted[first:])
    assert np.isnan(metrics.NrmseInTurn(np.ones(n)).value)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(n=lengths.filter(lambda n: n > 1), seed=st.integers(0, 99))
def test_figures_of_merit(n, seed):
    rng = np.random.default_rng(seed)
    measured, predicted = rng.standard_normal(n), rng.standard_normal(n)
    where, restart = rng.random(n) < 0.7, rng.random(n) < 0.02
    where[:2] = True
    restart[1] = False
    for chosen in (None, where):
        m, p = (values if chosen is None else values[chosen] for values in (measured, predicted))
        assert metrics.spread(measured, chosen) == float(np.std(m))
        expected = float(np.sqrt(np.mean(np.square((m - p) / np.std(m)))))
        assert metrics.nrmse(measured, predicted, chosen) == expected
        assert metrics.nrmse(measured, lambda part: predicted[part], chosen) == expected
    follows = ~restart[1:]
    error, later = np.diff(measured)[follows], measured[1:][follows]
    guessed = float(np.sqrt(np.mean(np.square(error / np.std(later))))) if np.std(later) > 0.0 else np.nan
    assert metrics.nrmse_persistence(measured, restart) == pytest.approx(guessed, abs=0.0, nan_ok=True)
    speeds = np.abs(measured)
    assert Points(measured, measured).top_speed == max(float(np.quantile(speeds, TOP_SPEED)), 1e-6 * speeds.max())


@settings(max_examples=40, deadline=None, derandomize=True)
@given(n=st.integers(0, 300), memory=st.integers(0, 20), seed=st.integers(0, 99))
def test_where_the_delay_lines_are_filled(n, memory, seed):
    restart = np.random.default_rng(seed).random(n) < 0.05
    since = [min((k - at for at in np.flatnonzero(restart[: k + 1])), default=memory) for k in range(n)]
    assert metrics.settled(restart, memory).tolist() == [steps >= memory for steps in since]


@pytest.mark.parametrize("period_ns", [1_000_000, 900 * 10**6, 5 * NS_PER_S])
def test_the_rate_is_that_of_the_median_step(period_ns):
    rng = np.random.default_rng(4)
    n = 140_001  # more than two pieces
    step = period_ns + rng.integers(-period_ns // 3, period_ns // 3, n)
    step[rng.random(n) < 0.01] = -10
    step[rng.random(n) < 0.01] = 40 * NS_PER_S
    stamps = 10**15 + np.cumsum(step)
    samples = Samples(stamps, np.zeros(n), np.zeros(n), rng.random(n) < 0.02)
    forward = np.diff(stamps)
    inside = forward[~samples.restart[1:] & (forward > 0)]
    assert samples.sample_rate_hz == NS_PER_S / np.median(inside)
    assert samples.duration_s == forward[forward > 0].sum() / NS_PER_S


def test_cycles_that_lie_across_pieces(monkeypatch):
    rng = np.random.default_rng(5)
    k = np.arange(20_000)
    velocity = np.sin(0.01 * k) + 0.02 * rng.standard_normal(k.size)
    whole = metrics.drive_cycles(velocity)
    parts = sums.parts
    monkeypatch.setattr(sums, "parts", lambda n: parts(n, 37))
    assert len(whole) == 30
    assert metrics.drive_cycles(velocity) == whole
