"""One sample at a time without the cost of arrays: the live node's way through the same compiled kernels.

`Intake.push` and `Estimator.run` take arrays and spend, on arrays of one, ten times as long on checks, views and
small allocations as in the kernels. `LiveStep` calls the same kernels on arrays that it allocates once. The result is
that of `Intake.push` and `Estimator.run` bit for bit, which a test asserts; whatever is not the usual case (several
samples at once, a load, extension terms, a table for theory) goes through those two.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from math import isfinite

import numpy as np

from friction_estimator.core.addresses import Addresses
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.encoder import unwrap
from friction_estimator.core.intake.pairing import HELD, POSITION, PRESSURE, USED, Pairs, admit, pair
from friction_estimator.core.model.basis import WaveletBasis, wavelet_rows
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.model.theory_stribeck import StribeckCurve
from friction_estimator.core.online import kernels
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import FirstContact
from friction_estimator.core.sample import Samples, in_sequence
from friction_estimator.core.settings.config import Config

CAPACITY = 128
"""Events taken at once at the most."""

Prediction = tuple[int, float, float, float, float]
"""Stamp (ns), velocity (m/s), measured friction (N), predicted friction (N), its standard deviation (N)."""


class Events:
    """Room for events: `stream`, `stamp_ns` and `value`, (CAPACITY,) each."""

    def __init__(self) -> None:
        self.stream = np.zeros(CAPACITY, np.int64)
        self.stamp_ns = np.zeros(CAPACITY, np.int64)
        self.value = np.zeros(CAPACITY)


class LiveStep(Events):
    """Push a few events, get the predictions of the samples that they complete.

    While range and units are not known the samples wait, and are predicted in order when they are: all at once, or as
    many a call as the caller can take.

    Parameters
    ----------
    intake : is driven by this object and may be read, saved and restored between calls.
    config : where range and units are open in it, the first samples decide.
    build : makes the estimator of a configuration.
    estimator : to go on with; built from `config` unless given.

    Attributes
    ----------
    estimator : None until the first contact has ended.
    contact : where samples wait for range and units; None when it has ended.
    behind : samples that have waited and are to be predicted next, before any that follow.

    Examples
    --------
    >>> known = {"basis.velocity_range": [-0.2, 0.2], "force_unit": 5.0, "theory.kind": "seal"}
    >>> config = Config.from_mapping(known)
    >>> step = LiveStep(Intake(config), config)
    >>> step.stream[:2], step.stamp_ns[:2], step.value[:2] = (0, 1), (7, 7), (0.1, 3.0)
    >>> [(stamp, friction) for stamp, _, friction, _, _ in step.run(2, learn=True)]
    [(7, 3.0)]
    """

    def __init__(
        self,
        intake: Intake,
        config: Config,
        build: Callable[[Config], Estimator] = Estimator,
        estimator: Estimator | None = None,
    ) -> None:
        super().__init__()
        self.estimator = estimator
        self.contact: FirstContact | None = None
        self.behind = 0
        self._backlog: deque[Samples] = deque()
        self._build = build
        self._events = [(self.stream[:n], self.stamp_ns[:n], self.value[:n]) for n in range(CAPACITY + 1)]
        stamp, velocity, friction = np.zeros(CAPACITY, np.int64), np.zeros(CAPACITY), np.zeros(CAPACITY)
        held = np.zeros((CAPACITY, HELD))
        self._out = stamp, velocity, friction, held
        self._stamp, self._velocity, self._friction, self._held = stamp[:1], velocity[:1], friction[:1], held[:1]
        self._status, self._restart = np.zeros(1, np.int8), np.zeros(1, np.bool_)
        self._position, self._shift = np.zeros(1), np.zeros(1)
        self._learn, self._predicted, self._deviation = np.zeros(1, np.bool_), np.zeros(1), np.zeros(1)
        self._pressure, self._temperature = np.zeros(1), np.zeros(1)
        self._theory, self._target = np.zeros(1), np.zeros(1)
        self._cell, self._beyond = np.zeros(1, np.int64), np.zeros(1)
        self._connect(intake)
        if estimator is None and config.is_met:
            self.estimator = build(config)
        if self.estimator is None:
            self.contact = FirstContact(config)
        else:
            self._refresh(self.estimator)

    def retuned(self) -> None:
        """Notice that the intake was retuned."""
        self._connect(self.intake)
        if self.estimator is not None:
            self._refresh(self.estimator)

    def _connect(self, intake: Intake) -> None:
        self.intake = intake
        self._pairing = intake.pairer.arguments(*self._out)
        self._admission = intake.sequencer.arguments(
            self._stamp, self._velocity, self._friction, self._status, self._restart
        )
        self._unwrapping = intake.encoder.arguments(
            self._stamp, self._velocity, self._restart, self._position, self._shift
        )

    def run(self, count: int, *, learn: bool, most: int | None = None) -> list[Prediction]:
        """Take the first `count` events of `stream`, `stamp_ns`, `value`, in order of arrival.

        Parameters
        ----------
        most : predictions to return at the most where there is a backlog; the next calls go on with it.

        Returns
        -------
        The predictions of the samples that were completed and admitted; none while the first contact lasts.
        """
        joined = pair(*self._events[count], *self._pairing)
        estimator = self.estimator
        if not joined:
            return self.work_off(most, learn=learn) if self.behind else []
        if joined == 1 and most is None and estimator is not None and self._usual and not self.behind:
            admit(*self._admission)
            if self._status.item() != USED:
                return []
            position = self._held.item(0, POSITION - PRESSURE)
            if isfinite(position):  # nothing here depends on it, but turns are counted from sample to sample
                self._position[0] = position
                unwrap(*self._unwrapping)
            return [self._step(estimator, learn)]
        stamp, velocity, friction, held = self._out
        pairs = Pairs(*(a[:joined].copy() for a in (stamp, velocity, friction, held)))  # type: ignore[arg-type]
        samples = self.intake.admit(pairs)
        if self.contact is not None:
            config = self.contact.push(samples)
            if config is None:
                return []
            self.begin(self._build(config))
        else:
            self._fall_behind(samples)
        return self.work_off(most, learn=learn)

    def begin(self, estimator: Estimator) -> None:
        """Go on with this estimator; samples that wait for one become the backlog."""
        if self.contact is not None:
            self._fall_behind(self.contact.queue())
            self.contact = None
        self.estimator = estimator
        self._refresh(estimator)

    def work_off(self, most: int | None = None, *, learn: bool) -> list[Prediction]:
        """Predict `most` samples of the backlog, or all."""
        if self.estimator is None:
            return []
        wanted = self.behind if most is None else min(most, self.behind)
        found: list[Prediction] = []
        while wanted:
            part = self._backlog.popleft()
            rest = part[wanted:]
            if len(rest):
                self._backlog.appendleft(rest)
            elif len(self._backlog) > 1:  # what came meanwhile, one by one
                self._backlog = deque([in_sequence(list(self._backlog))])
            part = part[:wanted]
            wanted -= len(part)
            self.behind -= len(part)
            found += self._several(self.estimator, part, learn)
        return found

    def let_go(self, count: int) -> None:
        """Drop the oldest of the backlog; the delay lines restart behind the gap."""
        while count and self._backlog:
            part = self._backlog.popleft()
            rest = part[count:]
            gone = len(part) - len(rest)
            count -= gone
            self.behind -= gone
            if len(rest):
                self._backlog.appendleft(rest)
        if self._backlog:
            part = self._backlog.popleft()
            restart = part.restart.copy()
            restart[0] = True
            self._backlog.appendleft(replace(part, restart=restart))

    def _fall_behind(self, samples: Samples) -> None:
        if len(samples):
            self._backlog.append(samples)
            self.behind += len(samples)

    def _refresh(self, estimator: Estimator) -> None:
        """Take over what may have been exchanged since the last sample: model, work space, settings."""
        model, config = estimator.model, estimator.config
        self._model, self._work, self._config = model, estimator.work, config
        basis, curve = model.basis, model.theory
        self._usual = (
            model.extension is None
            and self.intake.plain
            and isinstance(basis, WaveletBasis)
            and isinstance(curve, SealCurve | StribeckCurve | None)
        )
        if not isinstance(basis, WaveletBasis) or not self._usual:
            return
        index, row = np.zeros((1, basis.width), np.int32), np.zeros((1, basis.width))
        self._low, self._high = basis.reach
        self._rows = basis.row_arguments(self._velocity, index, row, self._cell)
        self._curve = curve if isinstance(curve, SealCurve | StribeckCurve) else None
        self._curve_arguments = (
            self._curve.arguments(self._velocity, self._pressure, self._temperature, self._theory)
            if self._curve is not None
            else ()
        )
        nothing = np.zeros((1, 0))
        samples = (index, row, self._cell, self._beyond, self._velocity, self._theory, nothing, nothing, nothing)
        outcome = (self._target, self._restart, self._learn, self._predicted, self._deviation)
        self._samples = Addresses([*samples, *outcome], list(kernels.SAMPLES.values()))
        self._arguments = estimator.law.number, self._samples.table, self._work.addresses.table
        self._unit, self._sign = model.unit_N, self.intake.sign
        self._theory_scale = model.theory_scale
        theory = config.theory
        self._ambient, self._default_pressure = theory.ambient_pressure, theory.default_pressure
        self._default_temperature = theory.default_temperature

    def _step(self, estimator: Estimator, learn: bool) -> Prediction:
        """Predict and learn from the one sample in the arrays."""
        if estimator.work is not self._work or estimator.config is not self._config:
            self._refresh(estimator)
        unit = self._unit
        velocity = self._velocity.item()
        friction = self._sign * self._friction.item()
        wavelet_rows(*self._rows)
        if self._curve is not None:
            pressure, temperature, _ = self._held[0].tolist()
            self._pressure[0] = pressure - self._ambient if isfinite(pressure) else self._default_pressure
            self._temperature[0] = temperature if isfinite(temperature) else self._default_temperature
            self._curve.loop(*self._curve_arguments)
            self._theory[0] = self._theory_scale * self._theory.item() / unit
        self._target[0] = friction / unit
        self._beyond[0] = 0.0 if self._low <= velocity <= self._high else self._model.beyond(self._velocity).item()
        self._learn[0] = learn
        if kernels.run(*self._arguments):
            estimator.grow()
        return (
            int(self._stamp.item()),
            velocity,
            friction,
            self._predicted.item() * unit,
            self._deviation.item() * unit,
        )

    @staticmethod
    def _several(estimator: Estimator, samples: Samples, learn: bool) -> list[Prediction]:
        """Take the way of replay."""
        if not len(samples):
            return []
        deviation = np.empty(len(samples))
        predicted = estimator.run(samples, learn, deviation)
        columns = (samples.stamp_ns, samples.velocity_m_s, samples.friction_N, predicted, deviation)
        return list(zip(*(column.tolist() for column in columns), strict=True))
