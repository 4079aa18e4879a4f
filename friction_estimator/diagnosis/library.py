"""The hypotheses of a diagnosis: every effect with a regressor, over its grid.

Columns are causal machines: they are made piece by piece, added to products by block, and forgotten. What needs them
again (another residual) makes them again, but for those that are kept until the screening has ended.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.core.sums import parts
from friction_estimator.diagnosis.evidence import Evidence, Rule
from friction_estimator.diagnosis.moments import Moments, Piece, Stack
from friction_estimator.effects.base import Effect
from friction_estimator.effects.columns import RunningForce
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.reference import Reference

AT_ONCE = 32
"""Columns whose inner products are formed together."""

MOST_KEPT = 64 << 20
"""Bytes of columns that are kept until `Library.forget`: of 60,000 samples all but those of waves in the position,
which are 90 of 100 and take a fortieth of the time each."""

UNKNOWN_WITHOUT = ("pressure",)
"""Channels that nothing can stand in for where they are not recorded; the position is integrated from the velocity."""


@dataclass(frozen=True)
class Hypothesis:
    """One effect at one point of its grid.

    Attributes
    ----------
    effect : class of the effect. params : its point. moments : of its columns. rule : on its coefficients.
    """

    effect: type[Effect]
    params: dict[str, float]
    moments: Moments
    rule: Rule

    @property
    def name(self) -> str:
        """Id of the effect."""
        return self.effect.name


@dataclass(frozen=True, eq=False)
class Family:
    """The points of one effect that have equally many columns, and their products.

    Attributes
    ----------
    made : columns that are kept, by number of the first point, piece after piece.
    """

    effect: type[Effect]
    points: tuple[dict[str, float], ...]
    rule: Rule
    stack: Stack
    made: dict[int, list[Floats]] = field(default_factory=dict, repr=False)

    def __getitem__(self, i: int) -> Hypothesis:
        return Hypothesis(self.effect, self.points[i], self.stack[i], self.rule)

    @property
    def name(self) -> str:
        """Id of the effect."""
        return self.effect.name


@dataclass(frozen=True)
class Library:
    """All hypotheses about what a model leaves.

    Attributes
    ----------
    families : with their products. features, reference : what their columns are made from.
    """

    families: tuple[Family, ...]
    features: Features
    reference: Reference

    def __iter__(self) -> Iterator[Hypothesis]:
        return (family[i] for family in self.families for i in range(len(family.points)))

    def __len__(self) -> int:
        return sum(len(family.points) for family in self.families)

    def products_with(self, evidence: Evidence, residuals: Floats) -> list[Floats]:
        """Return X'e of each family with other residuals, (k, blocks, hypotheses, c) each.

        `evidence` gives the pieces, `residuals` (n, k) are zero where samples are masked.
        """
        out = [np.empty((residuals.shape[1], *f.stack.xe.shape)) for f in self.families]
        machines = [Machines(f.effect, f.points, f.made) for f in self.families]
        for number, piece in enumerate(evidence.pieces()):
            features, e = self.features[piece.part], residuals[piece.part]
            for xe, made in zip(out, machines, strict=True):
                for here, x in made(number, features, self.reference):
                    by_block = piece.by_block(x, e).reshape(piece.edges.size - 1, -1, xe.shape[-1], e.shape[1])
                    xe[:, piece.blocks, here] = np.moveaxis(by_block, -1, 0)
        return out

    def forget(self) -> None:
        """Let go of the columns that were kept."""
        for family in self.families:
            family.made.clear()


class Machines:
    """The columns of one effect at several points, piece by piece: each goes on where the piece before it ended.

    Parameters
    ----------
    known : columns that were kept, by number of the first hypothesis, piece after piece; the others are made.
    """

    def __init__(
        self, effect: type[Effect], points: Sequence[dict[str, float]], known: Mapping[int, Sequence[Floats]]
    ) -> None:
        step = max(1, AT_ONCE // effect.columns(points[0]).size)
        self._known = known
        self._machines = [(here, effect.side_by_side(points[here])) for here in parts(len(points), step)]

    def __call__(self, number: int, features: Features, reference: Reference) -> Iterator[tuple[slice, Floats]]:
        """Yield some hypotheses' numbers and their columns in a piece side by side, (n_part, hypotheses c)."""
        for here, machine in self._machines:
            known = self._known.get(here.start)
            yield here, machine(features, reference) if known is None else known[number]


