"""The parts of the diagnosis: evidence, base, faults of the data, noise floor."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis import streams
from friction_estimator.diagnosis.base import fit_base
from friction_estimator.diagnosis.base_problem import ALARM
from friction_estimator.diagnosis.evidence import Evidence, Rule, folds_of, null_maximum
from friction_estimator.diagnosis.excitation import speed_levels
from friction_estimator.diagnosis.floor import noise_floor, noise_memory, variance_dependence
from friction_estimator.diagnosis.odd_curve import OddCurve
from friction_estimator.diagnosis.products import inner
from friction_estimator.diagnosis.record import Record, build_record, joined
from friction_estimator.diagnosis.repair import view_of
from friction_estimator.effects import EFFECTS
from friction_estimator.effects.detection import Fault
from friction_estimator.effects.scatter import lattice_step
from friction_estimator.rig.drive import segment
from friction_estimator.rig.simulate import Scenario, simulate

SEAL = Config.from_mapping({"theory.kind": "seal"})

N, BLOCKS = 4000, 20


def evidence(residual: np.ndarray, tangent: np.ndarray, seed: int = 0) -> Evidence:
    block = np.repeat(np.arange(BLOCKS), N // BLOCKS)
    used = np.ones(N, np.bool_)
    return Evidence(tangent, np.zeros(tangent.shape[1]), residual, used, block, seed)


@pytest.fixture(scope="module")
def noise() -> np.ndarray:
    return np.random.default_rng(0).standard_normal((N, 12))


def test_a_planted_column_is_fitted_whatever_the_base_spans(noise: np.ndarray) -> None:
    tangent, column = noise[:, :5], noise[:, 5:6] + noise[:, :1]
    machine = evidence(0.4 * column[:, 0] + 0.1 * noise[:, 6] + tangent @ np.ones(5), tangent)
    fit = machine.fit(machine.moments(column), Rule((0,)))
    assert fit.weights == pytest.approx([0.4], abs=0.01)
    gains = machine.cross_validated(machine.moments(column), Rule((0,)))
    assert gains.shape == (BLOCKS,)
    assert gains.sum() == pytest.approx(fit.gain, rel=0.05)


def test_held_out_gain_of_nothing_is_negative_on_average(noise: np.ndarray) -> None:
    gains = []
    for k in range(1, 12):
        machine = evidence(noise[:, 0], noise[:, k : k + 1] * 0.0 + 1.0)
        gains.append(machine.cross_validated(machine.moments(noise[:, k : k + 1]), Rule((0,))).sum())
    assert np.mean(gains) < 0.5


@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_the_memory_of_the_noise_is_not_that_of_a_slow_error(rho: float) -> None:
    """AR(1) noise raises the power of slow averages by (1 + rho) / (1 - rho), whatever the model has left beside it."""
    segments = tuple(segment(1.0, psi, 10.0) for psi in (50.0, 200.0))
    record = build_record([simulate(Scenario(segments, "clean", 200.0, 0.01, 3, ())).samples], SEAL)
    rng = np.random.default_rng(4)
    noise = np.zeros(record.used.size)
    for k, shock in enumerate(rng.standard_normal(noise.size)):
        noise[k] = rho * noise[k - 1] + shock
    slow = 2.0 * np.sin(record.features.time_s / 15.0)
    for left in (noise, noise + slow):
        assert 0.8 < noise_memory(record, left, record.pairs) * (1.0 - rho) / (1.0 + rho) < 2.0


def test_signs_and_gain_limits_are_kept(noise: np.ndarray) -> None:
    machine = evidence(-0.4 * noise[:, 5] + 0.1 * noise[:, 6], noise[:, :2])
    moments = machine.moments(noise[:, 5:6])
    assert machine.fit(moments, Rule((1,))).weights == pytest.approx([0.0])
    assert machine.fit(moments, Rule((-1,))).weights == pytest.approx([-0.4], abs=0.01)
    up = evidence(9.0 * noise[:, 5], noise[:, :2])
    assert up.fit(up.moments(noise[:, 5:6]), Rule((1,), near_one=True)).weights == pytest.approx([2.5])


def test_the_bootstrap_covers_the_chance_maximum(noise: np.ndarray) -> None:
    rng = np.random.default_rng(4)
    columns = rng.standard_normal((N, 60))
    above = 0
    for trial in range(60):
        machine = evidence(np.random.default_rng(100 + trial).standard_normal(N), noise[:, :2])
        moments = [machine.moments(columns[:, k : k + 1]) for k in range(60)]
        null = null_maximum(machine.flips(300), [machine.projected(m) for m in moments], [Rule((0,))] * 60)
        best = max(machine.fit(m, Rule((0,))).gain for m in moments)
        above += best > np.quantile(null, 0.9)
    assert above <= 13  # a tenth of 60 expected; 13 has a chance below 1 in 100


@settings(max_examples=20, deadline=None)
@given(st.integers(2, 200), st.integers(0, 50))
def test_folds_are_balanced(blocks: int, seed: int) -> None:
    counts = np.bincount(folds_of(blocks, seed))
    assert counts.sum() == blocks
    assert counts.max() - counts.min() <= 1


def test_products_in_pieces_are_products(noise: np.ndarray) -> None:
    np.testing.assert_allclose(inner(noise, noise), noise.T @ noise)
    np.testing.assert_allclose(inner(noise, noise[:, 0]), noise.T @ noise[:, 0])


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=40), st.floats(1e-3, 1.0))
def test_static_curve_is_odd(velocities: list[float], top: float) -> None:
    curve, v = OddCurve(top), np.array(velocities)
    np.testing.assert_allclose(curve(v), -curve(-v), atol=1e-12)


@pytest.fixture(scope="module")
def clean() -> Samples:
    parts = (segment(1.0, 50.0, 10.0), segment(2.5, 200.0, 20.0))
    return simulate(Scenario(parts, plant="clean", rate_hz=200.0, noise=0.01, seed=5)).samples


def test_base_learns_the_clean_plant_to_the_noise(clean: Samples) -> None:
    record = build_record([clean], Config())
    fit = fit_base(record, SEAL)
    assert fit.residual_N.std() / np.sqrt(np.mean(clean.friction_N**2)) == pytest.approx(0.01, rel=0.05)
    taps = np.concatenate([[1.0], fit.effective_taps]) / (1.0 + fit.effective_taps.sum())
    assert taps[:3] == pytest.approx([0.8, 0.15, 0.05], abs=0.02)
    assert fit.coefficients.promise < ALARM
    assert noise_floor(record, fit.residual_N) == pytest.approx(fit.residual_N.std(), rel=0.08)


def test_recordings_that_restart_their_clock_are_put_in_order(clean: Samples) -> None:
    whole, number = joined([clean, clean[:500]])
    assert np.all(np.diff(whole.stamp_ns) > 0)
    assert number.tolist() == [0] * len(clean) + [1] * 500
    assert whole.restart[len(clean)]


def test_periods_and_reversals_are_counted(clean: Samples) -> None:
    record = build_record([clean], Config())
    assert record.reversals == pytest.approx(2 * (10 + 8), abs=2)
    assert record.periods_s == pytest.approx((2.5, 1.0), rel=0.01)


def test_errors_that_are_mostly_nothing_scatter_with_no_variable(clean: Samples) -> None:
    """A lattice gives samples that should be equal equal values: the power of their differences has no scale."""
    record = build_record([clean], SEAL)
    errors = np.where(np.arange(len(clean)) % 3 == 0, 0.1, 0.0)
    assert variance_dependence(record, errors, np.arange(len(clean))) is None


def test_lattice_is_measured() -> None:
    values = np.random.default_rng(1).normal(size=5000)
    assert lattice_step(np.round(values / 0.07) * 0.07) == pytest.approx(0.07, rel=1e-6)
    assert lattice_step(values) == 0.0


def outliers(record: Record, residual: np.ndarray) -> Fault | None:
    view = view_of(record, record.context(Config(), 1.0), [])
    return EFFECTS["outliers"].detect(replace(view, residual_N=residual, force_N=view.force_N + residual))


@pytest.mark.parametrize("pole", [0.0, 0.7])
def test_noise_of_any_colour_has_no_outliers(clean: Samples, pole: float) -> None:
    from scipy.signal import lfilter

    record = build_record([clean], Config())
    residual = lfilter([1.0], [1.0, -pole], np.random.default_rng(3).standard_normal(len(clean)))
    assert outliers(record, residual) is None
    residual[[517, 1493, 2581, 3444, 4719, 5301]] += 12.0
    found = outliers(record, residual)
    assert found is not None
    assert found.used is not None
    assert set(np.flatnonzero(record.used & ~found.used)) == {517, 1493, 2581, 3444, 4719, 5301}


def test_where_held_values_end_is_no_outlier(clean: Samples) -> None:
    from scipy.signal import lfilter

    record = build_record([clean], Config())
    residual = lfilter([1.0], [1.0, -0.97], np.random.default_rng(3).standard_normal(len(clean)))
    used = record.used.copy()
    for start in range(100, len(clean) - 10, 170):
        held = slice(start, start + 8)
        residual[held] = residual[start - 1] + 1.5 * np.arange(1, 9)  # a little further off with each sample
        used[held] = False
    assert outliers(record.with_force(record.friction_N, used), residual) is None


@pytest.mark.parametrize("held", [0.1, 0.3, 0.5])
def test_spikes_between_held_values_are_told(clean: Samples, held: float) -> None:
    record, rng = build_record([clean], Config()), np.random.default_rng(3)
    residual, places = rng.standard_normal(len(clean)), [517, 1493, 2581, 3444, 4719, 5301]
    lost = rng.random(len(clean)) < held
    lost[places] = False
    residual[places] += 12.0
    for k in np.flatnonzero(lost):
        residual[k] = residual[k - 1]
    used = record.used & ~lost
    fault = outliers(record.with_force(record.friction_N, used), residual)
    assert fault is not None
    assert fault.used is not None
    assert set(np.flatnonzero(used & ~fault.used)) == set(places)


@pytest.mark.parametrize(("height", "places", "found"), [(9.0, [517, 3444, 5301], False), (20.0, [517, 3444], True)])
def test_two_spikes_are_some_if_they_are_far_off(clean: Samples, height: float, places: list[int], found: bool) -> None:
    record = build_record([clean], Config())
    residual = np.random.default_rng(3).standard_normal(len(clean))
    residual[places] = height * np.array([1.0, -1.0, 1.0])[: len(places)]
    fault = outliers(record, residual)
    assert (fault is not None) == found
    assert fault is None or set(np.flatnonzero(record.used & ~fault.used)) == set(places)


def test_what_happens_after_two_reversals_or_twice_at_one_place_is_no_outlier(clean: Samples) -> None:
    record = build_record([clean], Config())
    noise = np.random.default_rng(3).standard_normal(len(clean))
    peaks, scratch = noise.copy(), noise.copy()
    peaks[record.turns[[2, 5]] + 4] += 20.0
    middle = np.flatnonzero(np.diff(np.sign(record.features.position_m - np.median(record.features.position_m))))
    scratch[middle[[1, 4]]] += 20.0
    assert outliers(record, peaks) is None
    assert outliers(record, scratch) is None


def test_what_happens_at_each_reversal_neither_is_an_outlier_nor_hides_some(clean: Samples) -> None:
    record = build_record([clean], Config())
    residual = np.random.default_rng(4).standard_normal(len(clean))
    residual[record.turns[record.turns < len(clean) - 2] + 1] += 9.0
    assert outliers(record, residual) is None
    residual[[517, 1493, 2581, 3444, 4719, 5301]] += 12.0
    found = outliers(record, residual)
    assert found is not None
    assert found.used is not None
    assert set(np.flatnonzero(record.used & ~found.used)) == {517, 1493, 2581, 3444, 4719, 5301}


def test_steps_of_a_coarse_sensor_are_no_outliers(clean: Samples) -> None:
    """Where the friction is nearly constant the residual rests on one step of the lattice; the next one is no spike."""
    record = build_record([clean], Config())
    residual = 0.02 * np.random.default_rng(5).standard_normal(len(clean))
    residual[[517, 1493, 2581, 3444, 4719, 5301]] += 0.5
    view = view_of(record, record.context(Config(), 1.0), [])
    view = replace(view, residual_N=residual, force_N=view.force_N + residual)
    assert EFFECTS["outliers"].detect(view) is not None
    assert EFFECTS["outliers"].detect(replace(view, lattice_N=0.5)) is None


def test_a_late_force_at_steps_of_the_speed_has_no_outliers(clean: Samples) -> None:
    """What a delay within a sample leaves is one value off at each step, less than the step itself."""
    record = build_record([clean], Config())
    steps = np.array([517, 1493, 2581, 3444, 4719, 5301])
    residual = 0.02 * np.random.default_rng(6).standard_normal(len(clean))
    residual[steps] -= 0.5
    view = view_of(record, record.context(Config(), 1.0), [])
    speeds_up = np.zeros(len(clean))
    for k, step in enumerate(steps):
        speeds_up[step:] += 1.0 if k % 2 else -1.0
    assert EFFECTS["outliers"].detect(replace(view, residual_N=residual, force_N=view.force_N + residual)) is not None
    force = view.force_N + residual + speeds_up
    assert EFFECTS["outliers"].detect(replace(view, residual_N=residual, force_N=force)) is None


def test_stamps_tell_their_faults() -> None:
    t = np.arange(1000) * 5_000_000
    assert streams.offset_ns(t, t) == 0
    assert streams.offset_ns(t, t - 900_000) == -900_000
    (found,) = streams.counted({"duplicate_stamp": 40, "read": 4000})
    assert found.name == "duplicate_stamps"
    assert found.p_value is None
    assert streams.counted({"duplicate_stamp": 1, "read": 4000, "stamp_offset_s": 0.0, "period_s": 0.005}) == []
    (found,) = streams.counted({"stamp_offset_s": 1e-3, "period_s": 0.005})
    assert found.name == "stamp_offset"


def test_one_jump_of_the_clock_is_named_and_joints_of_pieces_are_not(clean: Samples) -> None:
    def jumped(places: list[int]) -> Fault | None:
        shift = np.zeros(len(clean), np.int64)
        for place in places:
            shift[place:] += 300_000_000
        moved = replace(clean, stamp_ns=clean.stamp_ns + shift)
        record = build_record([moved], Config())
        return EFFECTS["clock_jump"].detect(view_of(record, record.context(Config(), 1.0), []))

    fast = np.flatnonzero(np.abs(clean.velocity_m_s) > 0.6 * np.abs(clean.velocity_m_s).max())
    found = jumped([int(fast[fast.size // 2])])
    assert found is not None
    assert found.parameters["jump"][0] == pytest.approx(0.3, abs=0.006)
    assert jumped([int(k) for k in fast[:: fast.size // 30]]) is None
    assert jumped([]) is None


def test_constant_speeds_are_told_from_a_sine() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    number = np.zeros(time.size)
    assert speed_levels(0.1 * np.sin(time * 6.0), number) == []
    square = np.where(np.sin(time) > 0.0, 0.014, -0.010)
    assert speed_levels(square, number) == pytest.approx([-0.010, 0.014])
