"""One time of the whole force: it moves the base model and every effect that acts before it."""

import numpy as np
import pytest

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import SPLINES, BaseProblem, Capacity
from friction_estimator.diagnosis.joint import JointFit, Term, before
from friction_estimator.diagnosis.record import build_record
from friction_estimator.effects import EFFECTS, parse_effect
from friction_estimator.rig.drive import segment
from friction_estimator.rig.simulate import Scenario, simulate

SEAL = Config.from_mapping({"theory.kind": "seal"})

SEGMENTS = (segment(1.0, 50.0, 16.0), segment(4.0, 50.0, 24.0))


def test_a_slow_column_is_moved_by_the_time() -> None:
    samples = simulate(Scenario((segment(1.0, 50.0, 4.0),), plant="clean", rate_hz=200.0, seed=1)).samples
    record = build_record([samples], Config())
    f = record.features
    omega, late = 2.0 * np.pi, 0.008
    scale = f.velocity_m_s.max()
    inside = slice(20, -20)
    for sign in (1.0, -1.0):
        moved = record.features_at(Config(), sign * late).velocity_m_s
        turned = f.velocity_m_s * np.cos(omega * late) - sign * f.acceleration_m_s2 / omega * np.sin(omega * late)
        np.testing.assert_allclose(moved[inside], turned[inside], atol=5e-3 * scale)
    wave = np.column_stack([np.sin(f.time_s), np.cos(f.time_s)])
    lagged = EFFECTS["sensor_lowpass"].smoothed({"time_constant": late}, wave, f)
    expected = np.column_stack([np.sin(f.time_s - late), np.cos(f.time_s - late)])
    np.testing.assert_allclose(lagged[inside], expected[inside], atol=1e-4)


def test_only_what_acts_before_the_time_is_moved() -> None:
    assert before(EFFECTS["direction_asymmetry"], EFFECTS["time_delay"])
    assert not before(EFFECTS["sensor_bias"], EFFECTS["time_delay"])


def test_a_delay_behind_bristles_is_found() -> None:
    """Without moving what the bristles take away, a delay of 3 ms made the fit worse than none."""
    hidden = (parse_effect("time_delay:delay=0.003"),)
    samples = simulate(Scenario(SEGMENTS, plant="maxwell_slip", rate_hz=200.0, seed=4, effects=hidden)).samples
    record = build_record([samples], Config())
    context = record.context(Config(), float(np.abs(record.friction_N).max()))
    fit = JointFit(BaseProblem(record, SEAL, Capacity(SPLINES, Config().fir.order)), context)
    bristles = Term(EFFECTS["presliding"], {"length": 3e-5, "spread": 1.0})
    without = fit([bristles])
    found = fit([*without.terms, Term(EFFECTS["time_delay"], {"delay": 1e-3})], without.base.coefficients)
    assert found.terms[-1].params["delay"] == pytest.approx(0.003, abs=1e-4)
    assert found.base.coefficients.cost < 0.8 * without.base.coefficients.cost