def columns_of(effect: type[Effect], params: dict[str, float], features: Features, reference: Reference) -> Floats:
    """Return the columns of an effect over a whole record, (n, c)."""
    return effect.columns(params)(features, reference)


def with_running_force(features: Features, reference: Reference) -> Features:
    """Return the features with the base model's force."""
    return RunningForce(reference)(features)


def built(
    points: Mapping[type[Effect], Sequence[dict[str, float]]],
    features: Features,
    reference: Reference,
    evidence: Evidence,
) -> Library:
    """Return the library of some effects at given points, with their inner products."""
    families: list[Family] = []
    for effect, chosen in points.items():
        widths: dict[int, list[dict[str, float]]] = {}
        for params in chosen:
            widths.setdefault(effect.columns(params).size, []).append(params)
        for width, alike in widths.items():
            signs = effect.signs if len(effect.signs) == width else (0,) * width
            stack = Stack.empty(evidence.blocks, evidence.width, len(alike), width)
            families.append(Family(effect, tuple(alike), Rule(signs, effect.fixed_gain), stack))
    machines = [Machines(f.effect, f.points, {}) for f in families]
    kept = _kept(families, features.size)
    for number, piece in enumerate(evidence.pieces()):
        part = features[piece.part]
        for family, machine in zip(families, machines, strict=True):
            for here, x in machine(number, part, reference):
                _add(family.stack, piece, here, piece.masked(x))
                if family in kept:
                    family.made.setdefault(here.start, []).append(x)
    return Library(tuple(families), features, reference)


def _kept(families: Sequence[Family], samples: int) -> list[Family]:
    """Return the families whose columns are kept: those of fewest columns, which take longest to make each."""
    out, room = [], MOST_KEPT
    for family in sorted(families, key=lambda f: f.stack.xe[0].size):
        room -= family.stack.xe[0].size * samples * family.stack.xe.itemsize
        if room < 0:
            break
        out.append(family)
    return out


def _add(stack: Stack, piece: Piece, here: slice, x: Floats) -> None:
    """Fill in the products of some hypotheses' columns (n_part, hypotheses c) for the blocks of a piece."""
    blocks, width = piece.edges.size - 1, stack.xe.shape[2]
    count = x.shape[1] // width
    stack.zx[piece.blocks, :, here] = piece.by_block(piece.z, x).reshape(blocks, -1, count, width)
    stack.xe[piece.blocks, here] = piece.by_block(x, piece.e[:, None]).reshape(blocks, count, width)
    if width == 1:
        stack.xx[piece.blocks, here, 0, 0] = np.add.reduceat(np.square(x), piece.edges[:-1], axis=0)
    else:
        gram = piece.by_block(x, x).reshape(blocks, count, width, count, width)
        stack.xx[piece.blocks, here] = np.einsum("bhchd->bhcd", gram)


def build_library(
    catalogue: Mapping[str, type[Effect]],
    features: Features,
    reference: Reference,
    context: Context,
    evidence: Evidence,
    excluded: Iterable[str] = (),
) -> Library:
    """Return all hypotheses, except those of excluded effects and those that the record lacks the channel for.

    Position-dependent ones are tried with the integrated velocity as well: they then ask for the channel.
    """
    out = set(excluded)
    points = {
        cls: [*cls.grid(context), *cls.peaks(evidence.residual, features, context)]
        for name, cls in catalogue.items()
        if name not in out and (cls.channel not in UNKNOWN_WITHOUT or cls.channel in context.channels)
    }
    return built({cls: chosen for cls, chosen in points.items() if chosen}, features, reference, evidence)
