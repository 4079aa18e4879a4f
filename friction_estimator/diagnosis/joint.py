"""A fit of base model and named effects: what it has found, and what that makes of the record."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.sample import Bools, Floats
from friction_estimator.diagnosis.base import BaseFit
from friction_estimator.diagnosis.base_problem import Coefficients
from friction_estimator.diagnosis.evidence import Evidence
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.tangent import Tangent
from friction_estimator.effects.features import Features
from friction_estimator.effects.reference import Reference

Source = tuple[Coefficients, tuple[Term, ...]]
"""A model that tables are made from: the base's coefficients, and the terms."""

Anchors = tuple[Mapping[str, tuple[float, float]], ...]
"""For each term the bracket of each refined parameter."""


@dataclass(frozen=True, eq=False)
class Solution:
    """What a joint fit has found: numbers alone, from which all that has a value a sample is made again to the bit.

    Attributes
    ----------
    coefficients, terms : found. source : what the tables were made from, the round before.
    anchors : brackets of the refined parameters.
    """

    coefficients: Coefficients
    terms: tuple[Term, ...]
    source: Source
    anchors: Anchors


@dataclass(frozen=True)
class Evaluated:
    """A solution on its record: see the attributes of `Joint`."""

    base: BaseFit
    reference: Reference
    features: Features
    parts_N: tuple[Floats, ...]
    residual_N: Floats
    tangent: Tangent
    penalty: Floats
    scales: Floats
    at_end: Bools


class Joint:
    """Base model and effects fitted together.

    It holds numbers alone. What has a value a sample is made on demand, and is kept as long as few others were asked
    for since: dozens of fits are compared, and at 400,000 samples each would have 170 MB.

    Parameters
    ----------
    solution : of the fit. evaluated : makes what it is on the record, or has kept it.
    """

    def __init__(self, solution: Solution, evaluated: Callable[[Solution], Evaluated]) -> None:
        self._solution, self._evaluated = solution, evaluated

    @property
    def coefficients(self) -> Coefficients:
        """Of the base model, and of the columns beside it."""
        return self._solution.coefficients

    @property
    def terms(self) -> tuple[Term, ...]:
        """The effects, with fitted parameters and weights."""
        return self._solution.terms

    @property
    def base(self) -> BaseFit:
        """The base model's part."""
        return self._evaluated(self._solution).base

    @property
    def reference(self) -> Reference:
        """Tables made from the base."""
        return self._evaluated(self._solution).reference

    @property
    def features(self) -> Features:
        """Of the record, with the running force."""
        return self._evaluated(self._solution).features

    @property
    def parts_N(self) -> tuple[Floats, ...]:
        """One (n,) array for each term: its force."""
        return self._evaluated(self._solution).parts_N

    @property
    def residual_N(self) -> Floats:
        """What is left, (n,)."""
        return self._evaluated(self._solution).residual_N

    @property
    def tangent(self) -> Tangent:
        """Derivative of the whole model, (n, q)."""
        return self._evaluated(self._solution).tangent

    @property
    def penalty(self) -> Floats:
        """Ridge on the tangent's coefficients, (q,)."""
        return self._evaluated(self._solution).penalty

    @property
    def scales(self) -> Floats:
        """What a unit of each tangent coefficient is in the parameter's own unit, (q,)."""
        return self._evaluated(self._solution).scales

    @property
    def at_end(self) -> Bools:
        """Coefficients that are held, (q,) bool: of parameters at an end of their bracket, and those held at zero."""
        return self._evaluated(self._solution).at_end

    def evidence(self, record: Record, seed: int) -> Evidence:
        """Return the evidence machine for what this model leaves."""
        return Evidence(TangentOf(self), self.penalty, self.residual_N, record.used, record.block, seed)

    def held_out_loss(self, record: Record, seed: int) -> Floats:
        """Return the error power of each block under coefficients fitted without it, (blocks,), N^2.

        The model is linear about its fit to everything; its refined parameters are among the coefficients.
        """
        return self.evidence(record, seed).base_loss()


def is_constant(part_N: Floats) -> bool:
    """Return whether the force of a term, (n,), is the same at all times: cutting steps off makes such a one, too."""
    return bool(np.ptp(part_N) == 0.0)


@dataclass(frozen=True)
class TangentOf:
    """The tangent of a fit, which is not held."""

    joint: Joint

    @property
    def shape(self) -> tuple[int, int]:
        """(n, q)."""
        return self.joint.tangent.shape

    def __getitem__(self, part: slice, /) -> Floats:
        """Return the columns of some samples, (n_part, q)."""
        return self.joint.tangent[part]
