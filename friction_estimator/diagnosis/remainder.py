"""What no named cause explains: on which variable it depends, and how much of the excess it is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.quantities import POSITION, quantity
from friction_estimator.core.sample import Floats, Ints
from friction_estimator.diagnosis.causes import LATER_SHARE, Search
from friction_estimator.diagnosis.evidence import Rule, null_maximum
from friction_estimator.diagnosis.floor import Scatter, noise_memory, remainder_columns, variance_dependence
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.screening import FLIPS, LEVEL
from friction_estimator.effects.base import EFFECTS
from friction_estimator.effects.burst import COHERENT, differences, incoherent_share
from friction_estimator.effects.detection import DataView, Fault
from friction_estimator.effects.scatter import local_scale
from friction_estimator.effects.spectrum import ripple_power, ripple_wavelengths, spectral_lines

LEAST_SHARE = 0.003
"""Share of the error power, noise included, that one variable must explain where no cause is named; beside causes it is
`causes.LATER_SHARE`."""

FAR = 4.8
"""Local standard deviations that count as far outside; white Gaussian noise has one in 600,000."""

FEWEST_SPIKES = 6
"""Samples so far outside that are told."""

AS_RIPPLE = 0.5
"""Of what the bins of the best variable explain: from which on a ripple, of a tenth of their coefficients, is told."""

SPECTRUM, PLACE = "frequency", "position_m"

SLOW = ("time_s", "distance_m")


@dataclass(frozen=True)
class Remainder:
    """A dependence that nothing named explains.

    Attributes
    ----------
    variable : field of `Features`, or "frequency". share : of the excess error power. kind : mean or variance.
    words : a sentence. frequency_hz : of the line, where there is one.
    """

    variable: str
    share: float
    kind: str
    words: str
    frequency_hz: float = 0.0


NAMES = {
    "velocity_m_s": "velocity",
    "acceleration_m_s2": "acceleration",
    PLACE: "position",
    "since_reversal_m": "distance since the last reversal",
    "since_reversal_s": "time since the last reversal",
    "time_s": "time",
    "distance_m": "distance run",
    "pressure_Pa": "pressure",
    "force_N": "{force}",
    "frequency": "frequency",
}


def unexplained(
    record: Record,
    joint: Joint,
    found: Search,
    findings: Sequence[Fault],
    view: DataView,
    seed: int,
) -> Remainder | None:
    """Return the strongest dependence that is left, or None; `view` shows what the model leaves.

    Bins of each variable, in each direction of motion, are hypotheses like any other: held-out gain against the
    same bootstrap, family-wise over the variables. Beside a ripple that is named another one is looked for, too: twenty
    bins do not show it.
    """
    evidence = joint.evidence(record, seed)
    groups = remainder_columns(record, joint.features.force_N)
    moments = {name: evidence.moments(columns) for name, columns in groups.items()}
    rules = {name: Rule((0,) * columns.shape[1]) for name, columns in groups.items()}
    null = null_maximum(evidence.flips(FLIPS), [evidence.projected(m) for m in moments.values()], list(rules.values()))
    noise = float(evidence.ee.sum()) / evidence.samples
    gains = {n: float(evidence.cross_validated(m, rules[n]).sum()) for n, m in moments.items()}
    assert view.pairs is not None
    memory = noise_memory(record, joint.residual_N, view.pairs)
    for name in SLOW:
        if name in moments:
            # A block is a stretch of time: left out, nothing is known of its bins. In the sample, less chance's share.
            chance = 2.5 * moments[name].xe.shape[1] * noise * memory
            gains[name] = evidence.fit(moments[name], rules[name]).gain - chance
    explained = sum(c.gain for c in found.causes)
    explained += evidence.samples * sum(f.power_N2 for f in findings)
    total = float(evidence.ee.sum())
    best = max(gains, key=lambda n: gains[n])
    quantile = float(np.quantile(null, 1.0 - LEVEL))
    # The bootstrap keeps what the variable explains: its own share is taken out of the threshold.
    usual = (4.0 * moments[best].xe.shape[1] + 30.0) * noise * (memory if best in SLOW else 1.0)
    least = (LATER_SHARE if found.causes else LEAST_SHARE) * total
    ripple = _ripple(record, joint)
    if ripple is not None and ripple[1] > max(AS_RIPPLE * gains[best], least):
        long = quantity(ripple[0], POSITION, ".3g")
        words = f"another ripple over the position is left, of {long}, which no named cause explains"
        return Remainder(PLACE, ripple[1] / (explained + ripple[1]), "mean", words)
    if gains[best] > max(min(quantile, usual), least):
        share = gains[best] / (explained + gains[best])
        return Remainder(best, share, "mean", _sentence(best, "the mean residual"))
    line = _line(record, joint)
    if line is not None and line[1] > least:
        share = line[1] / (explained + line[1])
        words = f"a line at {line[0]:.4g} Hz is left, which no named cause explains"
        return Remainder(SPECTRUM, share, "mean", words, line[0])
    return None if any(EFFECTS[f.name].scatters for f in findings) else _scatter(record, view, bool(found.causes))


def _scatter(record: Record, view: DataView, beside: bool) -> Remainder | None:
    """Return a scatter that depends on a variable, or spikes, or None.

    Beside a cause what differs between cycles tells it: another form of the cause leaves a mean error that repeats.
    """
    assert view.residual_N is not None
    at: Ints = np.flatnonzero(record.used)
    errors = view.residual_N[at]
    if beside:
        differing = differences(view)
        if differing is None:
            return None
        errors, at = differing
    dependent = variance_dependence(record, errors, at)
    if dependent is not None and (not beside or _differs(dependent, errors, view.residual_N[at])):
        return Remainder(dependent.variable, dependent.share, "variance", _sentence(dependent.variable, "the scatter"))
    every, shown = np.zeros(view.residual_N.size), np.zeros(view.residual_N.size, np.bool_)
    every[at], shown[at] = errors, True
    size = np.abs(errors) / local_scale(record.features, shown, every)[at]
    spikes = int((size > FAR).sum())
    if spikes < FEWEST_SPIKES:
        return None
    words = f"{spikes} samples are far outside the scatter of the rest, at no particular place"
    return Remainder("time_s", 0.0, "variance", words)


def _differs(scatter: Scatter, errors: Floats, residual: Floats) -> bool:
    """Return whether a scatter is what a further cause would have to bring, and most of what is left in its place."""
    return (
        scatter.share > LATER_SHARE and incoherent_share(errors, residual, scatter.inside.astype(np.float64)) > COHERENT
    )


def _sentence(variable: str, what: str) -> str:
    return f"{what} still depends on {NAMES[variable]}, which no named cause explains"


def _ripple(record: Record, joint: Joint) -> tuple[float, float] | None:
    """Return wavelength and gain of another ripple over the position beside a named one, family-wise 0.2 %."""
    if not any(t.effect.reveals == PLACE and t.effect.many for t in joint.terms):
        return None
    f, used = record.features, record.used
    left = joint.residual_N[used]
    way, number = f.direction[used], f.recording[used]
    found = ripple_wavelengths(left, f.position_m[used], way, number, 1)
    if not found:
        return None
    return found[0], ripple_power(left, f.position_m[used], way, number, found[0])


def _line(record: Record, joint: Joint) -> tuple[float, float] | None:
    """Return frequency and gain of a spectral line that stands out of its surroundings, family-wise 0.2 %."""
    f = record.features
    residual = joint.residual_N * record.used
    step = float(np.median(f.step_s[f.step_s > 0.0]))
    lines = spectral_lines(residual, f.time_s, step, 1, periods_s=record.periods_s)
    if not lines:
        return None
    angle = 2.0 * np.pi * lines[0] * f.time_s
    wave = np.column_stack([np.cos(angle), np.sin(angle)])[record.used]
    weights = np.linalg.lstsq(wave, residual[record.used], rcond=None)[0]
    gain = float(np.square(wave @ weights).sum())
    return lines[0], gain
