"""Every effect of the catalogue, by its registry row: simulation, size, regressor, words."""

import json
import re
from copy import deepcopy
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.sample import Samples
from friction_estimator.effects import EFFECTS, STAGES, Trace, compose, list_effects, parse_effect
from friction_estimator.effects.axis import VelocityAxis
from friction_estimator.effects.base import Effect
from friction_estimator.effects.catalogue import equation
from friction_estimator.effects.columns import RunningForce
from friction_estimator.effects.compose import FINE, relative_change
from friction_estimator.effects.features import Context, FeatureMaker, Features
from friction_estimator.effects.reference import Reference, tabled

RATE_HZ, EVERY = 2000.0, 10

CONTRACT = {
    "sensor_bias",
    "direction_asymmetry",
    "sensor_drift",
    "viscosity_drift",
    "wear",
    "breakaway",
    "presliding",
    "frictional_lag",
    "time_delay",
    "sensor_lowpass",
    "inertia",
    "side_spring",
    "position_dependence",
    "squeeze_film",
    "periodic_disturbance",
    "saturation",
    "bias_step",
    "gain_step",
    "viscoelastic_relaxation",
    "pressure_dependence",
    "backlash",
    "quantization",
    "dropout",
    "outliers",
    "stick_slip",
    "velocity_noise",
    "velocity_mismatch",
    "clock_jump",
    "duplicate_stamps",
    "stamp_offset",
    "wrapped_position",
    "velocity_delay",
    "pressure_noise",
    "gravity",
    "load_dependence",
}


def stribeck(velocity: np.ndarray, film: np.ndarray, viscosity: object = 1.0, boundary: object = 1.0) -> np.ndarray:
    """A Stribeck curve whose boundary part follows the film's speed."""
    dry = 3.0 * boundary * np.exp(-film / 0.03 * viscosity) * np.tanh(velocity / 2e-3)
    return np.asarray(dry + np.tanh(velocity / 2e-3) + 12.0 * viscosity * velocity)


def law(trace: Trace) -> np.ndarray:
    drive = stribeck(trace.velocity_m_s, trace.film_speed_m_s, trace.viscosity_factor, trace.boundary_factor)
    return drive * (1.0 + 5e-7 * trace.pressure_Pa)


@pytest.fixture(scope="module")
def clean() -> Trace:
    """Twenty cycles of 1.0137 s and some of 2.5077 s, not locked to the samples, at two pressures."""
    time = np.arange(0.0, 40.0, 1.0 / RATE_HZ)
    first = 20.0 * 1.0137
    period = np.where(time < first, 1.0137, 2.5077)
    angle = 2.0 * np.pi * np.where(time < first, time, time - first) / period
    rate = 2.0 * np.pi / period
    n = time.size
    velocity = -0.02 * rate * np.sin(angle)
    stamps = np.round(time * 1e9).astype(np.int64)
    trace = Trace(
        time_s=time,
        position_m=0.02 * np.cos(angle),
        velocity_m_s=velocity,
        acceleration_m_s2=-0.02 * rate**2 * np.cos(angle),
        pressure_Pa=np.where((time > 10.0) & (time < 30.0), 1.4e6, 3.4e5),
        temperature_degC=np.full(n, 54.0),
        friction_N=np.zeros(n),
        velocity_measured_m_s=velocity,
        position_measured_m=0.02 * np.cos(angle),
        stamp_ns=stamps,
        friction_stamp_ns=stamps,
        film_speed_m_s=np.abs(velocity),
        viscosity_factor=np.ones(n),
        boundary_factor=np.ones(n),
        period_s=period,
        law=law,
    )
    return trace.lubricated()


@pytest.fixture(scope="module")
def reference() -> Reference:
    def force(v: np.ndarray, p: np.ndarray) -> np.ndarray:
        return stribeck(v, np.abs(v)) * (1.0 + 5e-7 * p)

    def viscous(v: np.ndarray, p: np.ndarray) -> np.ndarray:
        film = np.abs(v)
        more, less = stribeck(v, film, 1.01), stribeck(v, film, 0.99)
        return (more - less) / 0.02 * (1.0 + 5e-7 * p)

    def boundary(v: np.ndarray, p: np.ndarray) -> np.ndarray:
        return 3.0 * np.exp(-np.abs(v) / 0.03) * np.tanh(v / 2e-3) * (1.0 + 5e-7 * p)

    pressures = np.array([3.4e5, 1.4e6])
    axis = VelocityAxis(0.13)
    return Reference.of(tabled((force, viscous, boundary, force), axis, pressures), axis, pressures, 2e-3)


