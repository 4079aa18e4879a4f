"""Which curve `theory.kind: auto` comes to, why, how long it lasts, and that live and replay come to the same."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import noisy, samples_of, stribeck

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.metrics import nrmse
from friction_estimator.core.model.theory_choice import choice, told, warning
from friction_estimator.core.online.estimator import Estimator, stated_config
from friction_estimator.core.online.first_contact import chosen, meet
from friction_estimator.core.online.live import LiveStep
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config

RATE = 500
PERIOD_S = 2.0
SCALES = {"0.001 m/s, 5 kN": (1e-3, 5e3, "linear"), "1 m/s, 3 N": (1.0, 3.0, "linear"), "rotary": (40.0, 0.2, "rotary")}


def drive(speed: float = 0.05, force: float = 5.0, cycles: float = 6.0, seed: int = 0) -> Samples:
    """A crank at this top speed, whose friction is of about this size, unlike in the two directions, with a memory."""
    phase = 2.0 * np.pi * np.arange(int(cycles * PERIOD_S * RATE)) / (PERIOD_S * RATE)
    velocity = np.sin(phase) + 0.2 * np.sin(2.0 * phase)
    shape = stribeck(0.04 * velocity) * np.where(velocity > 0.0, 1.1, 0.9)
    friction = noisy(0.7 * shape + 0.3 * np.append(shape[:1], shape[:-1]), 0.01, seed)
    return samples_of(speed * velocity, force / 3.0 * friction, RATE)


def with_pressure(samples: Samples, start: int = 0, gauge: float = 3.4e5) -> Samples:
    pressure = np.full(len(samples), 101325.0 + gauge)
    pressure[:start] = np.nan
    return replace(samples, pressure_Pa=pressure)


def test_a_recorded_pressure_makes_it_the_seal_bit_for_bit():
    samples = with_pressure(drive())
    auto, seal = (replay(samples, Config.from_mapping(given)) for given in ({}, {"theory.kind": "seal"}))
    assert auto.config.learned.theory == "seal"
    assert told(auto.config, True) == "seal: a pressure is recorded"
    np.testing.assert_array_equal(auto.predicted_N, seal.predicted_N)


@pytest.mark.parametrize(
    ("values", "pressure", "kind", "reason"),
    [
        ({}, False, "stribeck", "no pressure is recorded"),
        ({"seal.roughness": 1e-7}, False, "seal", "seal.roughness is set"),
        ({"theory.default_pressure": 1e6}, False, "seal", "theory.default_pressure is set"),
        ({"force_unit": 5e3}, True, "stribeck", "times the measured one"),
        ({"input.motion": "rotary"}, True, "stribeck", "rotary"),
        ({"theory.kind": "seal"}, False, "seal", "theory.kind is seal"),
    ],
)
def test_the_choice_and_its_reason(values, pressure, kind, reason):
    config = Config.from_mapping({"basis.velocity_range": [-0.1, 0.1], "force_unit": 5.0} | values)
    found = choice(config, pressure)
    assert found.kind == kind
    assert reason in found.reason


def test_pressure_that_appears_later_changes_nothing_but_is_said():
    late = with_pressure(drive(), start=4000)
    never = drive()
    first, second = replay(late, Config()), replay(never, Config())
    assert first.config.learned.theory == "stribeck"
    np.testing.assert_array_equal(first.predicted_N, second.predicted_N)
    assert "~/reset" in warning(first.config, pressure=True)
    assert not warning(first.config, pressure=False)
    assert not warning(replay(with_pressure(drive()), Config()).config, pressure=True)


def test_a_seal_on_a_rotary_drive_is_warned_of():
    given = {"theory.kind": "seal", "basis.velocity_range": [-1.0, 1.0], "force_unit": 1.0}
    assert "rad/s for m/s" in warning(Config.from_mapping({**given, "input.motion": "rotary"}), pressure=False)
    assert not warning(Config.from_mapping({**given, "input.motion": "linear"}), pressure=False)


def test_with_range_and_unit_given_a_pressure_ends_the_wait_at_once():
    units = Config.from_mapping({"basis.velocity_range": [-0.1, 0.1], "force_unit": 5.0})
    assert meet(units, with_pressure(drive())).samples == 32
    assert meet(units, drive()).samples > 0.5 * PERIOD_S * RATE, "a curve is found from strokes"


def test_without_theory_parallel_says_that_it_is_hammerstein():
    samples = drive()
    none, plain = (
        replay(samples, Config.from_mapping(given))
        for given in ({"theory.kind": "none"}, {"model.type": "hammerstein"})
    )
    np.testing.assert_array_equal(none.predicted_N, plain.predicted_N)
    assert "run as hammerstein" in told(none.config, False)


def test_the_curve_is_kept_in_the_state_and_another_contact_would_not_change_it():
    run = replay(drive(), Config())
    state = run.estimator.state()
    assert state["chosen"]["learned.theory"] == "stribeck"
    taken = Estimator(stated_config(Config(), state))
    taken.restore(state)
    more = drive(speed=0.02, seed=1)
    np.testing.assert_array_equal(taken.run(more), run.estimator.run(more))
    warm = run.estimator.learned_config
    assert chosen(warm, drive(speed=0.5, force=50.0)) == warm


def test_a_state_of_another_curve_is_refused_by_name():
    state = replay(drive(), Config()).estimator.state()
    seal = replay(drive(), Config.from_mapping({"theory.kind": "seal"})).estimator
    with pytest.raises(ConfigError, match=r"theory\.kind = stribeck, this estimator has seal"):
        seal.restore(state)


def lived(samples: Samples, config: Config) -> list[float]:
    """Return predictions made one pair at a time."""
    step = LiveStep(Intake(config), config)
    out: list[float] = []
    for stamp, velocity, friction in zip(samples.stamp_ns, samples.velocity_m_s, samples.friction_N, strict=True):
        step.stream[:2], step.stamp_ns[:2], step.value[:2] = (0, 1), stamp, (velocity, friction)
        out += [found[3] for found in step.run(2, learn=True)]
    return out


@pytest.mark.parametrize("scale", SCALES)
def test_nothing_configured_is_as_good_as_configured_at_any_scale(scale):
    speed, force, motion = SCALES[scale]
    samples = drive(speed, force)
    given_units = {"basis.velocity_range": [-1.3 * speed, 1.3 * speed], "force_unit": force}
    nothing = Config.from_mapping({"input.motion": motion})
    told_, run = (replay(samples, config) for config in (nothing.updated(given_units), nothing))
    assert run.config.learned.theory == "stribeck"
    late = slice(round(2 * PERIOD_S * RATE), None)
    ours, theirs = (nrmse(r.samples.friction_N[late], r.predicted_N[late]) for r in (run, told_))
    assert ours <= 1.1 * theirs
    assert ours < 0.02
    assert lived(samples, nothing) == run.predicted_N.tolist()


def test_a_slow_start_and_a_hundred_times_the_speed_stay_sane():
    """The curve of a crawl is held at twice its speeds; g learns the rest as the range grows."""
    slow, fast = drive(speed=1e-3, cycles=2.0), drive(speed=0.1, cycles=6.0)
    velocity = np.concatenate([slow.velocity_m_s, fast.velocity_m_s])
    samples = samples_of(velocity, noisy(stribeck(velocity) + 30.0 * velocity, 0.01), RATE)
    run = replay(samples, Config())
    assert run.health.grown > 0
    assert np.abs(run.predicted_N).max() < 2.0 * np.abs(samples.friction_N).max()
    hammerstein = replay(samples, Config.from_mapping({"model.type": "hammerstein"}))
    assert run.figures()["nrmse_final"] < 1.05 * hammerstein.figures()["nrmse_final"]
