"""What a contact does after a reversal, each time otherwise: stick-slip."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from friction_estimator.effects.base import REVERSAL, Effect, Key, Words, effect, form_key
from friction_estimator.effects.burst import LEFT_OUT, find_burst
from friction_estimator.effects.detection import NOT_REPAIRED, DataView, Fault
from friction_estimator.effects.trace import Trace

LEVEL = 0.01
"""Of the test for bursts."""

LIKELY = 18.0
"""Twice the log likelihood that bursts must bring over even scatter: that of two parameters at a level of 1e-4."""

LEAST_SHARE = 0.002
"""Of the power that is left: smaller bursts are not worth a name."""


@effect
class StickSlip(Effect):
    """A contact that chatters after each reversal, each time with another phase.

    Formula::

        f = F + amplitude sin(2 pi frequency t + phase) exp(-t / decay)

    t is the time since the reversal.
    """

    name = "stick_slip"
    family = "variance"
    stage = "friction"
    acts = REVERSAL
    scatters = True
    detects_at = "variance"
    figure = "scatter"
    keys = (
        Key("amplitude", "N", 1.0, 0.0, 1e6, "amplitude of a burst"),
        Key("frequency", "Hz", 37.0, 0.1, 1e5, "frequency of the burst"),
        Key("decay", "s", 0.06, 1e-4, 100.0, "time over which it decays after the reversal"),
        form_key("saw-tooth instead of sine"),
    )
    size_key = "amplitude"
    reveals = "since_reversal_s"
    turns = True
    # A saw-tooth has 0.82 of the rms of a sine of the same amplitude, and only the rms is measured.
    systematic: ClassVar[Mapping[str, float]] = {"amplitude": 0.2}
    words = Words(
        "stick-slip: the contact chatters after reversals, differently each time",
        "residual variance is high at low speed after reversals and not repeatable from cycle to cycle",
        {
            "velocity_noise": "the variance does not follow (dF/dv)^2; look at the velocity channel's third difference",
            "pressure_noise": "the variance does not follow (dF/dp)^2; look at the pressure channel's third difference",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Add bursts."""
        velocity, step = trace.velocity_m_s, trace.step_s
        sign = np.sign(velocity)
        turns = np.flatnonzero((sign[1:] * sign[:-1] < 0) | ((sign[1:] != 0) & (sign[:-1] == 0))) + 1
        phase = rng.uniform(0.0, 2.0 * np.pi, turns.size)
        force = trace.friction_N.copy()
        reach = int(8.0 * self["decay"] / step) + 1
        for start, begin in zip(turns.tolist(), phase.tolist(), strict=True):
            since = step * np.arange(min(reach, force.size - int(start)))
            angle = 2.0 * np.pi * self["frequency"] * since + begin
            wave = 2.0 * np.mod(angle / (2.0 * np.pi), 1.0) - 1.0 if self["form"] >= 0.5 else np.sin(angle)
            force[start : start + since.size] += self["amplitude"] * wave * np.exp(-since / self["decay"])
        return trace.with_friction(force)

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Test whether what does not repeat from cycle to cycle is larger after reversals."""
        others = {fault.name for fault in view.found}
        if others & set(cls.words.confused_with) or any(fault.conceals for fault in view.found):
            return None
        burst = find_burst(view)
        if burst is None or view.residual_N is None:
            return None
        noise = float(np.mean(np.square(view.residual_N[view.used])))
        named = burst.p_value < LEVEL and burst.likelihood_ratio > LIKELY
        if not named or burst.power_N2 < LEAST_SHARE * noise:
            return None
        a, d = burst.amplitude_N, burst.decay_s
        reach = float(np.hypot(burst.amplitude_reach_N, cls.systematic["amplitude"] * a))
        if reach >= a:  # as of any other cause: what may be nothing has no name
            return None
        if d - burst.decay_reach_s <= LEFT_OUT * view.context.step_s:  # what may be the sampling has none either
            return None
        return Fault(
            cls.name,
            "the residual varies from cycle to cycle, most after reversals",
            {
                "amplitude": (a, "N", a - reach, a + reach),
                "decay": (d, "s", d - burst.decay_reach_s, d + burst.decay_reach_s),
            },
            NOT_REPAIRED,
            p_value=burst.p_value,
            power_N2=burst.power_N2,
        )
