"""Coulomb, Stribeck and viscous parameters of a recording, with intervals."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import nnls
from scipy.special import stdtrit

from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.fit.baselines import BASELINES, Shape, StaticCurve, fit_baselines
from friction_estimator.core.quantities import FORCE
from friction_estimator.core.sample import Floats
from friction_estimator.export.learned import Learned

TOO_SIMPLE = 3.0
"""Error over that of the static curve above which Coulomb and viscous friction do not describe the drive."""

BLOCKS = 20
"""Blocks of the jackknife: each is left out once. Fewer leave the interval itself uncertain, more are shorter than a
drive cycle."""


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float


def curve_with_intervals(learned: Learned, form: str) -> tuple[StaticCurve, Mapping[str, Interval]]:
    """Return a textbook's curve fitted to the recording, and its parameters with 95 % intervals.

    The intervals are those of a jackknife over `BLOCKS` contiguous blocks (Künsch 1989): with theta_j fitted without
    block j, s^2 = (m - 1)/m sum_j (theta_j - mean)^2 and theta +- t_{m-1} s. Samples that follow each other may err
    alike: what repeats within a block is in the interval. What the form itself cannot say is not: that is in the error
    that the export states. The coefficients are free of the ridge of `fit_baselines`, which draws directions together.

    Parameters
    ----------
    form : one of `core.fit.baselines.BASELINES`.

    Raises UnanswerableError where the recording is too short, or a direction that has parameters of its own is not
    driven.
    """
    velocity, friction = _motion(learned)
    if BASELINES[form].asymmetric and min(np.sum(velocity > 0.0), np.sum(velocity < 0.0)) < BLOCKS:
        raise UnanswerableError(
            f"{learned.recording_names}: the shaft moves in one direction only, the other has no parameters: "
            "record both, or export a format without directions (urdf, mjcf, csv, c)"
        )
    curve = _fitted(form, velocity, friction)
    edges = np.linspace(0, velocity.size, BLOCKS + 1).astype(int)
    without = []
    for a, b in pairwise(edges):
        rest = np.r_[0:a, b : velocity.size]
        without.append(_fitted(form, velocity[rest], friction[rest]).parameters)
    wide = float(stdtrit(BLOCKS - 1, 0.975))
    intervals = {}
    for name, value in curve.parameters.items():
        values = np.array([parameters[name] for parameters in without])
        half = wide * float(np.sqrt((BLOCKS - 1) * np.mean(np.square(values - values.mean()))))
        intervals[name] = Interval(value, value - half, value + half)
    return curve, intervals


def _fitted(form: str, velocity: Floats, friction: Floats) -> StaticCurve:
    """Return the curve of a form: its shape is that of `fit_baselines`, its coefficients are plain least squares."""
    parameters = dict(fit_baselines(velocity, friction, (form,))[form].parameters)
    kind = BASELINES[form]
    shape = Shape(parameters["width_m_s"])
    if kind.stribeck:
        shape = replace(shape, stribeck=parameters["stribeck_m_s"], exponent=parameters["stribeck_exponent"])
    columns = kind.columns(velocity, shape)
    if kind.asymmetric:
        for way, here in (("pos", velocity >= 0.0), ("neg", velocity < 0.0)):
            found = _least_squares(columns[: len(kind.odd), here], friction[here])
            for name, value in zip(kind.odd, found, strict=True):
                stem, unit = name.split("_", 1)
                parameters[f"{stem}_{way}_{unit}"] = float(value)
    else:
        found = _least_squares(columns, friction)
        parameters |= dict(zip([*kind.odd, "offset_N"], map(float, found), strict=True))
    return StaticCurve(form, parameters)


def _least_squares(columns: Floats, values: Floats) -> Floats:
    """Return the coefficients; columns that the samples do not tell apart share what they explain (least norm)."""
    scale = np.maximum(np.sqrt(np.mean(np.square(columns), axis=1)), np.finfo(float).tiny)
    matrix = columns / scale[:, None]
    return np.asarray(np.linalg.lstsq(matrix @ matrix.T, matrix @ values, rcond=1e-10)[0] / scale)


@dataclass(frozen=True)
class CoulombViscous:
    """f = Fc sign(v) + Fv v: what robot descriptions can say.

    Attributes
    ----------
    coulomb_N, viscous_N_s_m : neither negative.
    offset_N : what the fit took off beside them and the description cannot say.
    error_rms_N : of the two terms alone, over the recording.
    """

    coulomb_N: float
    viscous_N_s_m: float
    offset_N: float
    error_rms_N: float

    def advice(self, learned: Learned) -> list[str]:
        """Return the lines that say where the form is too simple for the drive; none where it is not."""
        static = learned.static_error_rms_N()
        if not self.error_rms_N > TOO_SIMPLE * static:
            return []
        falls = " (friction falls with speed here)" if self.viscous_N_s_m == 0.0 else ""
        errs = learned.quantities.text(static, FORCE)
        return [
            f"TOO SIMPLE for this drive{falls}: the learned static curve errs by {errs}.",
            "Where the simulator can take a look-up table, use that of format csv or the code of format c.",
        ]

    def comment(self, learned: Learned, *usage: str) -> str:
        """Return the XML comment of a robot description: source, error, what it leaves out, and how to use it."""
        q = learned.quantities
        lines = [
            f"Friction learned by friction_estimator, from {learned.name}.",
            *learned.cost(self.error_rms_N),
            f"Left out: an offset of {q.text(self.offset_N, FORCE)}, whatever differs between the directions, the dip",
            "of Stribeck, and all memory.",
            *self.advice(learned),
            f"Coulomb friction is in {q.force}, damping in {q.unit('N s/m')}.",
            *usage,
        ]
        text = "\n     ".join(line.replace("--", "- -") for line in lines)  # all that XML forbids in a comment
        return f"<!-- {text} -->\n"


def coulomb_viscous(learned: Learned) -> CoulombViscous:
    """Return the least-squares fit of Fc sign(v) + Fv v + offset, Fc and Fv not negative, to the recording.

    The sign is a true one: no slope near standstill is passed off as viscous friction.

    Raises UnanswerableError where the recording is too short or does not move.
    """
    velocity, friction = _motion(learned)
    columns = np.stack([np.sign(velocity), velocity, np.ones(velocity.size), -np.ones(velocity.size)])
    scale = np.sqrt(np.mean(np.square(columns), axis=1))
    gram = (columns / scale[:, None]) @ (columns / scale[:, None]).T / velocity.size
    # Of the normal equations: their root has four rows whatever the recording's length. Conditioned by the floor.
    root = np.linalg.cholesky(gram + 1e-12 * np.eye(4))
    moment = (columns / scale[:, None]) @ friction / velocity.size
    found = nnls(root.T, np.linalg.solve(root, moment))[0] / scale
    coulomb, viscous = float(found[0]), float(found[1])
    assert learned.samples is not None
    every = learned.samples.velocity_m_s
    error = learned.error_rms_N(coulomb * np.sign(every) + viscous * every)
    return CoulombViscous(coulomb, viscous, float(found[2] - found[3]), error)


def _motion(learned: Learned) -> tuple[Floats, Floats]:
    """Return velocity and friction of the samples that count, (m,)."""
    assert learned.samples is not None
    velocity = learned.samples.velocity_m_s[learned.judged]
    friction = learned.samples.friction_N[learned.judged]
    if velocity.size < 2 * BLOCKS or not np.any(velocity):
        raise UnanswerableError(
            f"{learned.recording_names}: {velocity.size} samples in motion are too few to fit friction to"
        )
    return velocity, friction
