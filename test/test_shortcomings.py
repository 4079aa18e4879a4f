"""Why a prediction is no better: each reason is hidden in a record and named, and none where there is none."""

import json
from dataclasses import replace

import numpy as np
import pytest

from friction_estimator.cli.main import main
from friction_estimator.core.online.record_figures import RecordFigures
from friction_estimator.core.online.replay import replay
from friction_estimator.core.online.shortcomings import Judgement, in_motion, shortcomings
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config

RATE = 200.0
COUNT = 8000


def friction(velocity: np.ndarray) -> np.ndarray:
    return np.tanh(velocity / 0.01) * (3.0 + 2.0 * np.exp(-np.abs(velocity) / 0.05)) + 4.0 * velocity


def record(velocity: np.ndarray, noise: float = 0.02, seed: int = 0) -> Samples:
    position = np.cumsum(velocity) / RATE
    force = friction(velocity) + noise * np.random.default_rng(seed).standard_normal(velocity.size)
    stamp = np.arange(velocity.size, dtype=np.int64) * round(1e9 / RATE)
    return Samples(stamp, velocity, force, np.arange(velocity.size) == 0, position_m=position)


def two_sines() -> np.ndarray:
    time = np.arange(COUNT) / RATE
    return 0.3 * np.sin(2.0 * np.pi * 0.9 * time) + 0.1 * np.sin(2.0 * np.pi * 0.313 * time)


def judgement(samples: Samples, predicted: np.ndarray | None = None, top: float = 0.4) -> Judgement:
    """The first half learned from, the second judged; predicted by the true curve unless given."""
    half = np.arange(len(samples)) >= len(samples) // 2
    known = friction(samples.velocity_m_s) if predicted is None else predicted
    figures = RecordFigures(samples, learned=~half, top_speed_m_s=top)
    return Judgement(figures, known, frozenset(), np.zeros(len(samples)), np.zeros(len(samples)))


def named(judged: Judgement) -> list[str]:
    return [one.name for one in shortcomings(judged)]


def test_nothing_is_named_where_the_prediction_is_good_or_the_error_is_noise():
    assert named(judgement(record(two_sines()))) == []
    assert named(judgement(record(two_sines(), noise=2.0))) == []


def test_a_shaft_that_is_stuck():
    velocity = two_sines()
    velocity[COUNT * 5 // 8 :] = 0.0
    samples = record(velocity)
    held = np.where(velocity == 0.0, 2.0 * np.sin(np.arange(COUNT) / 50.0), 0.0)
    judged = judgement(replace(samples, friction_N=samples.friction_N + held))
    assert named(judged) == ["standstill"]
    moving = in_motion(judged)
    assert moving.standing_share == pytest.approx(0.75, abs=0.02)
    assert moving.nrmse < 0.05
    assert moving.baselines["coulomb_viscous"] < 0.1


def test_another_recording_is_scored_in_motion_by_its_own_samples():
    """Beside curves that were fitted to what moved where the model learned."""
    velocity = two_sines()
    velocity[COUNT * 5 // 8 :] = 0.0
    other = record(velocity, seed=1)
    held = np.where(velocity == 0.0, 2.0 * np.sin(np.arange(COUNT) / 50.0), 0.0)
    learned = replay(record(two_sines()), Config.from_mapping({"model.type": "hammerstein"}))
    judged = learned.judge("other", replace(other, friction_N=other.friction_N + held))
    moving = judged.in_motion
    assert moving.samples == pytest.approx(COUNT * 5 / 8, abs=0.02 * COUNT)
    assert moving.standing_share == pytest.approx(3 / 8, abs=0.02)
    assert moving.nrmse < 0.03
    assert judged.score.nrmse > 0.2
    assert moving.nrmse < moving.baselines["coulomb_viscous"] < 0.1
    # Not by those of the recording that was learned, where it never stands.
    assert learned.in_motion.samples == pytest.approx(COUNT, abs=0.02 * COUNT)


def test_a_direction_and_speeds_that_nothing_was_learned_of():
    velocity = two_sines()
    velocity[: COUNT // 2] = np.abs(velocity[: COUNT // 2]) + 0.01
    samples = record(velocity)
    constant = np.full(COUNT, 4.0)
    assert named(judgement(samples, np.where(velocity > 0.0, friction(velocity), constant)))[0] == "direction"
    fast = record(two_sines() * np.where(np.arange(COUNT) < COUNT // 2, 0.3, 1.0))
    held = np.where(np.abs(fast.velocity_m_s) > 0.12, 0.0, friction(fast.velocity_m_s))
    assert named(judgement(fast, held)) == ["speeds"]


@pytest.mark.parametrize("kinds", [["inertia"], ["spring"], ["gravity"], ["inertia", "gravity"]])
def test_a_load_is_named_by_its_kind(kinds):
    samples = record(two_sines())
    position = 8.0 * samples.position_m  # an arm that swings
    samples = replace(samples, position_m=position)
    acceleration = np.gradient(samples.velocity_m_s, 1.0 / RATE)
    load = {"inertia": 3.0 * acceleration, "spring": 2.0 * position, "gravity": 4.0 * np.sin(position + 0.3)}
    effort = samples.friction_N + sum(load[kind] for kind in kinds)
    found = shortcomings(judgement(replace(samples, friction_N=effort)))
    assert [one.name for one in found] == ["load"]
    several = " and " in found[0].text.partition(" beside")[0]
    assert (" explain " if several else " explains ") in found[0].text
    if kinds != ["spring"]:  # over a small swing a spring and gravity are one
        assert all(kind in found[0].advice for kind in kinds)


def test_friction_that_changes_with_time():
    samples = record(two_sines())
    wear = np.linspace(1.0, 2.5, COUNT)
    judged = judgement(replace(samples, friction_N=samples.friction_N * wear), 1.3 * friction(samples.velocity_m_s))
    assert named(judged) == ["time"]


def test_the_advice_on_a_load_helps_when_it_is_followed(tmp_path, capsys):
    """A pendulum's effort without `load.terms`, then with those that replay itself advises."""
    run = tmp_path / "run"
    arguments = ["--plant", "pendulum", "--rate", "200", "--schedule", "2:50:40:multisine", "--seed", "3"]
    assert main(["simulate", *arguments, "--out", str(run)]) == 0
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    assert main(["replay", str(run), "--freeze-after", "0.5", "--json", str(first)]) == 0
    before = json.loads(first.read_text())
    (advice,) = [one["advice"] for one in before["shortcomings"] if one["name"] == "load"]
    terms = advice.split("[")[1].split("]")[0]
    config = tmp_path / "load.yaml"
    config.write_text(f"/**:\n  ros__parameters:\n    load.terms: [{terms}]\n")
    capsys.readouterr()
    arguments = ["--config", str(config), "--freeze-after", "0.5", "--json", str(second)]
    assert main(["replay", str(run), *arguments]) == 0
    after = json.loads(second.read_text())
    assert after["nrmse_frozen"] < 0.3 * before["nrmse_frozen"]
    assert "load" not in [one["name"] for one in after["shortcomings"]]
