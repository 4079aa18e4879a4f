"""rls: what was learned is never forgotten, the prior never spent; leverage, information, alarms."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import MODELS, RATE, config_for, known_system, noisy, samples_of, sine

from friction_estimator.core.model.prior import Prior
from friction_estimator.core.online import workspace
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.rls import PULL_EVERY
from friction_estimator.core.sample import Samples

SMALL = {"fir__order": 2, "basis__finest_level": 1}


def record(model_type: str = "parallel", cycles: float = 6, period_s: float = 1.0) -> Samples:
    velocity = sine(cycles, period_s, stroke_m=0.004)
    return samples_of(velocity, noisy(known_system(model_type, velocity)))


def estimator_for(samples: Samples, **changes: object) -> Estimator:
    return Estimator(config_for(samples, **SMALL | changes))


def prior_shares(estimator: Estimator) -> np.ndarray:
    """Posterior variance over the prior's, along the directions in which they differ most, ascending."""
    prior_root = estimator.work.prior_root
    half = np.linalg.solve(prior_root, estimator.work.root)
    return np.linalg.eigvalsh(half @ half.T)


def assert_never_spent(estimator: Estimator) -> None:
    """R >= R_prior and P > 0: no share of the prior variance is negative or above 1, up to rounding."""
    shares = prior_shares(estimator)
    assert np.all(np.isfinite(shares))
    assert shares[0] > 0.0
    assert shares[-1] < 1.0 + 1e-9


def lagged(values: np.ndarray, taps: int) -> np.ndarray:
    """Return values of the samples before, (n, taps, ...); the first of the record stands for what was before it."""
    place = np.arange(values.shape[0])[:, None] - np.arange(taps)
    return values[np.maximum(place, 0)]


def regressors(estimator: Estimator, samples: Samples) -> np.ndarray:
    """The gradient of each prediction for the present parameters, by its definition, (n, parameters)."""
    model, parts = estimator.model, estimator.parameters
    taps = parts.fir_taps.size
    psi = lagged(model.basis.dense(samples.velocity_m_s), taps)
    d = lagged(model.theoretical_friction(samples) / model.unit_N, taps)
    filtered = np.einsum("kij,i->kj", psi, parts.fir_taps)
    return np.hstack([psi @ parts.wavelet_weights, filtered, d[:, : parts.theory_taps.size]])


def leverage(estimator: Estimator, samples: Samples) -> np.ndarray:
    projected = regressors(estimator, samples) @ estimator.work.root
    return np.sum(np.square(projected), axis=1)


@st.composite
def histories(draw: st.DrawFn) -> list[tuple[str, int]]:
    kinds = st.sampled_from(["drive", "rest", "outliers", "step", "noise", "paused", "restarts"])
    return draw(st.lists(st.tuples(kinds, st.integers(0, 1000)), min_size=1, max_size=6))


def played(kind: str, seed: int) -> tuple[Samples, bool]:
    """A stretch of one kind, and whether it is to be learned from."""
    generator = np.random.default_rng(seed)
    samples = record(cycles=1)
    velocity, friction = samples.velocity_m_s.copy(), samples.friction_N.copy()
    restart = np.zeros(len(samples), np.bool_)
    if kind == "rest":
        velocity[:] = 0.0
        friction = 0.01 * generator.standard_normal(friction.size)
    elif kind == "outliers":
        friction[generator.integers(0, friction.size, 20)] = 10.0 ** generator.uniform(0, 12, 20)
    elif kind == "step":
        friction *= -generator.uniform(1.0, 50.0)
    elif kind == "noise":
        velocity = generator.uniform(-0.025, 0.025, velocity.size)
        friction = 10.0 * generator.standard_normal(friction.size)
    elif kind == "restarts":
        restart = generator.random(friction.size) < 0.2
    return replace(samples, velocity_m_s=velocity, friction_N=friction, restart=restart), kind != "paused"


@settings(max_examples=40, deadline=None)
@given(model_type=st.sampled_from(MODELS), history=histories(), forgetting=st.sampled_from([0.9, 0.997, 1.0]))
def test_whatever_comes_the_prior_is_never_spent(model_type, history, forgetting):
    estimator = estimator_for(record(), model__type=model_type, rls__forgetting_factor=forgetting)
    for kind, seed in history:
        samples, learn = played(kind, seed)
        predicted = estimator.run(samples, learn)
        assert np.isfinite(predicted).all()
        assert_never_spent(estimator)


def test_the_prior_is_not_spent_by_standing_still_and_nothing_winds_up():
    samples = record(cycles=10)
    estimator = estimator_for(samples)
    estimator.run(samples)
    before = estimator.covariance
    rest = samples_of(np.zeros(10**5), 0.02 * np.random.default_rng(0).standard_normal(10**5), restart_at=())
    estimator.run(rest)
    assert estimator.health.alarmed == 0
    assert_never_spent(estimator)
    gained = before - estimator.covariance
    assert np.linalg.eigvalsh(0.5 * (gained + gained.T)).min() > -1e-12
    # Standing still says nothing of the rest of the curve: it is known as well as before, and not better.
    velocity = np.linspace(0.01, 0.024, 15)
    theory = estimator.model.theory_at(velocity, 3e5, 50.0)
    _, gradient = estimator.model.steady_state(estimator.work.theta, velocity, theory)
    variance = [np.einsum("ij,jk,ik->i", gradient, p, gradient) for p in (before, estimator.covariance)]
    np.testing.assert_allclose(variance[1], variance[0], rtol=0.3)


