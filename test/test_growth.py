"""The range grows with the speeds that come: what was learned stays as it was, and nothing depends on the cutting."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import MODELS, RATE, config_for, known_system, noisy, samples_of, sine

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.fit.band import COUNT
from friction_estimator.core.model import basis as basis_module
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.online import workspace
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.growth import LEAST_GROWTH, Growth, grown_model
from friction_estimator.core.online.kernels import DECIDED_AFTER, GROW_AFTER
from friction_estimator.core.online.run import Run
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import MARGIN

SMALL = {"fir__order": 2, "basis__finest_level": 0}
SLOW = 0.005
UNCHANGED = 5e-3
"""Force units within which a curve is what it was."""


def faster(model_type: str = "parallel") -> Samples:
    """Two slow cycles, then strokes that grow fourfold."""
    n = int(2.0 * RATE)
    t = np.arange(5 * n) / RATE
    stroke = np.interp(t, [4.0, 9.0], [1.0, 4.0])
    velocity = SLOW * stroke * np.sin(2.0 * np.pi * t / 2.0)
    return samples_of(velocity, noisy(known_system(model_type, velocity)))


def estimator_for(samples: Samples, **changes: object) -> Estimator:
    """Met by the slow cycles only."""
    return Estimator(config_for(samples[: 2 * 2 * RATE], **SMALL | changes))


def grown(model_type: str, law: str = "rls", fast: float = 0.04) -> tuple[Estimator, Estimator]:
    """Return an estimator just before and just after its range grew from 0.00525 m/s."""
    before = estimator_for(faster(model_type), model__type=model_type, model__law=law)
    before.run(faster(model_type)[: 4 * RATE])
    before.run(beyond(GROW_AFTER - 1, fast))
    after = Estimator(before.config)
    after.restore(before.state())
    assert after.health.grown == 0
    after.run(beyond(1, fast))
    assert after.health.grown == 1
    return before, after


def beyond(count: int, velocity: float) -> Samples:
    return samples_of(np.full(count, velocity), np.full(count, 2.0 * np.sign(velocity)), restart_at=())


def theory(estimator: Estimator, velocity: np.ndarray) -> np.ndarray:
    default = estimator.config.theory
    return estimator.model.theory_at(velocity, default.default_pressure, default.default_temperature)


def curve(estimator: Estimator, velocity: np.ndarray) -> np.ndarray:
    return estimator.model.steady_state(estimator.work.theta, velocity, theory(estimator, velocity))[0]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("model_type", MODELS)
def test_curve_and_band_over_the_former_range_stay_what_they_were(model_type, law):
    before, after = grown(model_type, law)
    low, high = before.model.basis.reach
    velocity = np.linspace(low, high, 401)
    old, new = before.curve(velocity_m_s=velocity), after.curve(velocity_m_s=velocity)
    np.testing.assert_allclose(new.friction_N, old.friction_N, rtol=0.0, atol=UNCHANGED * before.model.unit_N)
    half = 0.5 * (old.high_N - old.low_N)
    np.testing.assert_allclose(0.5 * (new.high_N - new.low_N), half, rtol=1e-3)
    if law == "rls":
        np.testing.assert_allclose(new.learned_share, old.learned_share, atol=1e-9)
    else:
        assert new.learned_share is None


@pytest.mark.parametrize("fast", [0.0056, 0.008, 0.04])
@pytest.mark.parametrize("model_type", MODELS)
def test_beyond_the_former_range_g_keeps_its_edge_value(model_type, fast):
    before, after = grown(model_type, fast=fast)
    (low, high), (lowest, highest) = before.model.basis.reach, after.model.basis.reach
    assert (lowest, highest) == (low, pytest.approx(max(MARGIN * fast, LEAST_GROWTH * high)))
    beyond_it = np.linspace(high, highest, 100)
    held = before.model.static_map(before.work.theta, beyond_it)  # held outside its range
    now = after.model.static_map(after.work.theta, beyond_it)
    assert now[0] == pytest.approx(held[0], abs=UNCHANGED * before.model.unit_N)
    assert np.abs(now - held).max() < 0.05 * np.abs(held).max() + 0.01 * before.model.unit_N


def test_a_range_that_was_written_down_without_its_scale_keeps_its_functions():
    written = estimator_for(faster()).config.updated({"learned.velocity_scale": 0.0})
    estimator = Estimator(written)
    estimator.run(faster()[: 4 * RATE])
    velocity, unit = np.linspace(-SLOW, SLOW, 21), estimator.model.basis.unit
    before = curve(estimator, velocity)
    estimator.run(beyond(GROW_AFTER, 0.02))
    assert estimator.health.grown == 1
    assert estimator.model.basis.unit == unit
    np.testing.assert_allclose(curve(estimator, velocity), before, atol=UNCHANGED * estimator.model.unit_N)


@pytest.mark.parametrize("model_type", MODELS)
def test_within_the_former_range_predictions_are_what_they_would_have_been(model_type):
    before, after = grown(model_type)
    before.work.status[workspace.MAY_GROW] = 0
    before.run(beyond(1, 0.04))
    assert before.health.grown == 0
    slow = faster(model_type)[:100]
    np.testing.assert_allclose(after.run(slow, False), before.run(slow, False), atol=UNCHANGED * before.model.unit_N)


def test_appended_weights_start_from_the_prior_and_the_rest_keeps_its_covariance():
    before, after = grown("parallel")
    taps, old, new = int(before.model.shape[0]), int(before.model.shape[1]), int(after.model.shape[1])
    place = after.model.basis.places_of(before.model.basis)
    kept = np.concatenate([np.arange(taps), taps + place, np.arange(taps + new, after.model.size)])
    fresh = np.setdiff1d(np.arange(after.model.size), kept)
    assert fresh.size == new - old > 0
    np.testing.assert_allclose(after.covariance[np.ix_(kept, kept)], before.covariance, rtol=1e-12, atol=1e-15)
    prior = Prior.of(after.model)
    np.testing.assert_allclose(after.covariance[fresh][:, fresh], prior.covariance[fresh][:, fresh], atol=1e-12)
    assert not after.covariance[np.ix_(fresh, kept)].any()


@pytest.mark.parametrize("model_type", MODELS)
def test_growing_again_and_again_keeps_the_edge_value_and_small_weights(model_type):
    """A first contact with the noise of rest, then the whole speed: the range grows many times in a stroke."""
    model, work = (one := grown(model_type)[0]).model, one.work
    edge = model.static_map(work.theta, np.array([model.basis.reach[1]]))[0]
    largest = np.abs(work.theta).max()
    for factor in 2.5 ** np.arange(1, 9):
        larger = grown_model(model, 0.005 * factor)
        work = Growth(model, larger, work, one.config, one.law).done()
        model = larger
    velocity = np.geomspace(0.00525, model.basis.reach[1], 50)
    g = model.static_map(work.theta, velocity)
    assert np.abs(g - edge).max() < 0.05 * np.abs(edge) + 0.01 * model.unit_N
    assert np.abs(work.theta).max() < 3.0 * largest + 3.0


@pytest.mark.parametrize("law", LAWS)
def test_a_growth_made_ahead_in_pauses_is_the_same(law):
    """Also where the samples beyond are not enough the first time, and others the second time."""
    samples = faster()
    at_once = estimator_for(samples, model__law=law)
    in_pauses = Estimator(at_once.config)
    slow = samples[: 4 * RATE]
    fast = [beyond(GROW_AFTER - 3, 0.02), slow[-1:], beyond(GROW_AFTER, 0.03), beyond(GROW_AFTER, -0.03)]
    at_once.run(slow)
    in_pauses.run(slow)
    pauses = 0
    for stretch in fast:
        at_once.run(stretch)
        for k in range(len(stretch)):
            in_pauses.run(stretch[k : k + 1])
            if in_pauses.may_grow_soon:
                in_pauses.prepare()
                pauses += 1
    assert at_once.health.grown == 2
    assert pauses == (GROW_AFTER - 3 - DECIDED_AFTER + 1) + 2 * (GROW_AFTER - DECIDED_AFTER)
    ours, theirs = in_pauses.state(), at_once.state()
    assert ours["chosen"] == theirs["chosen"]
    for name, array in theirs["arrays"].items():
        np.testing.assert_array_equal(ours["arrays"][name], array, err_msg=name)


def test_what_takes_long_is_made_before_the_range_grows(monkeypatch):
    estimator = estimator_for(faster())
    estimator.run(faster()[: 4 * RATE])
    for _ in range(GROW_AFTER - 1):
        estimator.run(beyond(1, 0.02))
        if estimator.may_grow_soon:
            estimator.prepare()

    def late(*_: object, **__: object) -> None:
        raise AssertionError("made when it was needed")

    made_ahead = {
        "growth": ("grown_model", "Prior.of", "prior_arrays", "placed_zeros", "constants"),
        "carried_curve": ("_add_squares", "_add_missing"),
    }
    for module, names in made_ahead.items():
        for name in names:
            monkeypatch.setattr(f"friction_estimator.core.online.{module}.{name}", late)
    for name in ("cholesky", "eigh", "inv", "solve"):
        monkeypatch.setattr(np.linalg, name, late)
    assert estimator.health.grown == 0
    estimator.run(beyond(1, 0.02))
    assert estimator.health.grown == 1


@pytest.mark.parametrize(
    "changes",
    [
        {"basis__velocity_unit": 20.0, "basis__companding": 0.0},  # a cell is wider than the range
        # What rounding leaves of the fit is more than its prior.
        {"prior__weight_deviation": 1e6, "basis__finest_level": -3, "basis__wavelet": "db8"},
    ],
)
@pytest.mark.parametrize("law", LAWS)
def test_a_range_grows_whatever_the_basis_and_its_prior(law, changes):
    estimator = estimator_for(faster(), model__law=law, **changes)
    estimator.run(faster()[: 4 * RATE])
    velocity = np.linspace(0.0, estimator.model.basis.reach[1], 50)
    before = curve(estimator, velocity)
    estimator.run(beyond(GROW_AFTER, 0.03))
    assert estimator.health.grown == 1
    after = curve(estimator, velocity)
    assert np.isfinite(after).all()
    assert np.isfinite(estimator.work.root).all()
    if "prior__weight_deviation" not in changes:  # else the curve is wild where no sample was, before and after
        np.testing.assert_allclose(after, before, atol=0.02 * estimator.model.unit_N)


def test_unit_and_companding_stay_and_the_range_takes_its_margin():
    before, after = grown("parallel")
    assert (after.model.basis.unit, after.model.basis.bend) == (before.model.basis.unit, before.model.basis.bend)
    assert after.model.theory_scale == before.model.theory_scale
    assert after.model.basis.reach == (before.model.basis.reach[0], MARGIN * 0.04)
    assert after.config.learned.velocity_range == after.model.basis.reach
    assert after.config.velocity_scale == before.config.velocity_scale


@settings(max_examples=12, deadline=None)
@given(
    law=st.sampled_from(list(LAWS)),
    model_type=st.sampled_from(MODELS),
    cuts=st.lists(st.integers(0, 5000), max_size=12),
)
def test_in_one_piece_or_in_many_is_the_same_bit_for_bit(law, model_type, cuts):
    samples = faster(model_type)
    whole, parts = (estimator_for(samples, model__type=model_type, model__law=law) for _ in range(2))
    spread, pieces = np.empty(len(samples)), []
    expected = whole.run(samples, True, spread)
    edges = sorted({0, len(samples), *cuts})
    for begin, end in pairwise(edges):
        deviation = np.empty(end - begin)
        pieces.append((parts.run(samples[begin:end], True, deviation), deviation))
    assert whole.health.grown >= 3
    np.testing.assert_array_equal(np.concatenate([p for p, _ in pieces]), expected)
    np.testing.assert_array_equal(np.concatenate([d for _, d in pieces]), spread)
    one, other = whole.state(), parts.state()
    assert one["chosen"] == other["chosen"]
    for name, array in one["arrays"].items():
        np.testing.assert_array_equal(array, other["arrays"][name], err_msg=name)


@pytest.mark.parametrize("law", LAWS)
def test_a_state_with_a_grown_range_continues_bit_for_bit(law):
    samples = faster()
    whole = estimator_for(samples, model__law=law)
    expected = whole.run(samples)
    # Right after growing, and in the middle of twenty samples beyond the edge.
    beyond = np.flatnonzero(np.abs(samples.velocity_m_s) > whole.model.basis.reach[1] / 2.0)
    for cut in (int(beyond[0]) + 7, 3700, 4400):
        first, second = (estimator_for(samples, model__law=law) for _ in range(2))
        first.run(samples[:cut])
        second.restore(first.state())
        np.testing.assert_array_equal(second.run(samples[cut:]), expected[cut:])
        assert second.model.basis.reach == whole.model.basis.reach
        assert second.health == whole.health


def test_a_warm_start_keeps_the_grown_range():
    samples = faster()
    first = estimator_for(samples)
    first.run(samples)
    warm = Estimator(Config.from_mapping(first.learned_config.to_mapping()))
    assert warm.model.basis.reach == first.model.basis.reach
    velocity = np.linspace(*first.model.basis.reach, 101)
    np.testing.assert_array_equal(curve(warm, velocity), curve(first, velocity))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("model_type", MODELS)
def test_a_unit_that_is_too_small_rises_with_the_range(model_type, law):
    """A first contact without load, in the noise of rest; a state taken after it goes on bit for bit."""
    rest = samples_of(1e-5 * np.sin(np.arange(600) / 7.0), 0.01 * np.sin(np.arange(600) / 11.0))
    work = faster(model_type)
    estimator = Estimator(config_for(rest, **SMALL | {"model__type": model_type, "model__law": law}))
    small = estimator.model.unit_N
    estimator.run(rest)
    other = Estimator(estimator.config)
    predicted = estimator.run(work)
    assert small < 0.02
    assert 0.1 < estimator.model.unit_N / np.std(work.friction_N) < 4.0
    assert estimator.config.unit_N == estimator.model.unit_N
    assert np.isfinite(predicted).all()
    if law == "rls":
        late = slice(-RATE, None)
        assert np.std((predicted - work.friction_N)[late]) < 0.1 * np.std(work.friction_N)
    other.restore(estimator.state())
    np.testing.assert_array_equal(other.run(work[:500]), estimator.run(work[:500]))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_twenty_samples_in_a_row_let_it_grow_and_nineteen_do_not(sign):
    estimator = estimator_for(faster())
    reach = estimator.model.basis.reach
    fast = beyond(GROW_AFTER, sign * 0.02)
    slow = beyond(1, 0.0)
    estimator.run(slow)
    for _ in range(5):
        estimator.run(fast[: GROW_AFTER - 1])
        estimator.run(slow)
    assert estimator.health.grown == 0
    assert estimator.model.basis.reach == reach
    estimator.run(fast)
    assert estimator.health.grown == 1
    assert estimator.model.basis.reach[0 if sign < 0 else 1] == pytest.approx(sign * MARGIN * 0.02)
    assert estimator.model.basis.reach[1 if sign < 0 else 0] == reach[1 if sign < 0 else 0]
    assert estimator.health.outside == 5 * (GROW_AFTER - 1) + GROW_AFTER


def test_one_side_after_the_other_is_not_in_a_row():
    estimator = estimator_for(faster())
    for _ in range(6):
        estimator.run(beyond(GROW_AFTER - 1, 0.02))
        estimator.run(beyond(GROW_AFTER - 1, -0.02))
    assert estimator.health.grown == 0


def test_single_wild_velocities_do_not_stretch_it():
    samples = faster()[: 4 * RATE]
    velocity = samples.velocity_m_s.copy()
    velocity[100::50] = 10.0 ** np.arange(-1, velocity[100::50].size - 1)
    estimator = estimator_for(samples)
    estimator.run(replace(samples, velocity_m_s=velocity))
    assert estimator.health.grown == 0
    assert estimator.health.outside == velocity[100::50].size
    # Among twenty fast ones it does not count either: it stands far out, so the slowest of them decides.
    burst = beyond(GROW_AFTER, 0.02)
    burst.velocity_m_s[7] = 1e5
    estimator.run(burst)
    assert estimator.model.basis.reach[1] == pytest.approx(MARGIN * 0.02)


def test_a_range_that_is_given_never_grows():
    samples = faster()
    estimator = estimator_for(samples, basis__velocity_range=[-SLOW, SLOW])
    estimator.run(samples)
    assert estimator.health.grown == 0
    assert estimator.model.basis.reach == (-SLOW, SLOW)
    assert estimator.health.outside == np.count_nonzero(np.abs(samples.velocity_m_s) > SLOW)


def test_it_does_not_grow_while_nothing_is_learned():
    samples = faster()
    estimator = estimator_for(samples)
    estimator.run(samples, learn=False)
    assert estimator.health.grown == 0
    estimator.run(samples)
    assert estimator.health.grown > 0


def test_it_stops_at_the_largest_basis(monkeypatch):
    samples = faster()
    estimator = estimator_for(samples)
    monkeypatch.setattr(basis_module, "LARGEST_BASIS", estimator.model.basis.size + 2)
    predicted = estimator.run(samples)
    assert estimator.work.status[workspace.MAY_GROW] == 0
    assert estimator.model.basis.size <= basis_module.LARGEST_BASIS
    assert np.isfinite(predicted).all()
    reach = estimator.model.basis.reach
    estimator.run(samples)
    assert estimator.model.basis.reach == reach
    other = estimator_for(samples)
    other.restore(estimator.state())
    assert other.work.status[workspace.MAY_GROW] == 0


@pytest.mark.parametrize("levels", [(-3, 6), (-1, 9)])
def test_a_unit_rises_where_deviations_differ_by_more_orders_than_a_number_has_digits(levels):
    time_s = np.arange(2500) * 1e-3
    noise = time_s < 2.0  # the first contact is with noise: range and unit are too small
    speed = 0.02 * np.exp(0.4 * time_s) * np.sin(2.6 * np.pi * time_s)
    velocity = np.where(noise, 1e-3 * np.sin(9.0 * time_s), speed)
    friction = np.where(noise, 0.01 * np.tanh(velocity / 1e-5), 3.0 * np.tanh(velocity / 2e-3) + 6.0 * velocity)
    steep = {"prior.weight_slope": 8.0, "basis.finest_level": levels[0], "basis.coarsest_level": levels[1]}
    run = Run(Config.from_mapping(steep | {"model.type": "hammerstein", "theory.kind": "none"}))
    run.push(Samples((time_s * NS_PER_S).astype(np.int64), velocity, friction, time_s == 0.0))
    assert run.estimator.health.grown > 0
    assert run.estimator.model.unit_N > 1.0
    run.estimator.check_state()


def test_where_units_are_far_too_small_it_stays_usable(monkeypatch):
    """A first contact with creep, then a million times the speed: the basis stays bounded, the model stays finite."""
    monkeypatch.setattr(basis_module, "LARGEST_BASIS", 1000)  # the usual bound, 4096, takes 20 s to reach
    config = Config.from_mapping(
        {
            "learned.velocity_range": [-1e-6, 1e-6],
            "learned.velocity_scale": 1e-6,
            "learned.force_unit": 2.0,
            "basis.companding": 0.0,
            "theory.kind": "seal",
        }
    )
    estimator = Estimator(config)
    velocity = sine(1, period_s=1.0, stroke_m=0.15)
    predicted = estimator.run(samples_of(velocity, np.sign(velocity)))
    assert np.isfinite(predicted).all()
    assert estimator.work.status[workspace.MAY_GROW] == 0
    assert estimator.model.basis.size <= basis_module.LARGEST_BASIS


@pytest.mark.parametrize("model_type", MODELS)
def test_growing_makes_no_jump(model_type):
    """Nowhere is the error above the peak of friction, and in the end the wide curve is learned as the slow one was."""
    samples = faster(model_type)
    estimator = estimator_for(samples, model__type=model_type)
    error = np.abs(estimator.run(samples) - samples.friction_N)
    assert error[RATE:].max() < np.abs(samples.friction_N).max()
    again = estimator.run(replace(samples, restart=np.arange(len(samples)) == 0))
    assert np.std(again - samples.friction_N) < 0.05 * np.std(samples.friction_N)


def test_running_errors_stay_with_their_cells():
    before, after = grown("parallel")
    middle = before.model.basis.cell_velocities()
    old, new = before.model.basis.cells(middle), after.model.basis.cells(middle)
    np.testing.assert_array_equal(after.work.errors[new], before.work.errors[old])
    assert after.work.errors[:, COUNT].sum() == before.work.errors[:, COUNT].sum()


def test_a_state_of_a_given_range_is_refused_where_it_may_grow():
    samples = faster()
    fixed = estimator_for(samples, basis__velocity_range=[-SLOW, SLOW])
    with pytest.raises(ConfigError, match=r"basis\.velocity_range"):
        estimator_for(samples).restore(fixed.state())
