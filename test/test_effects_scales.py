"""Grids are in units of the record, and what lies beyond the record is refused in words."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_estimator.core.quantities import Quantities
from friction_estimator.effects import EFFECTS
from friction_estimator.effects.base import Effect
from friction_estimator.effects.features import Context


def context_of(speed: float, stroke: float, rate_hz: float, force: float = 4.0, duration_s: float = 100.0) -> Context:
    """A sine of this top speed and stroke."""
    period = np.pi * stroke / speed
    return Context(
        duration_s=duration_s,
        step_s=1.0 / rate_hz,
        distance_m=2.0 * stroke * duration_s / period,
        stroke_m=stroke,
        centre_m=0.0,
        top_speed_m_s=speed,
        force_rms_N=force,
        force_top_N=2.0 * force,
        pressure_mean_Pa=1e6,
        pressure_span_Pa=1e6,
        sign_velocity_m_s=speed / 60.0,
        periods_s=(period,),
        channels=("position", "pressure"),
    )


WITH_GRID = [n for n, c in EFFECTS.items() if c.grid(context_of(0.1, 0.04, 200.0))]
SLOW, USUAL, FAST = context_of(1e-3, 1e-5, 2000.0, 1.0), context_of(0.1, 0.04, 200.0), context_of(1.0, 0.3, 5000.0, 5e3)


@pytest.mark.parametrize("name", WITH_GRID)
@pytest.mark.parametrize("context", [SLOW, USUAL, FAST], ids=["1e-3 m/s", "0.1 m/s", "1 m/s at 5 kHz"])
def test_every_point_of_a_grid_lies_within_the_record(name: str, context: Context) -> None:
    cls = EFFECTS[name]
    points = cls.grid(context)
    assert points
    for params in points:
        assert cls.spans(params, np.ones(1), context) is None, params
        for key in [name for name in cls.refined if name in params]:
            low, high = cls.bracket(key, params[key], context)
            assert low <= params[key] <= high
            assert (low, high) == (0.0, 1.0) if key in cls.shares else low > 0.0


@settings(max_examples=50, deadline=None)
@given(st.floats(1e-3, 1.0), st.floats(0.05, 20.0), st.floats(100.0, 5000.0))
@pytest.mark.parametrize("name", [n for n in WITH_GRID if EFFECTS[n].acts == "reversal"])
def test_grids_scale_with_the_record(name: str, speed: float, period: float, rate_hz: float) -> None:
    """The same record in other units of length has the same grid in those units; time likewise."""
    cls, stroke = EFFECTS[name], speed * period / np.pi
    one = cls.grid(context_of(speed, stroke, rate_hz))
    longer = cls.grid(context_of(10.0 * speed, 10.0 * stroke, rate_hz))
    slower = cls.grid(context_of(speed / 10.0, stroke, rate_hz / 10.0, duration_s=1000.0))
    assert len(one) == len(longer) == len(slower)
    for key in one[0].keys() - set(cls.shares):
        values = np.array([p[key] for p in one])
        for other in (longer, slower):
            ratio = np.array([p[key] for p in other]) / values
            np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)
            assert min(abs(np.log10(ratio[0]) - k) for k in (-1.0, 0.0, 1.0)) < 1e-6


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0, 5000.0])
@pytest.mark.parametrize("name", [n for n in WITH_GRID if EFFECTS[n].delays])
def test_delays_reach_from_a_fifth_of_a_millisecond_to_fifty(name: str, rate_hz: float) -> None:
    cls = EFFECTS[name]
    (key,) = cls.refined
    values = [p[key] for p in cls.grid(context_of(0.1, 0.04, rate_hz))]
    assert min(values) <= 2e-4
    assert max(values) >= 5e-2


BEYOND = [
    ("viscoelastic_relaxation", {"time_constant": 60690.0}, "fifth of the record"),
    ("viscoelastic_relaxation", {"time_constant": 0.005}, "below two sample periods"),
    ("position_dependence", {"wavelength": 0.021}, "half the stroke"),
    ("wear", {"length": 1e4}, "twice the distance"),
    ("viscosity_drift", {"time_constant": 1e4}, "twice the recording"),
    ("wear", {"length": 0.03}, "over where the record begins"),
    ("viscosity_drift", {"time_constant": 0.6}, "over where the record begins"),
    ("time_delay", {"delay": 1e-6}, "hundredth of the sample"),
    ("time_delay", {"delay": 0.5}, "quarter of the shortest"),
    ("sensor_lowpass", {"time_constant": 0.5}, "quarter of the shortest"),
    ("frictional_lag", {"lag": 0.5}, "quarter of the shortest"),
    ("presliding", {"length": 0.02}, "quarter of the stroke"),
    ("breakaway", {"length": 0.02}, "quarter of the stroke"),
    ("backlash", {"gap": 0.02}, "quarter of the stroke"),
    ("periodic_disturbance", {"frequency": 0.01}, "cycles"),
    ("periodic_disturbance", {"frequency": 150.0}, "half the sample rate"),
    ("saturation", {"level": 20.0}, "above every force"),
    ("saturation", {"level": 2.0}, "goes on to 8 N"),
]


@pytest.mark.parametrize(("name", "params", "words"), BEYOND)
def test_what_lies_beyond_the_record_is_refused_in_words(name: str, params: dict[str, float], words: str) -> None:
    assert words in Quantities().worded(str(EFFECTS[name].spans(params, np.ones(1), USUAL)))


@pytest.mark.parametrize(("name", "stroke"), [("wear", 0.04), ("viscosity_drift", 0.2 * np.pi)])
def test_a_slow_change_is_sought_from_a_stroke_on(name: str, stroke: float) -> None:
    """What is over sooner is what a record begins with; of long strokes a small part is enough (decision 0241)."""
    cls = EFFECTS[name]
    (key,) = cls.refined
    assert cls.bracket(key, 1.5 * stroke, USUAL)[0] == pytest.approx(stroke)
    assert cls.spans({key: 1.01 * stroke}, np.ones(1), USUAL) is None
    one_way = replace(USUAL, stroke_m=USUAL.distance_m)
    twelfth = min(params[key] for params in cls.grid(one_way))
    assert cls.bracket(key, twelfth, one_way)[0] == pytest.approx(twelfth / 2.5)
    assert cls.spans({key: twelfth / 2.4}, np.ones(1), one_way) is None


@pytest.mark.parametrize(("waves", "unlike"), [(7.9, False), (8.1, True)])
def test_a_ripple_of_many_waves_is_no_form_of_anything_else(waves: float, unlike: bool) -> None:
    ripple = EFFECTS["position_dependence"]
    assert ripple.unlike({"wavelength": USUAL.stroke_m / waves}, USUAL) == unlike
    assert ripple.unlike({"wavelength": 1e-4, "second_wavelength": USUAL.stroke_m / waves}, USUAL) == unlike
    assert not Effect.unlike({}, USUAL)


def test_what_has_a_sign_in_physics_has_it_and_a_spring_has_none() -> None:
    assert EFFECTS["inertia"].signs == (1,)
    assert EFFECTS["side_spring"].signs == (0,)


def test_effects_that_stand_by_default_refuse_nothing_and_find_nothing() -> None:
    assert Effect.spans({}, np.ones(1), USUAL) is None