def test_an_alarm_sets_the_covariance_back_to_the_prior_and_no_further():
    samples = record("hammerstein", cycles=16)
    half = len(samples) // 2
    estimator = estimator_for(samples, model__type="hammerstein")
    np.testing.assert_allclose(prior_shares(estimator), 1.0, rtol=1e-9)
    estimator.run(samples[:half])
    assert estimator.health.alarmed == 0
    changed = replace(samples, friction_N=-2.0 * samples.friction_N)
    k = half
    while not estimator.health.alarmed and k < len(samples):
        estimator.run(changed[k : k + 1])
        k += 1
    assert estimator.health.alarmed == 1
    shares = prior_shares(estimator)
    assert shares[-1] < 1.0 + 1e-9
    assert np.count_nonzero(shares < 0.99) <= 1  # the sample that raised it was learned from
    estimator.run(changed[k:])
    assert_never_spent(estimator)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), forgetting=st.sampled_from([0.9, 0.997, 1.0]))
def test_information_never_falls(seed, forgetting):
    """Sample by sample: the variance of no combination of parameters grows, unless an alarm is raised."""
    generator = np.random.default_rng(seed)
    samples = record(cycles=2)
    samples = replace(samples, velocity_m_s=samples.velocity_m_s * generator.uniform(0.1, 1.0))
    estimator = estimator_for(record(), rls__forgetting_factor=forgetting)
    estimator.run(samples[: int(generator.integers(0, 800))])
    for k in range(800, 830):
        before, alarmed = estimator.work.root @ estimator.work.root.T, estimator.health.alarmed
        estimator.run(samples[k : k + 1])
        gained = before - estimator.work.root @ estimator.work.root.T
        if estimator.health.alarmed == alarmed:
            assert np.linalg.eigvalsh(gained).min() > -1e-12 * np.trace(before)


@pytest.mark.parametrize("forgetting", [0.98, 0.997])
@pytest.mark.parametrize("model_type", MODELS)
def test_leverage_of_what_is_visited_comes_down_to_the_least_and_stays(model_type, forgetting):
    samples = record(model_type, cycles=60)
    estimator = estimator_for(samples, model__type=model_type, rls__forgetting_factor=forgetting)
    least = 1.0 - forgetting
    cycle = samples[RATE : 2 * RATE]
    estimator.run(samples)
    for _ in range(4):
        estimator.run(samples)
    late = leverage(estimator, cycle)[8:]
    assert late.max() < 1.1 * least
    assert np.median(late) > 0.4 * least
    estimator.run(samples)
    later = leverage(estimator, cycle)[8:]
    np.testing.assert_allclose(later, late, rtol=0.4)
    assert np.median(later) > 0.4 * least


def test_without_forgetting_leverage_falls_without_end():
    samples = record(cycles=60)
    estimator = estimator_for(samples, rls__forgetting_factor=1.0)
    cycle = samples[RATE : 2 * RATE]
    estimator.run(samples)
    late = np.median(leverage(estimator, cycle)[8:])
    for _ in range(3):
        estimator.run(samples)
    assert np.median(leverage(estimator, cycle)[8:]) == pytest.approx(late / 4.0, rel=0.1)


def test_the_prior_counts_as_one_of_the_samples_that_were_taken_up():
    """Pulls are due every so many learned samples; each replaced sample adds at most one part in those taken up."""
    samples = record(cycles=30)
    estimator = estimator_for(samples)
    for begin in range(0, len(samples), PULL_EVERY):
        absorbed = float(estimator.work.moments[workspace.ABSORBED])
        estimator.run(samples[begin : begin + PULL_EVERY - 1])
        pull, now = estimator.work.moments[[workspace.PULL, workspace.ABSORBED]]
        replaced = PULL_EVERY - 1 - (now - absorbed)
        assert -1e-9 <= pull <= (replaced + 4.0) / max(absorbed, 1.0)
        estimator.run(samples[begin + PULL_EVERY - 1 : begin + PULL_EVERY])
    assert pull > 0.0
    assert 500.0 < now < len(samples)


def test_where_nothing_was_seen_nothing_is_learned():
    """One direction only: the weights that act in the other stay at the prior's mean, its covariance their own."""
    velocity = np.abs(sine(6, 1.0, stroke_m=0.004)) + 0.004
    samples = samples_of(velocity, noisy(known_system("hammerstein", velocity)))
    estimator = estimator_for(samples, basis__velocity_range=[-0.03, 0.03], model__type="hammerstein")
    estimator.run(samples)
    model, prior = estimator.model, Prior.of(estimator.model)
    taps = int(model.shape[0])
    touched = np.unique(model.basis.rows(np.append(velocity, 0.0))[0])
    untouched = taps + np.setdiff1d(np.arange(model.basis.size), touched)
    assert untouched.size > 3
    np.testing.assert_array_equal(estimator.work.theta[untouched], 0.0)
    np.testing.assert_allclose(np.diag(estimator.covariance)[untouched], np.diag(prior.covariance)[untouched])
