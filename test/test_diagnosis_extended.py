"""The extended model: no further than it was measured, and better on a recording that it has not seen."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_records import chosen, record

from friction_estimator.cli.main import main
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import Diagnosis, diagnose
from friction_estimator.diagnosis.extend import extended_config, is_offered
from friction_estimator.documents.configuration import read_config, write_config
from friction_estimator.effects import parse_effect
from friction_estimator.effects.extension import ExtensionTerms, extension_from_config
from friction_estimator.effects.term import parse_term
from friction_estimator.rig.drive import Segment, segment
from friction_estimator.rig.plant import PLANTS
from friction_estimator.rig.simulate import Scenario, simulate

pytestmark = pytest.mark.xdist_group("diagnosis_extended")

SEAL = {"theory.kind": "seal"}

UNITS = {**SEAL, "basis.velocity_range": [-0.1, 0.1], "force_unit": 4.0}

FAST = tuple(segment(*s) for s in ((0.5, 50.0, 3.0), (0.25, 50.0, 1.5), (0.5, 200.0, 3.0), (0.25, 200.0, 1.5)))
UNLIKE = "direction_asymmetry:asymmetry=0.3"


def moved(position_m: np.ndarray, step_s: float = 0.01) -> Samples:
    """Return samples of a shaft at these positions."""
    velocity = np.gradient(position_m, step_s)
    stamps = 1 + np.round(np.arange(position_m.size) * step_s * 1e9).astype(np.int64)
    start = np.arange(position_m.size) == 0
    pressure = np.full(position_m.size, 5e5)
    return Samples(stamps, velocity, np.zeros(position_m.size), start, pressure, position_m=position_m)


def columns(terms: list[str], samples: Samples) -> np.ndarray:
    extension = ExtensionTerms(Config.from_mapping({"extension.terms": terms, **UNITS}))
    return extension.columns(samples, np.zeros(len(samples)))


def test_a_pattern_in_position_is_held_where_the_shaft_has_not_been() -> None:
    there = moved(np.linspace(-0.05, 0.05, 400))
    free = columns(["position_dependence:wavelength=0.004,part=0"], there)[:, 0]
    kept = columns(["position_dependence:wavelength=0.004,part=0,from=-0.02,to=0.021"], there)[:, 0]
    assert there.position_m is not None
    inside = (there.position_m >= -0.02) & (there.position_m <= 0.021)
    np.testing.assert_array_equal(kept[inside], free[inside])
    assert np.ptp(kept[there.position_m > 0.021]) == 0.0
    assert np.ptp(free[there.position_m > 0.021]) > 1.0


@pytest.mark.parametrize("term", ["sensor_drift:duration=2,part=2", "viscosity_drift:time_constant=3"])
def test_what_went_with_time_stops_where_it_was_measured(term: str) -> None:
    steady = moved(0.02 * np.arange(1000) * 0.01)
    kept = columns([f"{term},from=0.0,to=2.0"], steady)[:, 0]
    time = np.arange(1000) * 0.01
    if "sensor" in term:  # the cube of the time
        np.testing.assert_allclose(kept, np.minimum(time / 2.0, 1.0) ** 3, rtol=1e-9)
    late = kept[time > 2.0]
    assert np.ptp(late) <= 1e-9 * np.ptp(columns([term], steady)[time > 2.0])


def test_a_static_shape_keeps_its_value_beyond_the_top_speed() -> None:
    faster = moved(np.cumsum(np.linspace(0.0, 0.4, 400)) * 0.01)
    terms = [f"direction_asymmetry:shape=1,part={k}" for k in (0, 1)]
    found = columns(terms, faster)
    beyond = faster.velocity_m_s > 0.11
    assert np.abs(found[beyond, 1]).max() <= 1.001 * np.abs(found[beyond, 0]).max()


def test_a_wave_that_was_learned_is_left_out_on_another_recording() -> None:
    """Its phase there is another one: a wave of the wrong phase makes the error larger than none at all."""
    time = np.arange(4000) * 0.005
    wave, other = (0.5 * np.sin(2.0 * np.pi * 7.0 * time + phase) for phase in (0.0, 2.5))
    shaft = moved(0.05 * np.sin(2.0 * time), 0.005)
    curve = np.tanh(shaft.velocity_m_s / 0.01)
    terms = [f"periodic_disturbance:frequency=7.0,part={part}" for part in (0, 1)]
    config = Config.from_mapping({"extension.terms": terms, **UNITS, "model.type": "hammerstein", "force_unit": 1.0})
    learned = replay(replace(shaft, friction_N=curve + wave), config, extension=extension_from_config(config))
    assert np.std(learned.residual_N[2000:]) < 0.1 * np.std(wave)
    judged = learned.judge("other", replace(shaft, friction_N=curve + other), extension_from_config(config))
    error = judged.samples.friction_N - judged.predicted_N
    assert np.std(error[100:]) == pytest.approx(np.std(other), rel=0.05)


def test_ends_in_the_wrong_order_are_refused_and_text_reads_back() -> None:
    with pytest.raises(ConfigError, match="from is not above to"):
        parse_term("position_dependence:wavelength=0.004,from=2,to=1")
    spec = parse_term("position_dependence:wavelength=0.004,part=1,scale=2.0,from=-0.5,to=1.0")
    assert spec.measured == (-0.5, 1.0)
    assert parse_term(spec.text) == spec
    assert parse_term("inertia:part=0").measured is None


@pytest.fixture(scope="module")
def ripple() -> Diagnosis:
    return diagnose([record(["position_dependence:size=0.04,wavelength=0.004"])], Config())


def test_the_terms_carry_what_was_measured_and_the_temperature(ripple: Diagnosis) -> None:
    assert is_offered(ripple)
    config = extended_config(ripple)
    position = ripple.record.features.position_m
    for text in config.extension.terms:
        assert parse_term(text).measured == (position.min(), position.max())
    assert config.theory.default_temperature == pytest.approx(ripple.record.features.temperature_degC.mean())


def test_the_range_is_that_of_the_velocity_as_repaired(ripple: Diagnosis) -> None:
    """A velocity reported too fast by two is repaired before it gives the model its range."""
    raw = replace(ripple.raw, features=replace(ripple.raw.features, velocity_m_s=ripple.raw.features.velocity_m_s * 2))
    config = extended_config(replace(ripple, raw=raw))
    top = float(np.abs(ripple.record.features.velocity_m_s).max())
    assert config.reach[1] == pytest.approx(1.05 * top)


@pytest.mark.parametrize(
    ("plant", "hidden", "rate_hz", "segments", "worse"),
    [
        # Directions that differ by another share at each speed: the shapes are spread over the speeds that were fitted.
        ("tabulated", (), 200.0, (segment(1.0, 50.0, 8.0), segment(4.0, 50.0, 12.0)), 1.1),
        # On a film that lags: the force that runs has the film in it, the theory's own memory stands behind it, and a
        # difference of the film's turns with it.
        ("film_lag", (UNLIKE,), 1000.0, FAST, 1.25),
        ("rig", (), 1000.0, FAST, 2.0),
    ],
)
def test_frozen_it_predicts_as_well_as_the_fit(plant, hidden, rate_hz, segments, worse) -> None:
    other = (segment(0.7, 120.0, 3.0), segment(1.5, 120.0, 6.0)) if segments is FAST else (segment(2.0, 50.0, 12.0),)
    effects = tuple(parse_effect(e) for e in hidden)
    learned, judged = (simulate(Scenario(s, plant, rate_hz, 0.01, 3, effects)).samples for s in (segments, other))
    traits = ("direction_asymmetry", "frictional_lag", "pressure_dependence")
    found = diagnose([learned], Config.from_mapping(SEAL), catalogue=chosen(*traits))
    assert found.total_gain is not None
    frozen = extended_config(found).updated({"model.adapt": False})
    for samples in (learned, judged):
        figures = replay(samples, frozen, extension=extension_from_config(frozen)).figures()
        assert figures["nrmse"] < worse * found.total_gain.nrmse_after


SLOW = tuple(segment(t, psi, s) for psi in (50.0, 200.0) for t, s in ((1.0, 4.0), (3.0, 6.0)))
LONGER = tuple(segment(t, psi, s) for psi in (50.0, 200.0) for t, s in ((1.0, 6.0), (3.0, 9.0)))
"""For a film that lags beside a delay: in less of it the fit and what runs are twice as far apart as they may be."""


@pytest.mark.parametrize(
    ("plant", "theory", "hidden"),
    [
        # The theory has a memory of its own here: it is late with the rest, and runs in the force that others are of.
        ("parallel_memory", "seal", ("time_delay:delay=0.004", "inertia:mass=1")),
        ("parallel_memory", "seal", ("sensor_lowpass:time_constant=0.01", "direction_asymmetry:asymmetry=0.1")),
        ("parallel_memory", "seal", ("velocity_delay:delay=0.004", "side_spring:stiffness=10")),
        ("parallel_memory", "seal", ("backlash:gap=2e-5",)),
        # Two of one stage that are made from the force: the second one has the first in it.
        ("parallel_memory", "seal", ("gain_step:step=0.15,at=13", "backlash:gap=4e-5")),
        ("film_lag", "seal", ("time_delay:delay=0.006", "direction_asymmetry:asymmetry=0.1")),
        ("maxwell_slip", "seal", ("viscosity_drift:drop=0.3,time_constant=10",)),
        # A theory that does not say what of it is a film's: its own share of the force is another one than the whole.
        ("parallel_memory", "stribeck", ("gain_step:step=0.15,at=13",)),
        ("clean", "stribeck", ("frictional_lag:lag=0.01",)),
    ],
)
def test_frozen_it_is_the_fit(plant: str, theory: str, hidden: tuple[str, ...]) -> None:
    frozen_is_the_fit(LONGER if plant == "film_lag" else SLOW, plant, theory, hidden)


@pytest.mark.parametrize(("plant", "hidden"), [("maxwell_slip", ("direction_asymmetry:size=0.04",)), ("film_lag", ())])
def test_frozen_it_is_the_fit_where_the_theory_is_smooth_over_a_tenth_of_the_speeds(plant, hidden) -> None:
    """Its share of the level stands behind its own sign, which is wider than the one taken for a slow drive."""
    slower = tuple(segment(8.0, psi, 24.0, "speed_steps") for psi in (60.0, 200.0))
    frozen_is_the_fit(slower, plant, "seal", hidden)


def frozen_is_the_fit(drive: tuple[Segment, ...], plant: str, theory: str, hidden: tuple[str, ...]) -> None:
    effects = tuple(parse_effect(e) for e in hidden)
    samples = simulate(Scenario(drive, plant, 200.0, 0.01, 3, effects)).samples
    names = {e.name for e in effects} | set(PLANTS[plant].traits)  # of others none was named beside these
    given = Config.from_mapping({"theory.kind": theory})
    found = diagnose([samples], given, catalogue=chosen(*names))
    assert {e.name for e in effects} <= {cause.name for cause in found.effects}
    frozen = extended_config(found).updated({"model.adapt": False})
    predicted = replay(samples, frozen, extension=extension_from_config(frozen)).predicted_N
    fitted = samples.friction_N - found.models[-1].residual_N
    apart = np.sqrt(np.mean(np.square(predicted - fitted)[found.record.used]))
    assert apart < 0.002 * np.std(samples.friction_N)


def test_a_model_that_does_not_gain_on_held_out_data_is_not_offered(ripple: Diagnosis) -> None:
    assert ripple.total_gain is not None
    poor = replace(ripple.total_gain, low_percent=-0.5)
    assert not is_offered(replace(ripple, total_gain=poor))


def two_drives(folder: Path, *effects: str) -> dict[str, str]:
    """Record one drive to learn on and another one to judge on, of a plant with these effects; return their paths."""
    schedules = {"learned": "1:50:6,5:50:10,1:200:6,5:200:10,1:50:6,5:50:10", "other": "3:120:9,1.5:80:6:triangle"}
    bags = {name: str(folder / name) for name in schedules}
    hidden = [word for effect in effects for word in ("--effect", effect)]
    for seed, (name, schedule) in enumerate(schedules.items()):
        made = ["simulate", "--out", bags[name], "--plant", "clean", "--rate", "200", "--seed", str(seed)]
        assert main([*made, "--schedule", schedule, *hidden]) == 0
    return bags


@pytest.mark.usefixtures("blank_drawings")
def test_on_another_recording_the_error_falls(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rosbags")
    bags = two_drives(tmp_path, "inertia:size=0.04")
    out = tmp_path / "out"
    capsys.readouterr()
    assert main(["diagnose", bags["learned"], "--out", str(out)]) == 0
    said = capsys.readouterr().out
    page = (out / "report.html").read_text()
    assert "On samples that the fit never saw the error falls from" in page
    errors = []
    for more in ([], ["--config", str(out / "extended.yaml")]):
        words = ["replay", bags["learned"], "--test", "OTHER", *more]
        assert " ".join(["friction_estimator", *words]) in said
        assert " ".join(words) in page
        words[words.index("OTHER")] = bags["other"]
        assert main([*words, "--json", str(tmp_path / "judged.json")]) == 0
        errors.append(json.loads((tmp_path / "judged.json").read_text())["test"][0]["nrmse"])
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 0.025
    # The same file plays the plant, its terms with it: a replay that learns nothing predicts what it made.
    extended, base, played = out / "extended.yaml", tmp_path / "base.yaml", str(tmp_path / "played")
    write_config(base, read_config(extended).updated({"extension.terms": (), "learned.extension_weights": ()}))
    made = ["simulate", "--out", played, "--rate", "200", "--noise", "0", "--schedule", "3:80:9"]
    assert main([*made, "--config", str(extended)]) == 0
    for config, low, high in ((extended, 0.0, 1e-6), (base, 0.005, 0.1)):
        words = ["replay", played, "--config", str(config), "--freeze-after", "0", "--json", str(tmp_path / "r.json")]
        assert main(words) == 0
        assert low <= json.loads((tmp_path / "r.json").read_text())["nrmse"] < high


@pytest.mark.usefixtures("blank_drawings")
def test_a_velocity_of_another_scale_is_put_right_in_the_extended_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its curve is that of the repaired velocity, and the reported one is what comes in elsewhere too."""
    pytest.importorskip("rosbags")
    bags = two_drives(tmp_path, "position_dependence:amplitude=0.4,wavelength=0.004", "velocity_mismatch:gain=-0.4")
    assert main(["diagnose", bags["learned"], "--out", str(tmp_path / "out"), "--figures", "svg"]) == 0
    extended = read_config(tmp_path / "out" / "extended.yaml")
    assert extended.input.velocity_gain == pytest.approx(0.6, rel=1e-3)
    # As it was written, before it has learned a sample.
    frozen = tmp_path / "frozen.yaml"
    write_config(frozen, extended.updated({"model.adapt": False}))
    capsys.readouterr()
    words = ["replay", bags["learned"], "--test", bags["other"], "--config", str(frozen), "--json", "-"]
    assert main(words) == 0
    result = json.loads(capsys.readouterr().out)
    assert max(result["nrmse"], result["test"][0]["nrmse"]) < 0.015
