"""Sentences: alternatives that a drive cannot exclude in principle, and the experiment that would separate them."""

import numpy as np

from friction_estimator.diagnosis.excitation import pressure_order
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects.base import EFFECTS, SLOW
from friction_estimator.effects.features import Context

ONE_SINE: tuple[frozenset[str], ...] = tuple(
    frozenset(pair)
    for pair in (
        ("inertia", "side_spring"),
        ("viscoelastic_relaxation", "side_spring"),
        ("squeeze_film", "sensor_lowpass"),
        ("sensor_bias", "direction_asymmetry"),
        ("presliding", "sensor_lowpass"),
        ("presliding", "squeeze_film"),
        ("sensor_drift", "bias_step"),
        ("viscosity_drift", "wear"),
    )
)
"""Pairs that one sine at one pressure cannot tell apart in principle, whatever the likelihoods say."""


def one_sine(record: Record, context: Context) -> bool:
    """Return whether the drive is one sine at one pressure: one period, and acceleration proportional to position."""
    f = record.features
    if len(context.periods_s) != 1 or context.pressure_span_Pa > 0.05 * max(abs(context.pressure_mean_Pa), 1.0):
        return False
    x = f.position_m - f.position_m.mean()
    a = f.acceleration_m_s2 - f.acceleration_m_s2.mean()
    together = float(x @ a) / max(float(np.sqrt((x @ x) * (a @ a))), 1e-300)
    return together < -0.995


def structural_rivals(name: str, record: Record, context: Context) -> list[str]:
    """Return effects that the experiment cannot exclude by its design."""
    out: list[str] = []
    if one_sine(record, context):
        for pair in ONE_SINE:
            if name in pair:
                out += sorted(pair - {name})
    # A recorded cause that only changes in one order cannot be told from what changes with time.
    if EFFECTS[name].recorded and pressure_order(record):
        out += [n for n, cls in EFFECTS.items() if cls.acts == SLOW]
    if EFFECTS[name].acts == SLOW and pressure_order(record):
        out += [n for n, cls in EFFECTS.items() if cls.recorded]
    return out


def next_experiment(name: str, rivals: tuple[str, ...]) -> str | None:
    """Return the experiment that separates an effect from its first rival, or None where there is none."""
    for rival in rivals:
        for one, other in ((name, rival), (rival, name)):
            said = EFFECTS[one].words.confused_with.get(other)
            if said:
                return f"{name} or {rival}: {said}"
    if rivals:
        return f"{name} or {rivals[0]}: record two periods, two strokes and two pressures in mixed order"
    return None
