"""The derivative of a model with respect to its parameters, made piece by piece: it is never held whole.

At 400,000 samples and 30 parameters it would take 100 MB, once for each model that is compared.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.core.sums import parts
from friction_estimator.diagnosis.lagged import LaggedProducts
from friction_estimator.diagnosis.products import inner

PIECE = 16_384
"""Samples that are worked on together: few enough for the cache, many enough that calls cost nothing beside them."""


@dataclass(frozen=True)
class Carried:
    """What bristles carry, less the level that they carry in steady sliding.

    Attributes
    ----------
    change : (n, m), its change with each coefficient of the base's static curve. force_N : (n,), as it is.
    """

    change: Floats
    force_N: Floats

    def changed(self, weights: Floats, taps: Floats) -> Floats:
        """Return by how much the force carried beside a base differs from what it is, (n,), N.

        Parameters
        ----------
        weights, taps : of the base, (m,) and (p,).
        """
        return np.asarray(self.change @ weights * (1.0 + taps.sum()) - self.force_N)


class Rows(Protocol):
    """What gives (n, q) columns for a slice of the samples: an array, or a `Tangent`."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(n, q)."""
        ...

    def __getitem__(self, part: slice, /) -> Floats:
        """Return (n_part, q)."""
        ...


@dataclass(frozen=True)
class Tangent:
    """Derivative of the base model, each column over its norm, and columns beside them.

    Attributes
    ----------
    products : the lagged columns. weights, taps : where the derivative is taken, (m,) and (p,).
    norm : of its columns, (q_base,). beside : (n, c) each.
    carried : (n, m) or None, how what bristles carry changes with each coefficient of the static curve.
    """

    products: LaggedProducts
    weights: Floats
    taps: Floats
    norm: Floats
    beside: tuple[Floats, ...] = field(default_factory=tuple)
    carried: Floats | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(n, q)."""
        width = self.norm.size + sum(c.shape[1] for c in self.beside)
        return self.products.static.shape[0], width

    def __getitem__(self, part: slice, /) -> Floats:
        """Return the columns of some samples, (n_part, q)."""
        own = self.norm.size - self.weights.size - self.taps.size
        base = self.products.derivative(self.weights, self.taps, own, part)
        if self.carried is not None:
            # Taps and own lags change no static gain, and so not the level that bristles carry.
            base[:, : self.weights.size] += (1.0 + self.taps.sum()) * self.carried[part]
        base /= self.norm
        return np.concatenate([base, *(c[part] for c in self.beside)], axis=1) if self.beside else base

    def with_carried(self, carried: Carried | None) -> "Tangent":
        """Return the tangent with what bristles carry."""
        return self if carried is None else replace(self, carried=carried.change)

    def beside_it(self, columns: Sequence[Floats]) -> "Tangent":
        """Return the tangent with further columns, (n, c) each."""
        return replace(self, beside=(*self.beside, *columns))


def pieces(n: int) -> Iterator[slice]:
    """Return slices of at most `PIECE` samples that make up n.

    >>> [(p.start, p.stop) for p in pieces(20_000)]
    [(0, 16384), (16384, 20000)]
    """
    return parts(n, PIECE)


def piece_edges(edges: Ints) -> list[tuple[int, int]]:
    """Return first and last (excluded) block of pieces of whole blocks, each of about `PIECE` samples or one block.

    >>> piece_edges(np.array([0, 9000, 18000, 27000, 90000]))
    [(0, 1), (1, 2), (2, 3), (3, 4)]
    """
    out, first = [], 0
    for b in range(1, edges.size):
        if b == edges.size - 1 or edges[b + 1] - edges[first] > PIECE:
            out.append((first, b))
            first = b
    return out


def chosen_rows(tangent: Rows, beside: Sequence[Floats], used: Bools) -> Floats:
    """Return tangent and columns beside it of the chosen samples, (n_used, q)."""
    out = np.empty((int(used.sum()), tangent.shape[1] + sum(c.shape[1] for c in beside)))
    place = 0
    for part in pieces(used.size):
        here = used[part]
        rows = np.concatenate([tangent[part], *(c[part] for c in beside)], axis=1)[here]
        out[place : place + len(rows)] = rows
        place += len(rows)
    return out


def normal_equations(
    tangent: Rows, beside: Sequence[Floats], error: Floats, used: Bools
) -> tuple[Floats, Floats, Floats]:
    """Return rms of each column, and Z'Z and Z'e of the columns divided by it: (q,), (q, q), (q,).

    Parameters
    ----------
    tangent, beside : columns Z, (n, q) in all. error : e, (n,). used : (n,) bool, samples that count.
    """
    width = tangent.shape[1] + sum(c.shape[1] for c in beside)
    gram, right = np.zeros((width, width)), np.zeros(width)
    for part in pieces(used.size):
        here = used[part]
        rows = np.concatenate([tangent[part], *(c[part] for c in beside)], axis=1)[here]
        if len(rows):
            gram += inner(rows, rows)
            right += inner(rows, error[part][here])
    norm = np.maximum(np.sqrt(np.diag(gram) / max(int(used.sum()), 1)), 1e-300)
    return norm, gram / norm / norm[:, None], right / norm  # the product of two least norms would be zero
