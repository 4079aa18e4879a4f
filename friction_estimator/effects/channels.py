"""Faults of the channels beside the force: position, velocity, pressure."""

from dataclasses import replace

import numpy as np

from friction_estimator.core.intake.encoder import Encoder, wraps_undone
from friction_estimator.core.quantities import POSITION, VELOCITY, quantity
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.effects.base import Effect, Key, Words, effect, form_key
from friction_estimator.effects.detection import COMPLETELY, DIVIDED, SMOOTHED, DataView, Fault
from friction_estimator.effects.scatter import MAD, held_levels, noise_under, smoothed, unrepeated_N2
from friction_estimator.effects.trace import Trace

LEAST_SHARE = 0.004
"""Of the power of what does not repeat in the error: noise of a channel that makes less of it is not worth a name."""

MISMATCH = 0.02
"""Relative difference of velocity and position's derivative that counts: what scale factors of encoders differ by."""

CYCLE_SHARE = 0.05
"""Of the shortest period: the time over which a slope of displacement over integrated velocity is taken."""

WITHOUT_PERIOD_S = 0.1
FEWEST_SPANS = 20

WITHIN = 1e-3
"""Relative: how well the jumps tell the span of an encoder."""

BELIEVED = 0.25
"""Of the span: by so much the shaft may have moved between two samples for the velocity to tell how far."""

NOISE_SHARE = 0.3
"""Of the rms velocity: a channel that scatters by more shows no velocity, and is no noisy one."""


