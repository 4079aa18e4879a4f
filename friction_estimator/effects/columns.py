"""Columns of a regressor as causal machines, and the running force that they are made from."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.effects.features import Features
from friction_estimator.effects.kernels import fir
from friction_estimator.effects.reference import THEORY, Reference


class Columns:
    """Columns of an effect as a causal machine: fed with consecutive pieces, it gives what one piece would.

    Parameters
    ----------
    compute : (features, reference, state) -> (n, size), N; `state` is carried from piece to piece.
    size : number of columns.
    state : number of state variables.
    filtered : True where the effect acts before the base model's FIR: the columns then pass through it.
    of_force : True where they are made from the force that runs at the effect's stage, `Features.force_N`.
    of_theory : gives, as `compute` does and with a state of its own, what of the one column is the theory's: it passes
        through the theory's own lags, too, where the base model has such.
    one_sided : leading columns whose coefficients cannot be negative: of forces that act one way only.
    shapes : numbers of leading columns that are free shapes over the speed (`effects.shapes.free`), shape by shape. Of
        what no sample shows of such a shape a fit says nothing, unless by a prior (`effects.shapes.information`).
    """

    def __init__(
        self,
        compute: Callable[[Features, Reference, Floats], Floats],
        size: int = 1,
        state: int = 0,
        filtered: bool = False,
        of_force: bool = False,
        of_theory: Callable[[Features, Reference, Floats], Floats] | None = None,
        one_sided: int = 0,
        shapes: tuple[int, ...] = (),
    ) -> None:
        self._compute, self._of_theory = compute, of_theory
        self.size, self.of_force, self.one_sided, self.shapes = size, of_force, one_sided, shapes
        self._state, self._theory_state = np.zeros(state), np.zeros(state)
        self._filtered = filtered
        self._ring: Floats | None = None
        self._theory_ring: Floats | None = None

    def restart(self) -> None:
        """Forget the past."""
        self._state[:] = 0.0
        self._theory_state[:] = 0.0
        self._ring = self._theory_ring = None

    def __call__(self, features: Features, reference: Reference) -> Floats:
        """Return the columns for the next samples, (n, size), N per unit of their coefficient."""
        out = self._compute(features, reference, self._state).reshape(features.size, self.size)
        if self._filtered and reference.taps.size:
            if self._ring is None:
                self._ring = np.zeros(1 + reference.taps.size * self.size)
            out = through_fir(features.step_s, out, reference.taps, self._ring)
        if self._of_theory is not None and reference.theory_lags.size:
            if self._theory_ring is None:
                self._theory_ring = np.zeros(1 + reference.theory_lags.size)
            theory = self._of_theory(features, reference, self._theory_state)
            out = out + through_own_lags(features.step_s, theory, reference.theory_lags, self._theory_ring)[:, None]
        return out


class SideBySide:
    """Several machines as one: their columns beside each other, (n, sum of sizes)."""

    def __init__(self, machines: Sequence[Columns]) -> None:
        self._machines = machines

    def __call__(self, features: Features, reference: Reference) -> Floats:
        """Return the columns for the next samples, (n, sum of sizes)."""
        made = [machine(features, reference) for machine in self._machines]
        return made[0] if len(made) == 1 else np.concatenate(made, axis=1)


def through_fir(step_s: Floats, values: Floats, taps: Floats, ring: Floats) -> Floats:
    """Return values through the FIR [1, taps], normalised to gain one; `ring` carries the delay line."""
    out = np.empty(values.shape)
    fir(step_s, np.ascontiguousarray(values), taps, ring, out)
    return np.asarray(out / (1.0 + taps.sum()))


def through_own_lags(step_s: Floats, theory_N: Floats, lags: Floats, ring: Floats) -> Floats:
    """Return what the theory's own lags add to its force t (n,): sum_i c_i (t[k - i] - t[k]); `ring` as above."""
    out = np.empty((theory_N.size, 1))
    fir(step_s, theory_N[:, None], lags, ring, out)
    return np.asarray(out[:, 0] - (1.0 + lags.sum()) * theory_N)


RECORDINGS = "recordings"
"""Parameter of columns that have coefficients of their own in each recording: the number of recordings."""


def recordings(params: Mapping[str, float]) -> int:
    """Return how many recordings have coefficients of their own, 1 where all share them."""
    return round(params.get(RECORDINGS, 1.0))


def per_recording(columns: Floats, features: Features, params: Mapping[str, float]) -> Floats:
    """Return (n, c) columns as (n, c recordings): each recording has coefficients of its own.

    Clocks, encoders and force sensors may have another zero in each. A recording beyond those that were fitted takes
    the last ones.
    """
    count = recordings(params)
    if count == 1:
        return columns
    number = np.minimum(features.recording, count - 1)
    out = np.zeros((columns.shape[0], count, columns.shape[1]))
    out[np.arange(number.size), number] = columns
    return out.reshape(columns.shape[0], -1)


def amplitudes(weights: Floats, params: Mapping[str, float], held: Sequence[Sequence[int]] = ()) -> Floats:
    """Return for each pair of cosine and sine the rms amplitude over the recordings, (pairs,).

    `held` : for each recording the samples that tell its amplitude, one number for all pairs or one for each in turn:
    a recording counts as much as it has of them. Where it is not known all count alike.
    """
    count = recordings(params)
    squares = np.square(weights).reshape(count, -1, 2).sum(axis=2)
    if len(held) != count or count == 1:
        return np.asarray(np.sqrt(squares.mean(axis=0)))
    share = np.asarray(held, np.float64)
    share = np.tile(share, squares.shape[1] // share.shape[1])
    return np.asarray(np.sqrt((share * squares).sum(axis=0) / np.maximum(share.sum(axis=0), 1.0)))


def several(features: Features) -> dict[str, float]:
    """Return the parameter that gives each recording its own coefficients, empty where there is one recording."""
    count = int(features.recording.max()) + 1 if features.size else 1
    return {RECORDINGS: float(count)} if count > 1 else {}


class RunningForce:
    """Force of the base model, its FIR and the theory's own lags included, as a causal machine."""

    def __init__(self, reference: Reference) -> None:
        self._reference = reference
        self.restart()

    def restart(self) -> None:
        """Forget the past."""
        self._ring = np.zeros(1 + self._reference.taps.size)
        self._theory_ring = np.zeros(1 + self._reference.theory_lags.size)

    def __call__(self, features: Features) -> Features:
        """Return the features of the next samples with their force."""
        r, at = self._reference, (features.velocity_m_s, features.pressure_Pa)
        force = r.force(*at)
        if r.taps.size:
            force = through_fir(features.step_s, force[:, None], r.taps, self._ring)[:, 0]
        if r.theory_lags.size:
            theory = np.asarray(sum(r.part(part, *at) for part in THEORY))
            force = force + through_own_lags(features.step_s, theory, r.theory_lags, self._theory_ring)
        return features.with_force(force)
