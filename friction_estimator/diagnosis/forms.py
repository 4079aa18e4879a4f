"""What other functional forms of the causes in a model could still explain of what it leaves.

A cause is named by its regressor's form, and nature has another one. What the difference of the two leaves passes every
test of significance in a long record, and resembles some other cause of the catalogue. So a further cause is asked what
it explains beside these differences.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.lack_of_fit import Wider
from friction_estimator.diagnosis.library import columns_of
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.effects.compose import rms
from friction_estimator.effects.shapes import SHAPES, splines

SHARE = 0.3
"""Deviation of the share by which a cause's force may be another one at a speed, in a direction, at a pressure."""

SCALES = (0.5, 2.0)
"""Factors of a cause's lengths and times at which a share of its force may act as well."""

FEW = 2
"""Columns that a variant of a cause may have to be one of its other forms here."""


@dataclass(frozen=True)
class OtherForms(Wider):
    """A model's tangent, and beside it what other forms of its causes differ by.

    The force of a cause is taken times splines of the speed, times pressure and position about their means,
    times the sign of the change of speed, times its own size, and times the direction where it turns with it; beside
    that it may act at other lengths and times, and in its variants. All in units of the prior's deviation.

    Attributes
    ----------
    model : with a cause at least. place : (n, 2), pressure and position about their means, over their deviations.
    sizes_N : rms of the force of each cause, N.
    others : (n, c) of each cause, its force at other lengths and times and in its variants.
    """

    model: Joint
    place: Floats
    sizes_N: tuple[float, ...]
    others: tuple[Floats, ...]

    @classmethod
    def of(cls, model: Joint) -> "OtherForms":
        """Return those of a model."""
        f = model.features
        place = np.column_stack([(x - x.mean()) / (float(np.std(x)) or 1.0) for x in (f.pressure_Pa, f.position_m)])
        others = tuple(_others(model, term, part) for term, part in zip(model.terms, model.parts_N, strict=True))
        return cls(model, place, tuple(rms(part) or 1.0 for part in model.parts_N), others)

    @property
    def width(self) -> int:
        """Number of columns beside the tangent."""
        own = sum(SHAPES + 3 + int(t.effect.by_place()) + int(t.effect.turns) for t in self.model.terms)
        return own + sum(int(o.shape[1]) for o in self.others)

    def beside(self, part: slice) -> Sequence[Floats]:
        """Return the columns beside the tangent for some samples."""
        model, f = self.model, self.model.features[part]
        faster = np.sign(f.acceleration_m_s2 * f.direction)
        pressure, position = self.place[part].T
        on = np.column_stack([splines(f.velocity_m_s, model.reference), pressure, faster])
        made = []
        for term, force, size in zip(model.terms, model.parts_N, self.sizes_N, strict=True):
            own = [np.abs(force[part]) / size]
            # What does not go with the position would be a spring if it did.
            own += [position] if term.effect.by_place() else []
            own += [f.direction] if term.effect.turns else []
            made.append(SHARE * force[part, None] * np.column_stack([on, *own]))
        return [*made, *(o[part] for o in self.others)]


def power_N2(model: Joint) -> float:
    """Return the power that other forms of a model's causes may have by this share, summed, N^2."""
    return SHARE**2 * sum(float(part @ part) for part in model.parts_N)


def _others(model: Joint, term: Term, force_N: Floats) -> Floats:
    """Return the force of a cause at other lengths and times and in its variants, (n, c), in deviations."""
    nothing = np.zeros((force_N.size, 0))
    if term.effect.delays or term.effect.in_theory:
        return nothing
    moved = [n for n in term.refined if n not in (*term.effect.shares, *term.effect.steps) and term.params[n]]
    shapes = [term.params | {n: s * term.params[n]} for n in moved for s in SCALES]
    shapes += [dict(v) for v in term.effect.variants(term.params) if term.effect.columns(v).size <= FEW]
    made = [columns_of(term.effect, shape, model.features, model.reference) for shape in shapes]
    if term.one_sided.any():
        # One by one they would have no sign: a share of their force, and what they are themselves, in the tangent.
        made = [(c @ term.weights)[:, None] if c.shape[1] == term.weights.size else c for c in made]
    if not made:
        return nothing
    columns = np.concatenate(made, axis=1)
    sizes = np.sqrt(np.mean(np.square(columns), axis=0))
    return np.asarray(columns[:, sizes > 0.0] * (SHARE * rms(force_N) / sizes[sizes > 0.0]))
