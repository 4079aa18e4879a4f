"""Pressures that come in one order: what may be called a dependence on them, and what may not."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_records import ONE_PRESSURE, chosen, names, record, set_of

from friction_estimator.core.sample import Floats, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.diagnosis.diagnose import Diagnosis, diagnose
from friction_estimator.diagnosis.pressures import pressure_order, pressures_held
from friction_estimator.diagnosis.record import build_record
from friction_estimator.effects import EFFECTS, Effect, parse_effect
from friction_estimator.effects.base import SLOW
from friction_estimator.effects.trace import Trace
from friction_estimator.rig.drive import segment
from friction_estimator.rig.law import lagged
from friction_estimator.rig.plant import PLANTS
from friction_estimator.rig.simulate import Scenario, simulate

SLOW_ONES: Mapping[str, type[Effect]] = {
    name: effect for name, effect in EFFECTS.items() if effect.acts == SLOW or name == "pressure_dependence"
}


def at_pressures(levels: tuple[float, ...], seconds: float = 8.0) -> Samples:
    parts = tuple(segment(1.0, psi, seconds) for psi in levels)
    return simulate(Scenario(parts, rate_hz=100.0)).samples


def test_one_order_of_pressures_is_warned_of() -> None:
    def run(levels: tuple[float, ...]) -> str:
        return pressure_order(build_record([at_pressures(levels)], Config()))

    assert "randomise" in run((50.0, 100.0, 200.0))
    assert run((50.0, 200.0, 50.0)) == ""
    assert run((50.0, 50.0)) == ""


def leaks(pressure_Pa: Floats) -> Floats:
    """Each of three pressures falls by an eighth while it is held."""
    return pressure_Pa * (1.0 - np.tile(np.linspace(0.0, 0.125, pressure_Pa.size // 3), 3))


def spikes(pressure_Pa: Floats) -> Floats:
    return np.where(np.arange(pressure_Pa.size) // 3 == 200, 40e5, pressure_Pa)


def vents(pressure_Pa: Floats) -> Floats:
    return np.where(np.arange(pressure_Pa.size) >= 0.97 * pressure_Pa.size, 0.1e5, pressure_Pa)


@pytest.mark.parametrize("happens", [leaks, spikes, vents])
def test_what_is_not_held_does_not_hide_the_order_of_pressures(happens: Callable[[Floats], Floats]) -> None:
    samples = at_pressures((50.0, 100.0, 200.0), 20.0)
    assert samples.pressure_Pa is not None
    record = build_record([replace(samples, pressure_Pa=happens(samples.pressure_Pa - 101325.0) + 101325.0)], Config())
    assert pressure_order(record)
    assert pressures_held(record)


def test_a_ramp_holds_no_pressure() -> None:
    samples = at_pressures((50.0, 50.0, 50.0), 20.0)
    ramp = np.linspace(1.5e5, 5e5, len(samples))
    record = build_record([replace(samples, pressure_Pa=ramp)], Config())
    assert pressure_order(record)
    assert not pressures_held(record)


@pytest.mark.parametrize("psi", [(50.0, 200.0), (50.0, 100.0, 200.0)])
@pytest.mark.parametrize(
    "hidden",
    [
        "viscosity_drift:size=0.02",
        "viscosity_drift:size=0.04,time_constant=15",
        "pressure_dependence:size=0.04",
        "pressure_dependence:size=0.04,form=1",
    ],
)
def test_a_slow_change_that_goes_on_within_each_pressure_is_no_matter_of_the_pressure(hidden, psi) -> None:
    """With pressures in one order either is in the other's set."""
    segments = tuple(segment(t, p, s) for p in psi for t, s in ((1.0, 10.0), (5.0, 15.0)))
    name = hidden.split(":")[0]
    both = chosen("viscosity_drift", "pressure_dependence")
    (one,) = diagnose([record([hidden], segments=segments)], Config(), catalogue=both).effects
    assert one.name == name
    assert set_of(one) == set(both)


@pytest.mark.parametrize(
    ("at", "found", "least", "most"),
    [
        pytest.param(51.0, {"bias_step"}, 0.0, 8.0, id="within a pressure"),
        pytest.param(44.0, set(), 30.0, 100.0, id="where it changes"),
    ],
)
def test_a_step_beside_a_dependence_on_the_pressure_is_named_if_it_is_within_one(at, found, least, most) -> None:
    """The rig depends on its pressures, which come in one order: 50, 125 and 200 psi from 0, 22 and 44 s on."""
    segments = tuple(segment(t, p, s) for p in (50.0, 125.0, 200.0) for t, s in ((1.0, 7.0), (5.0, 15.0)))
    own = PLANTS["rig"].traits
    some = chosen(*own, "bias_step")
    hidden = (parse_effect(f"bias_step:step=0.5,at={at}"),)
    data = simulate(Scenario(segments, "rig", 100.0, 0.01, 3, hidden)).samples
    result = diagnose([data], Config.from_mapping({"theory.kind": "seal"}), catalogue=some)
    told = {effect.name: effect for effect in result.effects}
    assert set(told) - set(own) == found
    assert "bias_step" in {*told, *told["pressure_dependence"].rivals}
    assert least < result.unexplained_percent < most


