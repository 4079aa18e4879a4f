"""The zero-phase derivative, and samples at another rate: right inside a stretch, blind across a gap."""

import numpy as np
import pytest
from test_tracking import DRIVES, counted, drive, relative_error, stamps

from friction_estimator.bag.resample import PASS, STOP, resampled
from friction_estimator.core.errors import InputError
from friction_estimator.core.intake.derivative import HALF_WIDTHS, derivative, kernel
from friction_estimator.core.intake.tracking import Tracker
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.core.settings.config import Config

BEGIN = np.array([True])


def beginning(n):
    return np.arange(n) == 0


@pytest.mark.parametrize("half_width", HALF_WIDTHS)
def test_a_cubic_has_its_own_slope(half_width):
    k = np.arange(-half_width, half_width + 1) / half_width
    np.testing.assert_allclose(kernel(half_width) @ (2.0 + 3.0 * k - k**2 + 0.5 * k**3), 3.0 / half_width, rtol=1e-9)


@pytest.mark.parametrize(("schedule", "rate_hz", "counts", "most"), DRIVES)
def test_the_future_makes_it_better_than_the_tracking_filter(schedule, rate_hz, counts, most):
    samples = drive(schedule, rate_hz, seed=31)
    shown = counted(samples.position_m, counts)
    found = derivative(samples.stamp_ns, shown, beginning(len(samples)))
    error = relative_error(found, samples.velocity_m_s, after=0)
    assert error < 0.7 * most
    assert error < relative_error(Tracker().push(samples.stamp_ns, shown), samples.velocity_m_s)


def test_friction_is_predicted_as_well_as_with_the_true_velocity():
    samples = drive("1:50:60", seed=32)
    shown = counted(samples.position_m, 4096)
    made = Samples(
        samples.stamp_ns,
        derivative(samples.stamp_ns, shown, samples.restart),
        samples.friction_N,
        samples.restart,
        samples.pressure_Pa,
        samples.temperature_degC,
    )
    true, found = (replay(each, Config()).figures()["nrmse_final"] for each in (samples, made))
    assert found < 1.3 * true


def test_it_has_no_delay_and_no_memory_across_a_gap():
    time = np.arange(4000) / 1000.0
    late = time + np.where(time >= 2.0, 3.0, 0.0)
    shown = np.where(time >= 2.0, 5.0 - 0.7 * time, 0.3 * time)
    found = derivative(stamps(late), shown, beginning(4000))
    np.testing.assert_allclose(found, np.where(time >= 2.0, -0.7, 0.3), rtol=1e-6)
    marked = derivative(stamps(time), shown, beginning(4000) | (np.arange(4000) == 2000))
    np.testing.assert_allclose(marked, np.where(time >= 2.0, -0.7, 0.3), rtol=1e-6)


def test_missing_values_have_no_derivative_and_disturb_no_other():
    samples = drive("1:50:10", seed=33)
    shown = counted(samples.position_m, 4096)
    lost = np.random.default_rng(4).random(shown.size) < 0.1
    found = derivative(samples.stamp_ns, np.where(lost, np.nan, shown), beginning(shown.size))
    assert np.isnan(found[lost]).all()
    error = np.std((found - samples.velocity_m_s)[~lost]) / np.std(samples.velocity_m_s)
    assert error < 0.01


def test_a_wrapped_encoder_is_unwrapped():
    samples = drive("1:50:10", seed=34)
    shown = counted(samples.position_m, 4096)
    wrapped = np.mod(shown + 0.02, 1300 * 0.04 / 4096)
    found = derivative(samples.stamp_ns, wrapped, beginning(shown.size))
    assert np.std(found - samples.velocity_m_s) < 0.01 * np.std(samples.velocity_m_s)


@pytest.mark.parametrize("values", [[], [1.0], [1.0, 2.0], [np.nan] * 5, [1.0, np.nan, np.nan, 2.0]])
def test_too_few_values_have_none(values):
    stamp = stamps(np.arange(len(values)) / 10.0)
    assert np.isnan(derivative(stamp, np.array(values), beginning(len(values)))).all()


def test_stamps_in_bursts_take_bounded_memory():
    time = np.repeat(np.arange(100) * 1.0, 20) + np.tile(np.arange(20) * 1e-6, 100)
    assert np.isfinite(derivative(stamps(time), 0.3 * time, beginning(time.size))).all()


# Another rate


def sampled(time, frequency, gap_at=None):
    restart = np.arange(time.size) == 0
    if gap_at is not None:
        time = time + np.where(time >= gap_at, 5.0, 0.0)
        restart |= np.diff(time, prepend=time[0]) > 1.0
    wave = np.sin(2 * np.pi * frequency * time)
    return Samples(stamps(time), wave, 2.0 * wave, restart, pressure_Pa=np.where(time < 1.0, np.nan, 1e5 + time))


@pytest.mark.parametrize(("own", "rate"), [(1000.0, 100.0), (1000.0, 333.3), (200.0, 200.0), (200.0, 1000.0)])
def test_what_is_passed_stays_and_what_would_fold_back_goes(own, rate):
    time = np.arange(round(10 * own)) / own
    slow = resampled(sampled(time, 0.2 * PASS * min(own, rate)), rate)
    assert slow.sample_rate_hz == pytest.approx(rate, rel=1e-6)
    expected = np.sin(2 * np.pi * 0.2 * PASS * min(own, rate) * slow.time_s)
    inner = slice(100, -100)
    np.testing.assert_allclose(slow.velocity_m_s[inner], expected[inner], atol=0.02)
    np.testing.assert_allclose(slow.friction_N, 2.0 * slow.velocity_m_s, atol=1e-12)
    if rate < own:
        fast = resampled(sampled(time, 1.02 * STOP * rate), rate)
        assert np.abs(fast.velocity_m_s[inner]).max() < 2e-3


def test_a_gap_stays_a_gap_and_no_sample_lies_in_it():
    made = resampled(sampled(np.arange(2000) / 200.0, 1.0, gap_at=4.0), 50.0)
    step = np.diff(made.stamp_ns) / NS_PER_S
    assert np.flatnonzero(made.restart).size == 2
    assert np.count_nonzero(step > 0.0201) == 1
    assert step.max() == pytest.approx(5.02, abs=0.03)
    assert np.abs(np.sin(2 * np.pi * made.time_s) - made.velocity_m_s).max() < 0.05


@pytest.mark.parametrize("rate", [-1.0, 1e9, float("nan"), float("inf")])
def test_a_rate_that_cannot_be_made_is_refused(rate):
    with pytest.raises(InputError, match="--rate"):
        resampled(sampled(np.arange(100) / 100.0, 1.0), rate)
