"""Lines of a residual: over recorded time, where a pause is no time, and over the position."""

import numpy as np
import pytest
from scipy.signal import lfilter

from friction_estimator.effects.spectrum import ripple_wavelengths, spectral_lines

STEP_S = 0.005
PERIOD_S = 2.5077


def coloured(seed: int, pole: float = 0.8) -> np.ndarray:
    return np.asarray(lfilter([1.0], [1.0, -pole], np.random.default_rng(seed).standard_normal(20_000)))


def times(pauses: bool) -> np.ndarray:
    """Recorded times of 20,000 samples, in one piece or with pauses of 30 and 45 s."""
    time = np.arange(20_000) * STEP_S
    if pauses:
        time[5_000:] += 30.0
        time[11_000:] += 45.0
    return time


@pytest.mark.parametrize("pauses", [False, True])
def test_a_line_stands_out_of_coloured_noise_whatever_the_pauses(pauses: bool) -> None:
    time, noise = times(pauses), coloured(8)
    assert spectral_lines(noise, time, STEP_S) == []
    found = spectral_lines(noise + 0.4 * np.sin(2 * np.pi * 13.7 * time), time, STEP_S)
    assert len(found) == 1
    assert found[0] == pytest.approx(13.7, abs=1e-3)


def test_missing_samples_move_no_line() -> None:
    keep = np.random.default_rng(1).random(20_000) > 0.05
    time = times(False)[keep]
    found = spectral_lines(coloured(8)[keep] + 0.5 * np.sin(2 * np.pi * 13.7 * time), time, STEP_S)
    assert found[0] == pytest.approx(13.7, abs=1e-3)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_first_harmonics_of_the_drive_are_the_drives(order: int) -> None:
    time = times(False)
    wave = np.sin(2 * np.pi * order / PERIOD_S * time)
    assert spectral_lines(coloured(8) + wave, time, STEP_S, periods_s=(PERIOD_S,)) == []
    assert len(spectral_lines(coloured(8) + wave, time, STEP_S)) == 1


def test_a_comb_is_the_drives_and_a_tooth_alone_is_not() -> None:
    time = times(False)
    speed = np.sin(2 * np.pi * time / PERIOD_S)
    comb = np.sign(speed) * np.exp(-8.0 * np.abs(speed))
    assert spectral_lines(coloured(8) + 4.0 * comb, time, STEP_S)
    assert spectral_lines(coloured(8) + 4.0 * comb, time, STEP_S, periods_s=(PERIOD_S,)) == []
    alone = coloured(8) + 0.4 * np.sin(2 * np.pi * 31 / PERIOD_S * time)
    found = spectral_lines(alone, time, STEP_S, periods_s=(PERIOD_S,))
    assert found == [pytest.approx(31 / PERIOD_S, abs=1e-3)]


@pytest.mark.parametrize("waves", [9.3, 70.2, 160.3, 350.6])
@pytest.mark.parametrize("origin_m", [0.0, 1.13e-3])
def test_a_ripple_is_found_whatever_the_origin_of_each_recording(waves: float, origin_m: float) -> None:
    time = times(False)
    angle = 2 * np.pi * time / PERIOD_S
    position, direction = 0.02 * np.cos(angle), np.sign(-np.sin(angle))
    recording = np.repeat([0, 1], 10_000)
    ripple = 0.5 * np.cos(2 * np.pi * waves * position / 0.04)
    shown = position + origin_m * recording
    (found,) = ripple_wavelengths(coloured(8) + ripple, shown, direction, recording)
    assert found == pytest.approx(0.04 / waves, rel=0.5 / waves)
    assert ripple_wavelengths(coloured(9), shown, direction, recording) == []