@effect
class WrappedPosition(Effect):
    """An encoder that shows the position modulo its span.

    Formula::

        x_shown = (x - zero + modulus / 2) mod modulus - modulus / 2
    """

    name = "wrapped_position"
    family = "data"
    stage = "sensor"
    channel = "position"
    detects_at = "motion"
    figure = "wraps"
    keys = (
        Key("modulus", "m", 0.03, 1e-12, 1e9, "span of the encoder, at whose end it goes on at the other"),
        Key("zero", "m", 0.0, -1e9, 1e9, "position at which it shows 0"),
    )
    size_key = ""
    reveals = "position_m"
    words = Words(
        "the encoder of the position wraps: at the end of its span it goes on at the other end",
        "the position jumps by its span while the velocity says that the shaft moved on",
        {},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Show the position modulo the span, from minus a half of it to a half."""
        span = self["modulus"]
        shown = np.mod(trace.position_measured_m - self["zero"] + 0.5 * span, span) - 0.5 * span
        return replace(trace, position_measured_m=shown)

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Take the span from what the intake has unwrapped, or from the jumps; with it every turn is known.

        The intake sees no future: it learns the span from the first jumps, and so may have passed over them.
        """
        position, shift = view.samples.position_m, view.samples.position_shift_m
        if position is None:
            return None
        wraps, shown = wraps_undone(view.samples), position if shift is None else position - np.nan_to_num(shift)
        if not wraps.count:
            encoder = Encoder()
            encoder.push(view.samples.stamp_ns, view.samples.velocity_m_s, view.restart, shown.copy())
            wraps = encoder.wraps
        if not wraps.count:
            return None
        span = wraps.modulus_m
        return Fault(
            cls.name,
            f"the position jumped by {quantity(span, POSITION)} while the shaft moved on",
            {"modulus": (span, "m", span * (1.0 - WITHIN), span * (1.0 + WITHIN))},
            COMPLETELY,
            position_m=_unwrapped(shown, view, span),
        )


def _unwrapped(shown: Floats, view: DataView, span: float) -> Floats:
    """Return the position with the turns of an encoder of known span added, (n,); recordings keep their origins."""
    out = shown.copy()
    f = view.features
    travelled = np.cumsum(0.5 * (f.previous_m_s + f.velocity_m_s) * f.step_s)
    for number in np.unique(view.recording):
        mine = np.flatnonzero((view.recording == number) & np.isfinite(shown))
        expected = np.diff(travelled[mine])
        # Over a gap the shaft may have gone anywhere: the nearest turn is taken.
        expected = np.where(np.abs(expected) < BELIEVED * span, expected, 0.0)
        turns = np.round((np.diff(shown[mine]) - expected) / span)
        out[mine[1:]] -= span * np.cumsum(turns)
    return out


@effect
class VelocityMismatch(Effect):
    """A reported velocity that is not the derivative of the position.

    Formula::

        v_shown = (1 + gain) v
    """

    name = "velocity_mismatch"
    family = "data"
    stage = "sensor"
    detects_at = "motion"
    figure = "velocity"
    channel = "position"
    keys = (Key("gain", "", 0.03, -0.9, 10.0, "relative error of the reported velocity"),)
    size_key = "gain"
    linear = False
    reveals = "velocity_m_s"
    words = Words(
        "the reported velocity is not the derivative of the reported position",
        "velocity against the difference quotient of position has a slope other than one",
        {},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Scale the measured velocity."""
        return replace(trace, velocity_measured_m_s=trace.velocity_measured_m_s * (1.0 + self["gain"]))

    def change(self, before: Trace, after: Trace) -> Floats:
        """Return the error of the friction that belongs to the measured velocity."""
        return seen_at(after, after.velocity_measured_m_s) - seen_at(before, before.velocity_measured_m_s)

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Compare displacement and integrated velocity over short spans: the median slope, weighted by the way.

        A wrapped or re-zeroed encoder, or a stretch at rest, spoils the spans that it lies in, and no more.
        """
        position, f, context = view.samples.position_m, view.features, view.context
        if position is None or "position" not in context.channels:
            return None
        usual = CYCLE_SHARE * min(context.periods_s) if context.periods_s else WITHOUT_PERIOD_S
        span = max(4, round(usual / context.step_s))
        travelled = np.cumsum(0.5 * (f.previous_m_s + f.velocity_m_s) * f.step_s)
        gap = np.cumsum(view.restart)
        a = np.arange(0, len(travelled) - span, span)
        whole = (gap[a] == gap[a + span]) & np.isfinite(position[a]) & np.isfinite(position[a + span])
        moved = (position[a + span] - position[a])[whole]
        integrated = (travelled[a + span] - travelled[a])[whole]
        # Spans on which little was moved say little, and a jump of the encoder says nothing.
        far = np.abs(integrated) > 0.2 * float(np.quantile(np.abs(integrated), 0.9)) if integrated.size else whole[:0]
        moved, integrated = moved[far], integrated[far]
        if moved.size < FEWEST_SPANS or np.median(np.abs(moved)) == 0.0:
            return None
        inverse = moved / integrated
        weight = np.abs(integrated)
        middle = _weighted_median(inverse, weight)
        spread = MAD * _weighted_median(np.abs(inverse - middle), weight)
        # 1.25 is the deviation of a median over that of a mean, for Gaussian values.
        error = 1.25 * spread * float(np.sqrt(np.square(weight).sum()) / weight.sum())
        if middle <= 0.0:
            return None
        slope, deviation = 1.0 / middle, error / middle**2
        if abs(slope - 1.0) < max(MISMATCH, 5.0 * deviation) or spread > 0.5 * middle:
            return None
        reach = 2.0 * deviation + 2e-4
        gain = slope - 1.0
        return Fault(
            cls.name,
            f"the reported velocity is {slope:.4f} times the derivative of the reported position",
            {"gain": (gain, "", gain - reach, gain + reach)},
            DIVIDED,
            velocity_m_s=f.velocity_m_s / slope,
        )

    @classmethod
    def repairing_settings(cls, fault: Fault, config: Config) -> dict[str, object]:
        """Return the gain by which the intake divides."""
        return {"input.velocity_gain": config.input.velocity_gain * (1.0 + fault.parameters["gain"][0])}


def _weighted_median(values: Floats, weight: Floats) -> float:
    order = np.argsort(values)
    share = np.cumsum(weight[order])
    return float(values[order][int(np.searchsorted(share, 0.5 * share[-1]))])


@effect
class VelocityNoise(Effect):
    """Noise on the velocity channel.

    Formula::

        v_shown = v + deviation w,    w white, of unit variance
    """

    name = "velocity_noise"
    family = "velocity"
    stage = "sensor"
    scatters = True
    detects_at = "residual"
    figure = "smoothed velocity"
    keys = (
        Key("deviation", "m/s", 1e-3, 0.0, 1e3, "standard deviation of the noise on the velocity channel"),
        form_key("correlated from sample to sample (moving average of two)"),
    )
    size_key = "deviation"
    linear = False
    reveals = "velocity_m_s"
    words = Words(
        "the velocity channel is noisy",
        "residual variance grows with the slope of the curve, dF/dv; slopes are fitted too flat",
        {"stick_slip": "third difference of the velocity: it is white where the channel is noisy"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Add noise to the measured velocity; the force stays."""
        noise = _noise(trace.time_s.size, self["form"], rng)
        return replace(trace, velocity_measured_m_s=trace.velocity_measured_m_s + self["deviation"] * noise)

    def change(self, before: Trace, after: Trace) -> Floats:
        """Return the error of the friction that belongs to the measured velocity."""
        return seen_at(after, after.velocity_measured_m_s) - seen_at(before, before.velocity_measured_m_s)

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Compare the noise under the velocity, through dF/dv, with what does not repeat of the base model's error."""
        v = view.features.velocity_m_s
        found = noise_under(v, view.restart)
        if found is None or view.force_slope is None or view.residual_N is None:
            return None
        deviation, low, high = found
        if deviation > NOISE_SHARE * float(np.sqrt(np.mean(np.square(v)))):
            return None
        power = deviation**2 * float(np.mean(np.square(view.force_slope[view.used])))
        if power < LEAST_SHARE * unrepeated_N2(view):
            return None
        return Fault(
            cls.name,
            f"the velocity scatters by {quantity(deviation, VELOCITY, '.3g')} from sample to sample",
            {"deviation": (deviation, "m/s", low, high)},
            SMOOTHED,
            velocity_m_s=smoothed(v, view.restart, deviation),
            scatter_m_s=deviation,
            power_N2=power,
        )


@effect
class PressureNoise(Effect):
    """Noise on the pressure channel.

    Formula::

        p_shown = p + deviation w,    w white, of unit variance
    """

    name = "pressure_noise"
    family = "pressure_channel"
    stage = "sensor"
    scatters = True
    detects_at = "residual"
    figure = "smoothed pressure"
    channel = "pressure"
    keys = (
        Key("deviation", "Pa", 1e4, 0.0, 1e9, "standard deviation of the noise on the pressure channel"),
        form_key("correlated from sample to sample (moving average of two)"),
    )
    size_key = "deviation"
    linear = False
    reveals = "pressure_Pa"
    words = Words(
        "the pressure channel is noisy",
        "the pressure scatters from sample to sample, and the residual with it; dependences on it are fitted too weak",
        {"pressure_dependence": "hold the pressure: a noisy channel scatters about it, friction does not follow"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Add noise to the pressure that is recorded: the friction law was evaluated before."""
        noise = _noise(trace.time_s.size, self["form"], rng)
        return replace(trace, pressure_Pa=trace.pressure_Pa + self["deviation"] * noise)

    def change(self, before: Trace, after: Trace) -> Floats:
        """Return the error of the friction that belongs to the measured pressure."""
        return after.law(after) - before.law(before)

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Compare the noise under the pressure, through dF/dp, with what does not repeat of the base model's error."""
        pressure = view.samples.pressure_Pa
        if pressure is None or "pressure" not in view.context.channels:
            return None
        found = noise_under(pressure, view.restart)
        if found is None or view.pressure_slope is None or view.residual_N is None:
            return None
        deviation, low, high = found
        power = deviation**2 * float(np.mean(np.square(view.pressure_slope[view.used])))
        if power < LEAST_SHARE * unrepeated_N2(view):
            return None
        return Fault(
            cls.name,
            f"the pressure scatters by {deviation:.3g} Pa from sample to sample",
            {"deviation": (deviation, "Pa", low, high)},
            SMOOTHED,
            pressure_Pa=held_levels(pressure, view.restart, deviation),
            power_N2=power,
        )


def _noise(n: int, form: float, rng: np.random.Generator) -> Floats:
    """Return unit noise, (n,): white, or a moving average of two."""
    noise = rng.standard_normal(n + 1)
    return np.asarray((noise[1:] + noise[:-1]) / np.sqrt(2.0) if form >= 0.5 else noise[1:])


def seen_at(trace: Trace, velocity_m_s: Floats) -> Floats:
    """Return the friction that the plant would have at another velocity."""
    moved = replace(trace, velocity_m_s=velocity_m_s, film_speed_m_s=np.abs(velocity_m_s))
    return trace.law(moved)
