"""The time of the force channel against the velocity channel: late, filtered, or ahead."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import (
    REVERSAL,
    Effect,
    Key,
    Params,
    Smoother,
    Words,
    effect,
    form_key,
)
from friction_estimator.effects.channels import seen_at
from friction_estimator.effects.columns import Columns
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import beyond_time, chosen, times
from friction_estimator.effects.kernels import DELAY_LINE, delayed, force_lag
from friction_estimator.effects.reference import FORCE, THEORY, Reference
from friction_estimator.effects.trace import Trace
from friction_estimator.effects.whole import FirstOrder, StaticTables, shifted, unfiltered

Change = Callable[[Features, Reference, Floats, Sequence[int]], Floats]
"""(features, reference, state, parts of the force) -> what a time changes of their sum, (n,), N."""


def _columns(change: Change, state: int = 0) -> Columns:
    """Return what a time changes of the force, as one column that has the theory's own lags in it."""
    return Columns(
        lambda f, r, s: change(f, r, s, (FORCE,)),
        state=state,
        filtered=True,
        of_theory=lambda f, r, s: change(f, r, s, THEORY),
    )


def _change(velocity_m_s: Floats, features: Features, reference: Reference, parts: Sequence[int]) -> Floats:
    """Return by how much some parts of the force differ at another velocity, (n,), N."""
    there = sum(reference.once(velocity_m_s, features.pressure_Pa, *parts))
    here = sum(reference.part(part, features.velocity_m_s, features.pressure_Pa) for part in parts)
    return np.asarray(there - here)


