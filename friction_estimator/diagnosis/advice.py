"""What to do about what no named cause explains."""

from friction_estimator.diagnosis.remainder import Remainder
from friction_estimator.diagnosis.result import UNEXPLAINED, Diagnosis

LOOK_AT = {
    "velocity_m_s": "it follows the velocity: `friction_estimator identify` fits a freer curve; compare its error, and "
    "record slow strokes, where most of a curve's shape is",
    "acceleration_m_s2": "it follows the acceleration: look for a mass behind the {force} sensor, and for clocks of "
    "velocity and {force} that differ",
    "position_m": "it follows the position: look along the stroke for what touches, bends or changes there (guide, "
    "cable, seat of the seal), and record slow strokes at two speeds",
    "since_reversal_m": "it follows the distance since the last reversal: something bends or settles after each turn; "
    "record strokes of two lengths, at two speeds each",
    "since_reversal_s": "it follows the time since the last reversal: something settles after each turn; record pauses "
    "of different lengths at the ends, and strokes at two speeds",
    "time_s": "it changes with time: write down what else changed (warm-up, load, supply), and record the same drive "
    "again later: a cause comes back, an event does not",
    "distance_m": "it changes with the distance run: record once more after a pause; what begins anew is warmth, what "
    "goes on is wear or running-in",
    "pressure_Pa": "it follows the pressure: record several constant pressures in mixed order, and give this seal's "
    "own curve as theory.table",
    "force_N": "it follows the {force} itself: check the sensor's scale and its linearity with known loads",
    "frequency": "it runs at a frequency of its own: look for a pump, fan, gear or control loop that does, and record "
    "with each switched off in turn",
}
"""Variable of a `Remainder` -> where its cause may be looked for; for `Quantities.worded`."""

SCATTER = (
    "the noise is not alike everywhere: look at the sensor's mounting, cable and range where it is large, before the "
    "model"
)

TELLING = ("position", "pressure", "temperature")
"""Channels that tell causes apart, and can be recorded."""


def on_remainder(remainder: Remainder) -> str:
    """Return where to look for the cause of a remainder, for `Quantities.worded`."""
    return SCATTER if remainder.kind == "variance" else LOOK_AT[remainder.variable]


def on_unexplained(result: Diagnosis) -> list[str]:
    """Return what to do about what is left without a name, for `Quantities.worded`; nothing where nothing is."""
    out = [] if result.remainder is None else [on_remainder(result.remainder)]
    if result.verdict != UNEXPLAINED:
        return out
    asked = {channel for _, channel in result.needs_channel}
    missing = [name for name in TELLING if name not in result.excitation.channels and name not in asked]
    if missing:
        what = "it is named only where it is" if len(missing) == 1 else "one of them is named only where that is"
        out.append(f"record {' and '.join(missing)}, too: a cause that follows {what} recorded")
    return [*out, "record the same drive a second time: what comes back is the machine, what does not is a disturbance"]