def beside(term: Callable[[Trace], Floats], bars: tuple[float, ...], ramp: bool = False) -> Diagnosis:
    """Diagnose the clean plant with a term more, N, at these pressures or at one that rises all the time."""
    psi = tuple(bar * 14.5038 for bar in bars)
    parts = tuple(segment(t, p, s) for p in psi for t, s in ((1.0, 10.0), (5.0, 20.0)))

    def at(trace: Trace) -> Trace:
        rising = np.linspace(0.5e5, 4e5, trace.pressure_Pa.size)
        return replace(trace, pressure_Pa=rising) if ramp else trace

    def law(trace: Trace) -> Floats:
        return PLANTS["clean"](SealConfig(), 200.0)(at(trace)) + term(at(trace)) * np.tanh(trace.velocity_m_s / 0.01)

    samples = simulate(Scenario(parts, "clean", 200.0, 0.01, 904), law=law).samples
    if ramp:
        samples = replace(samples, pressure_Pa=np.linspace(0.5e5, 4e5, len(samples)) + 101325.0)
    return diagnose([samples], Config(), catalogue=SLOW_ONES)


@pytest.mark.parametrize("bars", [(1.0, 4.0), (4.0, 1.0)])
def test_friction_that_follows_the_pressure_late_is_no_change_in_time(bars) -> None:
    """A seal creeps into its groove. Nothing in the catalogue does: what is left is told, and has no name."""
    result = beside(lambda trace: 3e-6 * lagged(trace.pressure_Pa, trace.time_s[1] - trace.time_s[0], 8.0), bars)
    assert [effect.name for effect in result.effects] == ["pressure_dependence"]
    assert result.remainder is not None


def test_a_threshold_that_a_ramp_goes_through_is_no_step_in_time() -> None:
    result = beside(lambda trace: 0.25 * (1.0 + np.tanh((trace.pressure_Pa - 2.075e5) / 1e3)), (1.0, 1.0), ramp=True)
    assert [effect.name for effect in result.effects] == ["pressure_dependence"]
    assert "gain_step" in result.effects[0].rivals
    assert result.remainder is not None


@pytest.mark.parametrize("plant", ["clean", "stribeck"])
@pytest.mark.parametrize(
    ("hidden", "size", "way", "constant", "speeds"),
    [
        ("viscosity_drift:drop=0.1", "friction_drop", -1.0, {"time_constant": 20.0}, (0.98, 1.0)),
        ("wear:change=0.1", "friction_change", 1.0, {"length": 1.0}, (0.02, 0.05)),
    ],
)
def test_at_one_pressure_a_slow_change_is_one_of_the_friction(plant, hidden, size, way, constant, speeds) -> None:
    """Nothing there says which share of the friction is the theory's: a drop of 0.1 was 0.71 or 1.00."""
    ((name, value),) = constant.items()
    hidden = f"{hidden},{name}={value}"
    with_it, without = (record(e, plant=plant, segments=ONE_PRESSURE, noise=0.0) for e in ([hidden], []))
    speed = np.abs(without.velocity_m_s)
    gone_by = with_it.time_s if name == "time_constant" else np.cumsum(speed * np.gradient(with_it.time_s))
    there = (speed >= speeds[0] * speed.max()) & (speed <= speeds[1] * speed.max())
    more, done = with_it.friction_N[there] / without.friction_N[there] - 1.0, -np.expm1(-gone_by[there] / value)
    true = way * float(done @ more) / float(done @ done)
    found = diagnose([record([hidden], plant=plant, segments=ONE_PRESSURE)], Config(), catalogue=SLOW_ONES)
    assert names(found) == [hidden.split(":", maxsplit=1)[0]]
    assert found.effects[0].parameters.keys() == {size, name}
    assert found.effects[0].parameters[size].value == pytest.approx(true, rel=0.3)


def test_friction_that_rises_as_the_oil_warms_is_the_oils() -> None:
    """A thinner film takes less of the load: of the plain form the sign was wrong, and the free shape was not asked.

    At one pressure; a step of the gain was named, or nothing, with 8 to 33 % left.
    """
    samples = record(["viscosity_drift:size=0.04,time_constant=20"], plant="rig", segments=ONE_PRESSURE)
    some = chosen("direction_asymmetry", "frictional_lag", "inertia", "viscosity_drift", "wear", "gain_step")
    found = diagnose([samples], Config(), catalogue=some)
    warming = next(effect for effect in found.effects if effect.name == "viscosity_drift")
    assert {effect.name for effect in found.effects} == {"viscosity_drift", "direction_asymmetry", "frictional_lag"}
    assert warming.parameters["friction_drop"].high < 0.0
    constant = warming.parameters["time_constant"]
    assert constant.low < 20.0 < constant.high
    assert found.unexplained_percent < 2.0