class Timing(Effect):
    """One time between the force channel and the velocity channel, the value of `size_key`."""

    family = "timing"
    stage = "transmission"
    acts = REVERSAL
    delays = True
    turns = True
    linear = False
    reveals = "since_reversal_s"
    signs = (1,)
    fixed_gain = True

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Times from 0.02 samples to a quarter of the shortest period."""
        return chosen(times(context), cls.size_key)

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """Neither far below a sample nor a good part of a stroke."""
        return beyond_time(cls.size_key.replace("_", " "), params[cls.size_key], context)


@effect
class TimeDelay(Timing):
    """A force channel that is late.

    Formula::

        f(t) = F(t - delay)
    """

    name = "time_delay"
    keys = (Key("delay", "s", 1e-3, 0.0, 1.0, "delay of the {force} behind the velocity"),)
    size_key = "delay"
    systematic: ClassVar[Mapping[str, float]] = {"delay": 0.03}
    words = Words(
        "the {force} is late: delay of the channel, or stamps taken on arrival",
        "a spike after each reversal that lasts as long at every speed of the drive (e ~ df/dt)",
        {
            "sensor_lowpass": "a sharp step: a delay shifts it, a filter rounds it",
            "presliding": "two periods: a delay is the same time, presliding the same distance",
            "frictional_lag": "speed steps without reversal",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Interpolate cubically on the fine grid: a linear one would smear like a filter."""
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 - only the simulation needs it

        when = np.maximum(trace.time_s - self["delay"], trace.time_s[0])
        return trace.with_friction(np.asarray(CubicSpline(trace.time_s, trace.friction_N)(when)))

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return F(t - D) - F(t)."""

        def change(f: Features, r: Reference, s: Floats, parts: Sequence[int]) -> Floats:
            moved = np.empty(f.size)
            delayed(f.step_s, f.velocity_m_s, params["delay"], s, moved)
            return _change(moved, f, r, parts)

        return _columns(change, DELAY_LINE)

    @classmethod
    def whole(cls, params: Params, tables: StaticTables, features: Features) -> Floats:
        """Return the columns at t - D."""
        return tables.delayed(features, params["delay"])

    @classmethod
    def late_s(cls, params: Params) -> float:
        """Everything before it is late by D."""
        return params["delay"]

    @classmethod
    def seen(cls, params: Params, channel: str, values: Floats, features: Features) -> Floats:  # noqa: ARG003
        """Every channel of D earlier."""
        return shifted(values, features, params["delay"])

    @classmethod
    def seen_so_far(
        cls,
        params: Params,
        channel: str,  # noqa: ARG003
        values: Floats,
        features: Features,
        state: Floats,
    ) -> Floats:
        """The same, from a delay line."""
        out = np.empty(features.size)
        delayed(features.step_s, values, params["delay"], state, out)
        return out

    refined = ("delay",)


@effect
class SensorLowpass(Timing):
    """A force channel behind a first-order filter.

    Formula::

        time_constant df/dt = F - f
    """

    name = "sensor_lowpass"
    keys = (
        Key("time_constant", "s", 1e-3, 0.0, 1.0, "time constant of the first-order filter"),
        form_key("two equal poles in series, together of the same delay"),
    )
    size_key = "time_constant"
    systematic: ClassVar[Mapping[str, float]] = {"time_constant": 0.3}
    words = Words(
        "the {force} channel is low-pass filtered",
        "reversals are smeared over the same time at every speed of the drive",
        {
            "time_delay": "a sharp step: a filter rounds it, a delay shifts it",
            "presliding": "two periods: a filter is the same time, presliding the same distance",
            "squeeze_film": "a second period or stroke",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Filter; exact for a force linear between steps."""
        tau, force = self["time_constant"], trace.friction_N
        if tau <= 0.0:
            return trace
        if self["form"] >= 0.5:
            half = 0.5 * tau
            return trace.with_friction(lagged_force(lagged_force(force, trace.step_s, half), trace.step_s, half))
        return trace.with_friction(lagged_force(force, trace.step_s, tau))

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return LP(F) - F, with two equal poles where they are asked for."""
        tau, two = _pole(params)

        def change(f: Features, r: Reference, s: Floats, parts: Sequence[int]) -> Floats:
            out = np.empty(f.size)
            within = r.within(f.previous_m_s, f.velocity_m_s, f.pressure_Pa, *parts)
            force_lag(f.step_s, f.previous_m_s, f.velocity_m_s, within, tau, two, r.bend_m_s, s, out)
            return out

        return _columns(change, 4)

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """Two equal poles, together of the same delay."""
        return [dict(params) | {"poles": 2.0}]

    @classmethod
    def whole(cls, params: Params, tables: StaticTables, features: Features) -> Floats:
        """Return the lagged columns."""
        tau, two = _pole(params)
        return tables.lagged(features, tau, two)

    smooths = True

    @classmethod
    def smoother(cls, params: Params) -> Smoother:
        """Return the lag."""
        tau, two = _pole(params)
        return FirstOrder(tau, two)

    refined = ("time_constant",)


def _pole(params: Params) -> tuple[float, bool]:
    """Return the time constant of a pole, s, and whether there are two."""
    two = params.get("poles", 1.0) >= 2.0
    return params["time_constant"] * (0.5 if two else 1.0), two


def lagged_force(force: Floats, step_s: float, tau: float) -> Floats:
    """Return the first-order lag of a force that is linear between its samples, started in equilibrium."""
    from scipy.signal import lfilter  # noqa: PLC0415 - slow to import, only the simulation needs it

    decay = np.exp(-step_s / tau)
    mean = tau / step_s * (1.0 - decay)
    # y[k] = decay y[k-1] + (mean - decay) f[k-1] + (1 - mean) f[k]
    start = np.array([force[0] - (1.0 - mean) * force[0]])
    return np.asarray(lfilter([1.0 - mean, mean - decay], [1.0, -decay], force, zi=start)[0])


@effect
class VelocityDelay(Timing):
    """A velocity channel that is late: the force is ahead of it.

    Formula::

        v_shown(t) = v(t - delay)
    """

    name = "velocity_delay"
    keys = (
        Key("delay", "s", 1e-3, 0.0, 1.0, "delay of the velocity channel behind the {force}"),
        form_key("a first-order filter of the velocity instead of a delay"),
    )
    size_key = "delay"
    systematic: ClassVar[Mapping[str, float]] = {"delay": 0.03}
    words = Words(
        "the velocity is late: a filter or a delay of its channel, so that the {force} is ahead of it",
        "friction changes its sign before the velocity does, by the same time at every speed of the drive",
        {
            "breakaway": "two periods: a late channel is the same time, a breakaway {force} the same distance",
            "inertia": "a second period: inertia grows with 1/T^2 at every speed, a late velocity shows at reversals",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Show an earlier velocity; the position stays."""
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 - only the simulation needs it

        shown, delay = trace.velocity_measured_m_s, self["delay"]
        if delay <= 0.0:
            return trace
        if self["form"] >= 0.5:
            return replace(trace, velocity_measured_m_s=lagged_force(shown, trace.step_s, delay))
        when = np.maximum(trace.time_s - delay, trace.time_s[0])
        return replace(trace, velocity_measured_m_s=np.asarray(CubicSpline(trace.time_s, shown)(when)))

    def change(self, before: Trace, after: Trace) -> Floats:
        """Return the error of the friction that belongs to the measured velocity."""
        return seen_at(after, after.velocity_measured_m_s) - seen_at(before, before.velocity_measured_m_s)

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return F(v + D a) - F(v): what F(t + D) - F(t) is without looking ahead.

        The velocity is carried on with its acceleration, as a live model must; the fit looks ahead (`whole`). The
        error is (D w)^2 / 2 of the velocity at the angular frequency w. Noise of the velocity enters with 3.6 D / dt of
        its deviation: a noisy channel is smoothed before.
        """

        def change(f: Features, r: Reference, s: Floats, parts: Sequence[int]) -> Floats:  # noqa: ARG001
            return _change(f.velocity_m_s + params["delay"] * f.acceleration_m_s2, f, r, parts)

        return _columns(change)

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """A first-order filter of the velocity, of the same delay at low frequency: it rounds what a delay shifts."""
        return [dict(params) | {"filtered": 1.0}]

    @classmethod
    def whole(cls, params: Params, tables: StaticTables, features: Features) -> Floats:
        """Return the columns at the velocity that was there."""
        return tables.at(cls.seen(params, "velocity_m_s", features.velocity_m_s, features), features.pressure_Pa)

    @classmethod
    def seen(cls, params: Params, channel: str, values: Floats, features: Features) -> Floats:
        """The velocity of t + D, or before its filter; the other channels are not late."""
        if channel != "velocity_m_s":
            return values
        if params.get("filtered", 0.0) >= 0.5:
            return unfiltered(values, features, params["delay"])
        return shifted(values, features, -params["delay"])

    @classmethod
    def seen_so_far(
        cls,
        params: Params,
        channel: str,
        values: Floats,
        features: Features,
        state: Floats,  # noqa: ARG003
    ) -> Floats:
        """The velocity carried on by D with its acceleration; before a filter it is that, too."""
        return values + params["delay"] * features.acceleration_m_s2 if channel == "velocity_m_s" else values

    @classmethod
    def late_s(cls, params: Params) -> float:
        """Everything before it is ahead of its velocity by D."""
        return -params["delay"]

    refined = ("delay",)
