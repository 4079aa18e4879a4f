"""Several ripples over the position, as gears and screws have them."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_records import abba, chosen, names, record

from friction_estimator.core.quantities import Quantities
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.diagnosis.extend import extended_config
from friction_estimator.diagnosis.summary import sentences

FIRST = "position_dependence:amplitude=0.4,wavelength=0.004"


def with_ripple(samples: Samples, forward_N: float, backward_N: float, wavelength_m: float) -> Samples:
    """Return samples with another ripple, of its own amplitude in each direction."""
    assert samples.position_m is not None
    wave = np.cos(2.0 * np.pi * samples.position_m / wavelength_m + 1.0)
    amplitude = np.where(samples.velocity_m_s > 0.0, forward_N, backward_N)
    return replace(samples, friction_N=samples.friction_N + amplitude * wave)


@pytest.mark.parametrize("plant", ["clean", "film_lag"])
def test_a_second_ripple_is_found_with_the_first(plant: str) -> None:
    """Of half the first one's size, and no harmonic of it; the extended model has both."""
    samples = record([FIRST], plant=plant, segments=abba()[:4])
    two = diagnose([with_ripple(samples, 0.2, 0.1, 0.0057)], Config())
    found = next(e for e in two.effects if e.name == "position_dependence")
    told = {name: (e.low, e.value, e.high) for name, e in found.parameters.items()}
    for name, true in (("wavelength", 0.004), ("second_wavelength", 0.0057)):
        assert told[name][0] < true < told[name][2]
        assert told[name][1] == pytest.approx(true, rel=2e-3)
    for name, true in (
        ("amplitude_forward", 0.4),
        ("second_amplitude_forward", 0.2),
        ("second_amplitude_backward", 0.1),
    ):
        assert told[name][1] == pytest.approx(true, abs=0.02)
    assert "second wavelength 0.0057" in " ".join(sentences(two, Quantities()))
    assert {"periodic_disturbance", "side_spring", "presliding"}.isdisjoint(names(two))
    terms = [t for t in extended_config(two).extension.terms if t.startswith("position_dependence")]
    assert len(terms) == 8
    assert all("second_wavelength=" in t for t in terms)


@pytest.mark.parametrize(("plant", "beside"), [("tabulated", []), ("clean", ["presliding:size=0.04"])])
def test_one_ripple_has_no_second(plant: str, beside: list[str]) -> None:
    found = diagnose([record([FIRST, *beside], plant=plant, segments=abba()[:4])], Config())
    ripple = next(e for e in found.effects if e.name == "position_dependence")
    assert set(ripple.parameters) == {"amplitude_forward", "amplitude_backward", "wavelength"}


def test_a_third_ripple_is_told_as_what_is_left() -> None:
    samples = with_ripple(with_ripple(record([FIRST]), 0.2, 0.2, 0.0057), 0.15, 0.15, 0.0029)
    found = diagnose([samples], Config())
    assert found.remainder is not None
    assert found.remainder.variable == "position_m"
    assert "another ripple over the position is left, of 0.00291 m" in " ".join(sentences(found, Quantities()))


def test_a_ripple_whose_pitch_varies_has_no_second() -> None:
    """Its flanks on both sides are no ripples of their own, and the larger of them has no wavelength that is true."""
    samples = record(segments=abba()[:4])
    assert samples.position_m is not None
    place = samples.position_m
    error_m = 0.00016 * np.cos(2.0 * np.pi * place / np.ptp(place))
    wave = 0.5 * np.cos(2.0 * np.pi * (place + error_m) / 0.004)
    found = diagnose([replace(samples, friction_N=samples.friction_N + wave)], Config())
    ripple = next(e for e in found.effects if e.name == "position_dependence")
    assert set(ripple.parameters) == {"amplitude_forward", "amplitude_backward", "wavelength"}


def test_a_recording_of_a_moment_takes_nothing_off_the_amplitude_of_the_others() -> None:
    """Whose own phase nothing tells; the rms over three recordings would be 0.33 N."""
    samples = record([FIRST], segments=abba()[:4])
    parts = [samples[: len(samples) // 2], samples[700:703], samples[len(samples) // 2 :]]
    found = next(e for e in diagnose(parts, Config()).effects if e.name == "position_dependence")
    for name in ("amplitude_forward", "amplitude_backward"):
        assert found.parameters[name].low < 0.4 < found.parameters[name].high


def test_a_small_ripple_is_no_form_of_a_cause_that_leaves_much_more() -> None:
    """What the rig's own traits leave, which nothing here may name, has no 50 waves on the stroke (decision 0240)."""
    hidden = ["sensor_drift:size=0.9", "position_dependence:size=0.04,wavelength=0.004"]
    some = chosen("sensor_drift", "position_dependence")
    found = diagnose([record(hidden, plant="rig")], Config(), catalogue=some)
    assert names(found) == ["sensor_drift", "position_dependence"]
    assert found.effects[1].parameters["wavelength"].value == pytest.approx(0.004, rel=2e-3)
    assert found.unexplained_percent > 50.0
