"""One sample at a time without the cost of arrays: the live node's way through the same compiled kernels.

`Intake.push` and `Estimator.run` take arrays and spend, on arrays of one, ten times as long on checks, views and
small allocations as in the kernels. `LiveStep` calls the same kernels on arrays that it allocates once. The result is
that of `Intake.push` and `Estimator.run` bit for bit, which a test asserts; whatever is not the usual case (several
samples at once, extension terms, a curve other than the seal's) goes through those two.
"""

from math import isfinite

import numpy as np

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import HELD, USED, Pairs, _admit, _pair
from friction_estimator.core.model.basis import WaveletBasis, _wavelet_rows
from friction_estimator.core.model.theory_seal import SealCurve, _seal_loop
from friction_estimator.core.online import kernels, workspace
from friction_estimator.core.online.estimator import Estimator

CAPACITY = 128
"""Events taken at once at the most."""

Prediction = tuple[int, float, float, float]
"""Stamp (ns), velocity (m/s), measured friction (N), predicted friction (N)."""


class Events:
    """Room for events: `stream`, `stamp_ns` and `value`, (CAPACITY,) each."""

    def __init__(self) -> None:
        self.stream = np.zeros(CAPACITY, np.int64)
        self.stamp_ns = np.zeros(CAPACITY, np.int64)
        self.value = np.zeros(CAPACITY)


class LiveStep(Events):
    """Push a few events, get the predictions of the samples that they complete.

    Parameters
    ----------
    intake, estimator : are driven by this object and may be read, saved and restored between calls.

    Examples
    --------
    >>> from friction_estimator.core.settings.config import Config
    >>> from friction_estimator.core.settings.derive import with_live_units
    >>> config = with_live_units(Config())
    >>> step = LiveStep(Intake(config), Estimator(config))
    >>> step.stream[:2], step.stamp_ns[:2], step.value[:2] = (0, 1), (7, 7), (0.1, 3.0)
    >>> [(stamp, friction) for stamp, _, friction, _ in step.run(2, learn=True)]
    [(7, 3.0)]
    """

    def __init__(self, intake: Intake, estimator: Estimator) -> None:
        super().__init__()
        self.intake, self.estimator = intake, estimator
        self._events = [(self.stream[:n], self.stamp_ns[:n], self.value[:n]) for n in range(CAPACITY + 1)]
        self._out = (
            np.zeros(CAPACITY, np.int64),
            np.zeros(CAPACITY),
            np.zeros(CAPACITY),
            np.zeros((CAPACITY, HELD)),
        )
        self._stamp, self._velocity, self._friction, self._held = (array[:1] for array in self._out)
        self._status, self._restart = np.zeros(1, np.int8), np.zeros(1, np.bool_)
        self._learn, self._predicted = np.zeros(1, np.bool_), np.zeros(1)
        self._pressure, self._temperature = np.zeros(1), np.zeros(1)
        self._theory, self._target = np.zeros(1), np.zeros(1)
        pairer, sequencer = intake.pairer, intake.sequencer
        self._pairing = (
            pairer._slop_ns,
            pairer._stamp,
            pairer._value,
            pairer._queue,
            pairer._held_stamp,
            pairer._held_value,
            pairer._held_count,
            pairer._held_now,
            pairer._dropped,
            *self._out,
        )
        self._admission = (
            self._stamp,
            self._velocity,
            self._friction,
            sequencer._gap_factor,
            sequencer._jump_ns,
            sequencer._clock,
            sequencer._events,
            sequencer._counts,
            self._status,
            self._restart,
        )
        model = estimator.model
        basis, curve = model.basis, model.theory
        self._theory_scale = model.theory_scale
        self._usual = (
            model.extension is None and isinstance(basis, WaveletBasis) and isinstance(curve, SealCurve | None)
        )
        if not isinstance(basis, WaveletBasis):
            return
        index, row = np.zeros((1, basis.width), np.int32), np.zeros((1, basis.width))
        self._low, self._high = basis.low, basis.high
        self._rows = (
            self._velocity,
            basis.unit,
            basis.low,
            basis.high,
            basis.bend,
            basis._scale,
            basis._amplitude,
            basis._first,
            basis._kind,
            basis._table,
            index,
            row,
        )
        self._seal = (
            (self._velocity, self._pressure, self._temperature, curve._par, curve._counts, self._theory)
            if isinstance(curve, SealCurve)
            else ()
        )
        self._inputs = (
            estimator._law_number,
            index,
            row,
            self._velocity,
            self._theory,
            np.zeros((1, 0)),
            self._target,
            self._restart,
            self._learn,
            self._predicted,
        )
        self._refresh()

    def run(self, count: int, *, learn: bool) -> list[Prediction]:
        """Take the first `count` events of `stream`, `stamp_ns`, `value`, in order of arrival.

        Returns
        -------
        The predictions of the samples that were completed and admitted.
        """
        joined = _pair(*self._events[count], *self._pairing)
        if joined == 1 and self._usual:
            _admit(*self._admission)
            return [self._step(learn)] if self._status.item() == USED else []
        return self._several(joined, learn) if joined else []

    def _refresh(self) -> None:
        """Take over what may have been exchanged since the last sample: the work space (restore), settings (retune)."""
        estimator = self.estimator
        config = estimator.config
        self._work, self._config = estimator._work, config
        self._arrays = self._work.arrays()
        self._unit, self._sign = config.force_unit, self.intake._sign
        theory = config.theory
        self._ambient, self._default_pressure = theory.ambient_pressure, theory.default_pressure
        self._default_temperature = theory.default_temperature

    def _step(self, learn: bool) -> Prediction:
        """Predict and learn from the one sample in the arrays."""
        estimator = self.estimator
        if estimator._work is not self._work or estimator.config is not self._config:
            self._refresh()
        unit = self._unit
        velocity = self._velocity.item()
        friction = self._sign * self._friction.item()
        _wavelet_rows(*self._rows)
        if self._seal:
            pressure, temperature, _ = self._held[0].tolist()
            self._pressure[0] = pressure - self._ambient if isfinite(pressure) else self._default_pressure
            self._temperature[0] = temperature if isfinite(temperature) else self._default_temperature
            _seal_loop(*self._seal)
            self._theory[0] = self._theory_scale * self._theory.item() / unit
        self._target[0] = friction / unit
        inside = self._low <= velocity <= self._high
        if not inside:
            self._work.status[workspace.OUTSIDE] += 1
        self._learn[0] = learn and inside
        if kernels.run(*self._inputs, *self._arrays):
            estimator.relinearisation.visit(self._work)
        return int(self._stamp.item()), velocity, friction, self._predicted.item() * unit

    def _several(self, joined: int, learn: bool) -> list[Prediction]:
        """Take the way of replay."""
        stamp, velocity, friction, held = self._out
        pairs = Pairs(*(a[:joined].copy() for a in (stamp, velocity, friction, held)))  # type: ignore[arg-type]
        samples = self.intake.admit(pairs)
        if not len(samples):
            return []
        predicted = self.estimator.run(samples, learn)
        return list(
            zip(
                samples.stamp_ns.tolist(),
                samples.velocity_m_s.tolist(),
                samples.friction_N.tolist(),
                predicted.tolist(),
                strict=True,
            )
        )
