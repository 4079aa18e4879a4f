"""What repeats with time or with the place: lines and ripples."""

from collections.abc import Sequence

import numpy as np

from friction_estimator.core.quantities import POSITION, quantity
from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import Effect, Key, Params, Stated, Words, effect, form_key
from friction_estimator.effects.columns import Columns, SideBySide, amplitudes, per_recording, recordings, several
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import chosen, longest_piece_s
from friction_estimator.effects.kernels import wave_comb, waves
from friction_estimator.effects.reference import Reference
from friction_estimator.effects.spectrum import SLOWEST, ripple_power, ripple_wavelengths, spectral_lines
from friction_estimator.effects.trace import Trace

LEAST_APART = 1.0
"""Waves on the stroke by which a second ripple must differ from the first one: beside it there are its flanks."""

EVEN = 1e-9
"""Share of their distance by which evenly spaced wave numbers may differ from it: rounding."""

MANY_WAVES = 8.0
"""Waves on the stroke from which a ripple is no form of anything else."""

FLANKS = 0.25
"""Of the power of a wave beside a ripple: what one as far on the other side has where both are flanks of a ripple whose
pitch or amplitude varies over the stroke."""


@effect
class PositionDependence(Effect):
    """Friction that depends on the place.

    Formula::

        f = F + amplitude cos(2 pi x / wavelength + phase)
    """

    name = "position_dependence"
    family = "position"
    stage = "friction"
    many = True
    channel = "position"
    keys = (
        Key("amplitude", "N", 0.3, 0.0, 1e6, "amplitude of the ripple"),
        Key("wavelength", "m", 5e-3, 1e-6, 100.0, "its wavelength"),
        Key("phase", "rad", 0.0, -10.0, 10.0, "its phase at position 0"),
        form_key("modulates the friction instead of adding a {force}"),
    )
    size_key = "amplitude"
    reveals = "position_m"
    words = Words(
        "friction depends on the place: scoring, ovality, pitch of a screw",
        "the residual repeats with position, in each direction",
        {"periodic_disturbance": "change the speed or the stroke's centre: a position pattern stays in place"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Add the ripple."""
        wave = np.cos(2.0 * np.pi * trace.position_m / self["wavelength"] + self["phase"])
        if self["form"] >= 0.5:
            rms = float(np.sqrt(np.mean(np.square(trace.friction_N)))) or 1.0
            wave = wave * trace.friction_N / rms
        return trace.with_friction(trace.friction_N + self["amplitude"] * wave)

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Wavelengths between 1/160 and half of the stroke, evenly in wave number, half a wave apart at most."""
        if context.stroke_m <= 0.0:
            return []
        waves = np.concatenate([np.arange(2.0, 10.0, 0.25), np.arange(10.0, 160.0, 0.5)])
        return chosen(context.stroke_m / waves, "wavelength")

    @classmethod
    def peaks(cls, residual_N: Floats, features: Features, context: Context) -> list[dict[str, float]]:  # noqa: ARG003
        """Shorter wavelengths, and those with an origin of their own in each recording, from spectra over the place."""
        found = ripple_wavelengths(residual_N, features.position_m, features.direction, features.recording)
        return [{"wavelength": wavelength} | several(features) for wavelength in found]

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return cos and sin of 2 pi x / L in each direction, for each recording, times |F| where it `modulates`.

        Those of a second wavelength stand beside them.
        """

        modulates = params.get("modulates", 0.0) >= 0.5
        lengths = cls._lengths(params)

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            out = np.empty((len(lengths), f.size, 4))
            for wave, length in zip(out, lengths, strict=True):
                waves(f.position_m, f.direction, length, wave)
            made = out[0] if len(lengths) == 1 else np.concatenate(list(out), axis=1)
            if modulates:
                made *= np.abs(f.force_N)[:, None]
            return per_recording(made, f, params)

        return Columns(compute, 4 * len(lengths) * recordings(params), of_force=modulates)

    @classmethod
    def side_by_side(cls, points: Sequence[Params]) -> Columns | SideBySide:
        """Return the machine for several parameter sets; evenly spaced plain waves are made from one another."""
        waves_m = 1.0 / np.array([params["wavelength"] for params in points])
        apart = np.diff(waves_m)
        if len(points) < 2 or any(len(params) > 1 for params in points) or np.ptp(apart) > EVEN * abs(apart[0]):
            return super().side_by_side(points)
        first, step, size = float(waves_m[0]), float(apart[0]), 4 * len(points)

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            out = np.empty((f.size, size))
            wave_comb(f.position_m, f.direction, first, step, out)
            return out

        return Columns(compute, size)

    @classmethod
    def _lengths(cls, params: Params) -> list[float]:
        """Return the wavelengths of a form, m: one or two."""
        return [params["wavelength"], *(params[name] for name in cls.refined[1:] if name in params)]

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:
        """Amplitude in each direction (at the rms of friction, where it modulates) and wavelength, of each ripple."""
        unit = context.force_rms_N if params.get("modulates", 0.0) >= 0.5 else 1.0
        ways = amplitudes(weights, params, context.held).reshape(-1, 2) * unit
        out = {}
        for which, (forward, backward) in zip(("", "second_"), ways.tolist(), strict=False):
            out[f"{which}amplitude_forward"] = (forward, "N")
            out[f"{which}amplitude_backward"] = (backward, "N")
            out[f"{which}wavelength"] = (params[f"{which}wavelength"], "m")
        return out

    @classmethod
    def unlike(cls, params: Params, context: Context) -> bool:
        """Waves of which a stroke holds many: what the form of a cause lacks has a few."""
        return max(cls._lengths(params)) <= context.stroke_m / MANY_WAVES

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """A wave that the stroke does not hold twice is a spring or a bend of the curve."""
        longest = max(cls._lengths(params))
        if longest > 0.5 * context.stroke_m * (1.0 + 1e-9):
            return f"its wavelength of {quantity(longest, POSITION, '.3g')} is longer than half the stroke"
        return None

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """To the neighbouring wave numbers."""
        wave = context.stroke_m / value
        reach = 0.25 if wave < 10.0 else 0.5
        return (context.stroke_m / (wave + reach), context.stroke_m / max(wave - reach, 1.5))

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """A ripple that modulates the friction instead of adding to it."""
        return [dict(params) | {"modulates": 1.0}]

    @classmethod
    def further(
        cls, params: Params, residual_N: Floats, features: Features, context: Context
    ) -> list[dict[str, float]]:
        """A second ripple, of six waves on the stroke or more: gears and screws have several, not only harmonics.

        One whose pitch or amplitude varies has waves on both sides of it, which are none of their own.
        """
        if "second_wavelength" in params:
            return []
        place = features.position_m, features.direction, features.recording
        first = context.stroke_m / params["wavelength"]
        found = ripple_wavelengths(residual_N, *place)
        apart = [length for length in found if abs(context.stroke_m / length - first) > LEAST_APART]
        if not apart:
            return []
        across = 2.0 * first - context.stroke_m / apart[0]
        mirrored = ripple_power(residual_N, *place, context.stroke_m / across) if across > 1.0 else 0.0
        if mirrored > FLANKS * ripple_power(residual_N, *place, apart[0]):
            return []
        return [dict(params) | {"second_wavelength": apart[0]}]

    signs = (0, 0, 0, 0)
    refined = ("wavelength", "second_wavelength")


@effect
class PeriodicDisturbance(Effect):
    """A wave of a frequency of its own, not locked to the drive.

    Formula::

        f = F + amplitude sin(2 pi frequency t + phase)
    """

    name = "periodic_disturbance"
    family = "periodic"
    stage = "mechanics"
    many = True
    has_phase = True
    keys = (
        Key("amplitude", "N", 0.2, 0.0, 1e6, "amplitude"),
        Key("frequency", "Hz", 13.7, 1e-3, 1e5, "frequency"),
        form_key("with a second harmonic of 40 %"),
    )
    size_key = "amplitude"
    reveals = "time_s"
    words = Words(
        "something else on the rig runs at its own frequency (mains, pump ripple)",
        "a line in the spectrum of the residual that is not locked to the drive",
        {"position_dependence": "change the drive's speed: the line stays, a position pattern moves"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Add the wave at a random phase."""
        angle = 2.0 * np.pi * (self["frequency"] * trace.time_s + rng.random())
        wave = np.sin(angle)
        if self["form"] >= 0.5:
            wave = wave + 0.4 * np.sin(2.0 * angle + 1.0)
        return trace.with_friction(trace.friction_N + self["amplitude"] * wave)

    @classmethod
    def peaks(cls, residual_N: Floats, features: Features, context: Context) -> list[dict[str, float]]:
        """Lines of the residual's spectrum that are no harmonics of the drive."""
        time_s, number = features.time_s, features.recording
        lines = spectral_lines(residual_N, time_s, context.step_s, periods_s=context.periods_s, recording=number)
        return [{"frequency": line} | several(features) for line in lines]

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return cos and sin of 2 pi f t (and of its harmonics), for each recording."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            angle = 2.0 * np.pi * params["frequency"] * f.time_s
            made = [wave(k * angle) for k in range(1, count + 1) for wave in (np.cos, np.sin)]
            return per_recording(np.column_stack(made), f, params)

        count = round(params.get("harmonics", 1.0))
        return Columns(compute, 2 * count * recordings(params))

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """A periodic wave that is no sine: with three harmonics."""
        return [dict(params) | {"harmonics": 3.0}]

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:
        """Amplitude and frequency."""
        held = [(sum(ways),) for ways in context.held]
        return {
            "amplitude": (float(amplitudes(weights, params, held)[0]), "N"),
            "frequency": (params["frequency"], "Hz"),
        }

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """Three cycles in a piece without a gap, and two samples in a cycle."""
        if params["frequency"] * longest_piece_s(context) < SLOWEST:
            return f"fewer than {SLOWEST:.0f} cycles of {params['frequency']:.3g} Hz fit into a piece without a gap"
        if params["frequency"] * context.step_s > 0.5:
            return f"{params['frequency']:.3g} Hz is above half the sample rate"
        return None

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """Half a line's width to each side."""
        return (value - 0.4 / context.duration_s, value + 0.4 / context.duration_s)

    signs = (0, 0)
    refined = ("frequency",)