@pytest.fixture(scope="module")
def samples(clean: Trace) -> Samples:
    at = clean.sampled(EVERY)
    restart = np.zeros(at.time_s.size, np.bool_)
    restart[[0, 3000]] = True
    return Samples(at.stamp_ns, at.velocity_m_s, at.friction_N, restart, at.pressure_Pa + 101325.0, None, at.position_m)


@pytest.fixture(scope="module")
def features(samples: Samples, reference: Reference) -> Features:
    return RunningForce(reference)(FeatureMaker(101325.0, 0.0, 54.0)(samples))


@pytest.fixture(scope="module")
def context(features: Features) -> Context:
    return Context(
        duration_s=40.0,
        step_s=0.005,
        distance_m=float(features.distance_m[-1]),
        stroke_m=0.04,
        centre_m=0.0,
        top_speed_m_s=0.126,
        force_rms_N=4.0,
        force_top_N=7.0,
        pressure_mean_Pa=8.7e5,
        pressure_span_Pa=1.06e6,
        sign_velocity_m_s=2e-3,
        channels=("position", "pressure"),
    )


ALL = pytest.mark.parametrize("name", list(EFFECTS))
SIZED = pytest.mark.parametrize("name", [n for n, c in EFFECTS.items() if c.size_key])


def points(cls: type[Effect], context: Context) -> list[dict[str, float]]:
    return [{"frequency": 13.7}] if cls.name == "periodic_disturbance" else cls.grid(context)


def test_the_catalogue_is_the_contract() -> None:
    assert set(EFFECTS) == CONTRACT


@ALL
def test_row_is_complete(name: str) -> None:
    cls = EFFECTS[name]
    assert cls.stage in STAGES
    assert cls.reveals in {f.name for f in fields(Features)}
    assert set(cls.words.confused_with) <= set(EFFECTS) - {name}
    assert len(cls.words.what) > 20
    assert len(cls.words.where) > 20
    assert cls.size_key in ("", *(key.name for key in cls.keys))
    stated = " ".join(equation(cls))
    assert [key.name for key in cls.keys if not re.search(rf"\b{key.name}\b", stated)] in ([], ["form"])
    for key in cls.keys:
        assert key.low <= key.default <= key.high
        assert key.description


@ALL
def test_spec_reads_back(name: str) -> None:
    effect = EFFECTS[name]()
    again = parse_effect(effect.spec)
    assert again.values == effect.values
    assert again.name == name


def test_list_is_plain_data() -> None:
    rows = json.loads(json.dumps(list_effects()))
    assert [row["name"] for row in rows] == list(EFFECTS)
    assert all(row["keys"][-1]["name"] == "size" for row in rows)


@ALL
def test_apply_leaves_its_input_alone_and_repeats(name: str, clean: Trace) -> None:
    trace = clean.sampled(EVERY)
    before = {f.name: np.copy(getattr(trace, f.name)) for f in fields(trace) if f.name != "law"}
    one = EFFECTS[name]().apply(trace, np.random.default_rng(5))
    other = EFFECTS[name]().apply(trace, np.random.default_rng(5))
    for key, value in before.items():
        np.testing.assert_array_equal(getattr(trace, key), value)
        np.testing.assert_array_equal(getattr(one, key), getattr(other, key))
    changed = [key for key, value in before.items() if not np.array_equal(getattr(one, key), value)]
    assert changed, "the effect changes nothing"


@SIZED
@pytest.mark.parametrize("size", [0.005, 0.04])
def test_size_is_what_was_asked_for(name: str, size: float, clean: Trace) -> None:
    _, (ready,) = compose(clean, [EFFECTS[name](size=size)], noise=0.0, every=EVERY, seed=11)
    seed = int(np.random.SeedSequence(11).spawn(2)[1].generate_state(1)[0])
    got = relative_change(ready, clean, EVERY, seed)
    # Dropouts and gaps move in steps: a single one at a reversal is a large part of a small size.
    assert got == pytest.approx(size, rel={"dropout": 0.5, "backlash": 0.5}.get(name, 0.02))


@SIZED
def test_larger_size_is_a_larger_change(name: str, clean: Trace) -> None:
    cls = EFFECTS[name]
    _, (small, large) = compose(clean, [cls(size=0.005), cls(size=0.04)], noise=0.0, every=EVERY, seed=3)
    assert small[cls.size_key] != large[cls.size_key]


def test_effects_without_size_say_so() -> None:
    for name in ("clock_jump", "duplicate_stamps", "wrapped_position"):
        assert EFFECTS[name].size_key == ""


