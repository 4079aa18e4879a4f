"""The score of a model that does not learn: the same samples for all, rivals fitted to what was learned from."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.core import metrics
from friction_estimator.core.fit.frozen_score import CURVES, RIVALS, curves_learned, frozen_score
from friction_estimator.core.sample import Samples, joined


def record(n=2000, period=200.0, seed=0):
    """A sine drive over Coulomb and viscous friction with noise; SI units."""
    k = np.arange(n)
    velocity = 0.1 * np.sin(2 * np.pi * k / period)
    friction = 3.0 * np.tanh(velocity / 0.002) + 10.0 * velocity + 0.01 * np.random.default_rng(seed).normal(size=n)
    return Samples(k * 5_000_000 + 1, velocity, friction, k == 0)


def test_a_perfect_model_scores_zero_and_the_rivals_their_own():
    samples = record()
    curves = curves_learned(samples.velocity_m_s, samples.friction_N)
    scored = np.arange(len(samples)) >= 1000
    score = frozen_score(samples, samples.friction_N, np.zeros(len(samples)), scored, curves)
    assert (score.samples, score.nrmse) == (1000, 0.0)
    assert set(score.baselines) == set(RIVALS)
    assert score.spread_N == pytest.approx(np.std(samples.friction_N[1000:]))
    # Coulomb and viscous friction is the truth here: noise is left, and no curve beats it by more than fitting noise.
    assert score.baselines["coulomb_viscous"] == pytest.approx(0.01 / score.spread_N, rel=0.1)
    assert score.baselines["stribeck"] == pytest.approx(score.baselines["coulomb_viscous"], rel=0.02)
    assert score.baselines["theory"] == pytest.approx(np.sqrt(np.mean(samples.friction_N[1000:] ** 2)) / score.spread_N)


def test_the_guess_looks_at_the_sample_before_and_not_over_a_restart():
    n = 100
    friction = np.arange(n, dtype=float)
    restart = np.isin(np.arange(n), (0, 60))
    friction[60:] += 1e6
    samples = Samples(np.arange(n), np.zeros(n), friction, restart)
    scored = (np.arange(n) >= 50) & (np.arange(n) < 70)
    guess = frozen_score(samples, friction, None, scored, {}).baselines["persistence"]
    follows = scored & ~restart
    assert guess == pytest.approx(1.0 / np.std(friction[follows]))


@pytest.mark.parametrize("n", [0, 5, 1000])
def test_nothing_to_fit_leaves_the_curves_out(n):
    at_rest = Samples(np.arange(n), np.zeros(n), np.linspace(0.0, 1.0, n), np.zeros(n, np.bool_))
    assert curves_learned(at_rest.velocity_m_s, at_rest.friction_N) == {}
    samples = record()
    score = frozen_score(samples, samples.friction_N, None, np.ones(len(samples), np.bool_), {})
    assert [score.baselines[name] for name in (*CURVES, "theory")] == [None] * 4
    assert score.baselines["persistence"] > 0.0


def test_constant_friction_has_no_score():
    samples = record()
    flat = Samples(samples.stamp_ns, samples.velocity_m_s, np.full(len(samples), 3.3), samples.restart)
    score = frozen_score(flat, flat.friction_N, None, np.ones(len(flat), np.bool_), {})
    assert np.isnan(score.nrmse)
    assert score.spread_N == 0.0


@given(st.lists(st.booleans(), max_size=40), st.integers(0, 6))
def test_settled_samples_are_those_whose_memory_holds_no_restart(restarts, memory):
    restart = np.array([True, *restarts])
    wanted = [not restart[max(0, k - memory + 1) : k + 1].any() if memory else True for k in range(restart.size)]
    assert metrics.settled(restart, memory).tolist() == wanted


@given(st.lists(st.integers(1, 60), min_size=1, max_size=4))
def test_joined_recordings_restart_where_they_begin(lengths):
    parts = [record(n, seed=n) for n in lengths]
    whole = joined(parts)
    starts = np.cumsum([0, *lengths[:-1]])
    assert np.flatnonzero(whole.restart).tolist() == starts.tolist()
    np.testing.assert_array_equal(whole.friction_N, np.concatenate([part.friction_N for part in parts]))
    assert whole.pressure_Pa is None


def test_joining_leaves_the_recordings_alone_and_needs_one():
    part = record(10)
    late = Samples(part.stamp_ns, part.velocity_m_s, part.friction_N, np.zeros(10, np.bool_))
    assert joined([late, late]).restart.tolist() == [k in (0, 10) for k in range(20)]
    assert not late.restart.any()
    with pytest.raises(ValueError, match="no recording"):
        joined([])


def test_cycles_are_sought_in_each_recording():
    one, two = record(1000, 200.0), record(1000, 125.0)
    whole = joined([one, two])
    zero = np.zeros(len(whole))
    values = metrics.by_cycle(whole.friction_N, zero, metrics.cycles_or_tenths(whole.velocity_m_s, (0, 1000)))
    apart = [
        metrics.by_cycle(part.friction_N, np.zeros(1000), metrics.cycles_or_tenths(part.velocity_m_s))
        for part in (one, two)
    ]
    assert len(values) == sum(map(len, apart))
    scale = metrics.spread(whole.friction_N)
    wanted = np.concatenate(
        [np.array(v) * metrics.spread(p.friction_N) for v, p in zip(apart, (one, two), strict=True)]
    )
    np.testing.assert_allclose(np.array(values) * scale, wanted)
