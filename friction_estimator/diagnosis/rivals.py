"""Rivals: which other effect can do on this record what the named one does. Computed from their columns, not listed.

With Z the tangent of the base model and of earlier effects, p the fitted force of an effect and X the columns of
another one, all with Z projected out, the share of p that X can take over is

    R^2 = cos^2(p, span X) = (X'p)' (X'X)^-1 (X'p) / p'p

with the coefficients' signs kept (Bjoerck and Golub, Math. Comp. 27 (1973) 579: the principal angle of a line and a
plane). Who takes the other effect for the one loses (1 - R^2) p'p of the error power. Everything is summed over blocks,
so several recordings are stacked by themselves.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.evidence import Evidence
from friction_estimator.diagnosis.held_out import error_of_sum
from friction_estimator.diagnosis.library import Library

LEAST_SHARE = 1e-9
"""Share of an effect's power that must be left when the base is projected out; less is rounding."""


@dataclass(frozen=True)
class Alike:
    """How well another effect does what one effect does.

    Attributes
    ----------
    share : R^2, 0 to 1. params : point of the grid that comes nearest.
    lost_N2 : error power, summed, by which the other one fits worse. error_N2 : its standard error over blocks, with
        what the record has beside the effect in it.
    """

    share: float
    params: dict[str, float]
    lost_N2: float
    error_N2: float

    def indiscernible(self, errors: float, share: float) -> bool:
        """Return whether the loss is within so many standard errors, or so small a share of the effect."""
        return self.lost_N2 < errors * self.error_N2 or 1.0 - self.share < share


def alike(evidence: Evidence, library: Library, part: Floats, least: float = 0.0) -> dict[str, Alike]:
    """Return for each effect of a library how well it does what a fitted effect does, best first.

    Parameters
    ----------
    evidence : about the model without the effect: its tangent is projected out. library : hypotheses with products by
        that tangent. part : p, (n,), the effect's fitted force, N. least : share of the effect's power that another
        one must gain on the residual itself to be looked at; what cannot does nothing that the effect does.
    """
    target = evidence.with_residual(part)
    power = own_power(target)
    if power <= LEAST_SHARE * float(target.ee.sum()):
        return {}
    near = [f for f in library.families if evidence.gains(f.stack, f.rule).max() >= least * power]
    library = replace(library, families=tuple(near))
    found: dict[str, Alike] = {}
    crossed = evidence.by_block(target.residual, evidence.residual)
    for family, (xp,) in zip(library.families, library.products_with(target, target.residual[:, None]), strict=True):
        stack = replace(family.stack, xe=xp)
        gains = target.gains(stack, family.rule)
        best = int(np.argmax(gains))
        share = float(np.clip(gains[best] / power, 0.0, 1.0))
        if family.name in found and found[family.name].share >= share:
            continue
        fit = target.fit(stack[best], family.rule)
        everything = np.ones(evidence.blocks, np.bool_)
        left = target.loss(fit.base, fit.weights, stack[best], everything)
        # With u = p - X w - Z b and r = e - p the loss of a block is u'u + 2 r'u: r is what the effect itself leaves.
        with_part = target.ee - xp[:, best] @ fit.weights - target.ze @ fit.base
        with_residual = crossed - family.stack.xe[:, best] @ fit.weights - evidence.ze @ fit.base
        behind = left + 2.0 * (with_residual - with_part)
        found[family.name] = Alike(share, family.points[best], (1.0 - share) * power, error_of_sum(behind))
    return dict(sorted(found.items(), key=lambda item: -item[1].share))


def own_power(target: Evidence) -> float:
    """Return what is left of the residual's power when the base takes its share of it, summed, N^2."""
    everything = np.ones(target.blocks, np.bool_)
    base = target.base_alone(everything)
    return float(target.ee.sum() - target.ze.sum(axis=0) @ base)


def closest(found: Mapping[str, Alike], errors: float, share: float) -> list[str]:
    """Return the effects that cannot be told from the one, nearest first."""
    return [name for name, one in found.items() if one.indiscernible(errors, share)]