@ALL
def test_columns_do_not_depend_on_how_the_record_is_cut(
    name: str, context: Context, samples: Samples, reference: Reference, features: Features
) -> None:
    cls = EFFECTS[name]
    for params in points(cls, context)[:: max(1, len(points(cls, context)) // 3)]:
        whole = cls.columns(params)(features, reference)
        assert np.isfinite(whole).all()
        make, running, columns = FeatureMaker(101325.0, 0.0, 54.0), RunningForce(reference), cls.columns(params)
        edges = [0, 1, 2, 700, 701, 3001, 5000, len(samples)]
        parts = [columns(running(make(samples[a:b])), reference) for a, b in pairwise(edges)]
        np.testing.assert_array_equal(np.concatenate(parts), whole)


@ALL
def test_points_side_by_side_have_the_columns_of_each(
    name: str, context: Context, reference: Reference, features: Features
) -> None:
    """Whatever makes them together, for neighbours, for points far apart, and in pieces."""
    cls, all_points = EFFECTS[name], points(EFFECTS[name], context)
    for some in (all_points[:1], all_points[:9], all_points[-9:], all_points[:: max(1, len(all_points) // 7)]):
        if not some:
            continue
        each = np.concatenate([cls.columns(params)(features, reference) for params in some], axis=1)
        together = cls.side_by_side(some)
        made = np.concatenate([together(features[part], reference) for part in (np.s_[:701], np.s_[701:])])
        np.testing.assert_allclose(made, each, rtol=0.0, atol=1e-11 * max(1.0, float(np.abs(each).max())))


@pytest.mark.parametrize(
    "name",
    [n for n, c in EFFECTS.items() if c.columns.__func__ is not Effect.columns.__func__],  # type: ignore[attr-defined]
)
def test_regressor_has_the_shape_of_its_effect(
    name: str, clean: Trace, context: Context, features: Features, reference: Reference
) -> None:
    cls = EFFECTS[name]
    effect = cls(size=0.03)
    _, (ready,) = compose(clean, [effect], noise=0.0, every=EVERY, seed=2)
    fine = effect.stage in FINE
    before = clean if fine else clean.sampled(EVERY)
    after = ready.apply(before, np.random.default_rng(0))
    after = after.lubricated() if effect.stage == "lubrication" else after
    change = effect.change(before, after)[:: EVERY if fine else 1]
    best = 0.0
    # What a short stroke shows nothing of is not proposed there, but has its shape all the same.
    proposed = points(cls, context) or cls.grid(replace(context, stroke_m=2.0))
    grid = [p | {k: ready[k] for k in p if k in ready.values} for p in proposed]
    for params in grid:
        columns = cls.columns(params)(features, reference)
        fitted = columns @ np.linalg.lstsq(columns, change, rcond=None)[0]
        best = max(best, float(fitted @ fitted / (change @ change)))
    assert best > 0.8


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("inertia:mass=-1", "out of range [0, 1e+06] kg"),
        ("inertia:weight=1", "has no key 'weight'"),
        ("inertia:mass=heavy", "is no number"),
        ("inertia:mass", "is not key=value"),
        ("inertia:mass=1,mass=2", "given twice"),
        ("inertia:size=2", "out of range (0, 1]"),
        ("inertia:mass=nan", "out of range"),
        ("weight", "unknown effect 'weight'"),
    ],
)
def test_bad_text_is_one_clear_line(text: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_effect(text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_size_out_of_reach_is_refused(clean: Trace) -> None:
    with pytest.raises(ConfigError, match="cannot reach size"):
        compose(clean, [parse_effect("dropout:size=1")], noise=0.0, every=EVERY, seed=0)


def test_effects_compose_in_the_order_of_their_stages(clean: Trace) -> None:
    pair = [parse_effect("quantization:step=0.5"), parse_effect("sensor_bias:bias=0.2")]
    one, _ = compose(clean, [*pair, parse_effect("inertia:mass=1")], noise=0.0, every=EVERY, seed=0)
    other, _ = compose(clean, [parse_effect("inertia:mass=1"), *pair], noise=0.0, every=EVERY, seed=0)
    np.testing.assert_allclose(one.friction_N, other.friction_N)


@settings(max_examples=40, deadline=None)
@given(st.floats(1e-6, 1e-3), st.lists(st.floats(-0.1, 0.1), min_size=3, max_size=60))
def test_bristle_stays_within_its_bounds(length: float, velocities: list[float]) -> None:
    v = np.array(velocities)
    out = np.empty(v.size)
    from friction_estimator.effects.kernels import hysteron, play, slip_chain

    step = np.full(v.size, 0.005)
    before = np.concatenate([v[:1], v[:-1]])
    for machine in (hysteron, slip_chain):
        machine(step, before, v, length, np.zeros(2), out)
        assert np.all(np.abs(out) <= 2.0 + 1e-9)
    play(step, before, v, length, np.zeros(2), out)
    assert set(np.unique(out)) <= {0.0, 1.0}


def test_an_element_that_slips_forth_and_back_within_a_sample_remembers_both() -> None:
    """The net distance of such a sample is next to nothing; the element has been through its whole slip length."""
    from friction_estimator.effects.kernels import slip_chain

    length, dt, fine = 2e-5, 0.01, 1000
    v = np.array([0.02, 0.012, 0.004, -0.004, -0.012])
    dense = np.interp(np.linspace(0.0, 4.0, 4 * fine + 1), np.arange(5.0), v)
    found, exact = np.empty(v.size), np.empty(dense.size)
    slip_chain(np.full(v.size, dt), np.concatenate([v[:1], v[:-1]]), v, length, np.zeros(2), found)
    before = np.concatenate([dense[:1], dense[:-1]])
    slip_chain(np.full(dense.size, dt / fine), before, dense, length, np.zeros(2), exact)
    np.testing.assert_allclose(found, exact[::fine], atol=2e-3)


@pytest.mark.parametrize("rest", [1, 4])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_dwell_before_a_reversal_ends_where_the_way_back_begins(rest: int, way: float) -> None:
    """A sample at rest in between, as sines of a whole number of samples have, is no part of the way back."""
    from friction_estimator.effects.kernels import rest_spike

    dt, slope = 0.005, 1e-3
    ramp = slope * np.arange(1.0, 6.0)
    v = way * np.concatenate([ramp[::-1], np.zeros(rest), -ramp])
    out = np.empty(v.size)
    before = np.concatenate([v[:1], v[:-1]])
    rest_spike(np.full(v.size, dt), before, v, 1e30, 2.5 * slope, 1.0, np.zeros(4), out)
    assert np.all(out[: 5 + rest] == 0.0)
    np.testing.assert_allclose(out[5 + rest :], -way * (2.5 + rest - 1) * dt)


def test_features_integrate_position_where_none_is_recorded(samples: Samples) -> None:
    made = FeatureMaker(0.0, 0.0, 20.0)(replace(samples, position_m=None, restart=np.zeros(len(samples), np.bool_)))
    recorded = samples.position_m
    assert recorded is not None
    drift = made.position_m - (recorded - recorded[0])
    assert np.abs(drift).max() < 2e-4


def test_a_copy_of_what_is_kept_of_arrays_knows_none_of_them() -> None:
    """Arrays are known by where they lie; those of another process, or of a copy, may lie where others did."""
    axis, velocity = VelocityAxis(0.1), np.linspace(-0.1, 0.1, 5)
    shares = axis.shares(velocity)
    assert axis.shares(velocity[:]) is shares
    assert deepcopy(axis).shares(velocity) is not shares
    np.testing.assert_allclose(shares, deepcopy(axis).shares(velocity))


def test_a_ripple_has_a_phase_of_its_own_in_each_recording(features: Features, reference: Reference) -> None:
    from friction_estimator.effects.columns import amplitudes, per_recording

    columns = np.arange(2.0 * features.size).reshape(-1, 2)
    number = (np.arange(features.size) >= 100).astype(np.int64)
    split = per_recording(columns, replace(features, recording=number), {"recordings": 2.0})
    np.testing.assert_array_equal(split[:100], np.column_stack([columns[:100], 0.0 * columns[:100]]))
    np.testing.assert_array_equal(split[100:], np.column_stack([0.0 * columns[100:], columns[100:]]))
    assert amplitudes(np.array([3.0, 4.0, 0.0, 5.0]), {"recordings": 2.0}) == pytest.approx([5.0])
    cls = EFFECTS["position_dependence"]
    params = {"wavelength": 1e-3, "recordings": 3.0}
    assert cls.columns(params)(features, reference).shape == (features.size, 12)


@ALL
def test_a_figure_can_be_drawn_of_each(name: str) -> None:
    from friction_estimator.report.diagnosis_figures import FIGURES

    cls = EFFECTS[name]
    assert cls.figure in ("reveals", *FIGURES)
    assert (cls.figure == "reveals") == (cls.detects_at == "" and cls.counted.__func__ is Effect.counted.__func__)  # type: ignore[attr-defined]


def test_a_spring_has_the_middle_of_each_recording(features: Features, reference: Reference, context: Context) -> None:
    number = (np.arange(features.size) >= features.size // 2).astype(np.int64)
    moved = replace(features, recording=number, position_m=features.position_m + 0.7 * number)
    cls = EFFECTS["side_spring"]
    assert cls.peaks(np.zeros(features.size), features, context) == []
    (params,) = cls.peaks(np.zeros(features.size), moved, context)
    column = cls.columns(params)(moved, reference)[:, 0]
    np.testing.assert_allclose(column, features.position_m, atol=1e-5)