@pytest.mark.parametrize(
    ("hidden", "noise"), [("viscosity_drift:size=0.04,time_constant=15", 0.03), ("wear:size=0.04,length=0.7", 0.01)]
)
def test_the_plain_form_is_taken_where_the_free_one_explains_no_more_than_chance(hidden: str, noise: float) -> None:
    """The screen's best was the free shape, whose size the record did not tell: a step of the gain was named."""
    triangles = (segment(1.0, 50.0, 15.0, "triangle"), segment(5.0, 50.0, 30.0, "triangle"))
    samples = simulate(Scenario(triangles, "clean", 100.0, noise, 100, (parse_effect(hidden),))).samples
    found = diagnose([samples], Config(), catalogue=SLOW_ONES)
    (term,) = found.models[-1].terms
    assert [effect.name for effect in found.effects] == [term.name] == [hidden.split(":", maxsplit=1)[0]]
    assert term.weights.size == 1


AT_LOW_SPEED = 0.1 / (1.0 + 0.8 * 0.03**0.6)
"""A tenth of the level, of the friction at 3 % of the top speed."""


@pytest.mark.parametrize("force", [5.0, 300.0])
@pytest.mark.parametrize(
    ("level", "viscous", "name", "rivals", "size", "true"),
    [
        pytest.param(0.1, 0.0, "wear", ("viscosity_drift",), "friction_change", AT_LOW_SPEED, id="worn"),
        pytest.param(-0.1, 0.0, "wear", ("viscosity_drift",), "friction_change", -AT_LOW_SPEED, id="run in"),
        pytest.param(0.0, -0.6, "viscosity_drift", (), "friction_drop", 0.6 * 0.8 / 1.8, id="warm"),
    ],
)
def test_at_one_pressure_the_forces_own_size_does_not_tell_wear_from_warming(
    force, level, viscous, name, rivals, size, true
) -> None:
    """A curve of no theory. At 5 N wear was a warming with a negative loss, and a loss of 0.267 was 0.233."""

    def law(trace: Trace) -> Floats:
        u = trace.velocity_m_s / np.abs(trace.velocity_m_s).max()
        worn = 1.0 + level * -np.expm1(-trace.distance_m / (0.3 * trace.distance_m[-1]))
        warm = 1.0 + viscous * -np.expm1(-trace.time_s / 20.0)
        return force * (np.tanh(u / 0.01) * worn + 0.8 * np.sign(u) * np.abs(u) ** 0.6 * warm)

    drive = (segment(6.0, 50.0, 60.0, "multisine"),)
    samples = simulate(Scenario(drive, "clean", 200.0, 0.01, 7), law=law).samples
    # Noise of the channel is no second pressure.
    pressure_Pa = samples.pressure_Pa * (1.0 + 0.03 * np.random.default_rng(8).standard_normal(len(samples)))
    samples = replace(samples, pressure_Pa=pressure_Pa)
    found = diagnose([samples], Config(), catalogue=SLOW_ONES)
    (told,) = found.effects
    assert (told.name, told.rivals) == (name, rivals)
    assert told.parameters[size].low < true < told.parameters[size].high
    assert told.parameters[size].value == pytest.approx(true, rel=0.15)


@pytest.mark.parametrize(
    ("plant", "hidden"),
    [
        ("stribeck", "pressure_dependence:size=0.1,form=1"),
        ("rig", "sensor_lowpass:time_constant=0.02"),
    ],
)
def test_a_free_shape_says_no_more_than_the_friction_at_speeds_that_the_drive_does_not_hold(plant, hidden) -> None:
    """Speed steps go through the lowest twentieth of the speeds in 24 of 9600 samples (decision 0239)."""
    steps = tuple(segment(8.0, psi, 24.0, "speed_steps") for psi in (70.0, 180.0))
    some = chosen("direction_asymmetry", "pressure_dependence", "frictional_lag", "sensor_lowpass")
    found = diagnose([record([hidden], plant=plant, segments=steps, seed=427)], Config(), catalogue=some)
    number, term = next((i, t) for i, t in enumerate(found.models[-1].terms) if t.name == "pressure_dependence")
    told = next(one for one in found.effects if one.term == number).parameters["boundary"]
    assert np.isfinite([told.low, told.high]).all()
    model = found.models[-1]
    speeds, high = np.linspace(0.01, 1.0, 100) * model.reference.top_m_s, float(model.features.pressure_Pa.max())
    there = model.features[slice(speeds.size)]
    there = replace(there, velocity_m_s=speeds, pressure_Pa=np.full(speeds.size, high))
    friction = model.reference.force(speeds, there.pressure_Pa)
    assert np.all(np.abs(term.columns(there, model.reference) @ term.weights) < np.abs(friction))
