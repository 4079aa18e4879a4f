"""One sample at a time without the cost of arrays: the live node's way through the same compiled kernels.

`Intake.push` and `Estimator.run` take arrays and spend, on arrays of one, ten times as long on checks, views and
small allocations as in the kernels. `LiveStep` calls the same kernels on arrays that it allocates once. The result is
that of `Intake.push` and `Estimator.run` bit for bit, which a test asserts; whatever is not the usual case (several
samples at once, a load, extension terms, a table for theory) goes through those two.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import types

from friction_estimator.compiled import entry
from friction_estimator.core.addresses import Addresses
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import HELD, Pairs
from friction_estimator.core.model.basis import WaveletBasis
from friction_estimator.core.model.structure import Model
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.model.theory_stribeck import StribeckCurve
from friction_estimator.core.online import kernels
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import FirstContact
from friction_estimator.core.online.single import (
    DEVIATION,
    PREDICTED,
    VELOCITY,
    events_table,
    receive,
    sample_table,
)
from friction_estimator.core.online.workspace import Workspace
from friction_estimator.core.sample import Samples, in_sequence
from friction_estimator.core.settings.config import Config

CAPACITY = 128
"""Events taken at once at the most."""

NOTHING = Addresses([], [])

Prediction = tuple[int, float, float, float, float]
"""Stamp (ns), velocity (m/s), measured friction (N), predicted friction (N), its standard deviation (N)."""


class Events:
    """Room for events: `stream`, `stamp_ns` and `value`, (CAPACITY,) each."""

    def __init__(self) -> None:
        self.stream = np.zeros(CAPACITY, np.int64)
        self.stamp_ns = np.zeros(CAPACITY, np.int64)
        self.value = np.zeros(CAPACITY)


@dataclass(frozen=True)
class _Connected:
    """A work space, the settings, and what the kernels take for one sample.

    Attributes
    ----------
    usual : whether samples can be taken alone; else the tables are empty.
    sample, batch : of `single` and of `kernels.run`.
    """

    work: Workspace
    config: Config
    usual: bool
    sample: Addresses
    batch: Addresses


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
        stamp, velocity, friction = np.zeros(CAPACITY, np.int64), np.zeros(CAPACITY), np.zeros(CAPACITY)
        held = np.zeros((CAPACITY, HELD + 1))
        self._out = stamp, velocity, friction, held
        self._stamp, self._velocity, self._friction, self._held = stamp[:1], velocity[:1], friction[:1], held[:1]
        self._status, self._restart = np.zeros(1, np.int8), np.zeros(1, np.bool_)
        self._position = np.full(1, np.nan)
        self._outcome = np.zeros(4)
        i, b = types.int64, types.boolean
        self._receive, self._predict = entry(receive, i, i, i, b, b), entry(kernels.run, i, i, i)
        self._now: _Connected | None = None
        self._ahead: _Connected | None = None
        self._sample, self._usual = NOTHING, False  # nothing is taken alone yet
        self._grows: Estimator | None = None
        self._connect(intake)
        if estimator is None and config.is_met:
            self.estimator = build(config)
        if self.estimator is None:
            self.contact = FirstContact(config)
        else:
            self._refresh(self.estimator)

    def retuned(self) -> None:
        """Notice that the intake was retuned."""
        self._now = self._ahead = None
        self._connect(self.intake)
        if self.estimator is not None:
            self._refresh(self.estimator)

    def _connect(self, intake: Intake) -> None:
        self.intake = intake
        pairing = intake.pairer.arguments(*self._out)
        admission = intake.sequencer.arguments(self._stamp, self._velocity, self._friction, self._status, self._restart)
        one = self._stamp, self._velocity, self._restart, self._position, np.zeros(1)
        unwrapping, carrying = intake.encoder.arguments(*one), intake.carried.arguments(*one)
        room = self.stream, self.stamp_ns, self.value
        self._events = events_table(room, pairing, admission, unwrapping, carrying)

    def run(self, count: int, *, learn: bool, most: int | None = None) -> list[Prediction]:
        """Take the first `count` events of `stream`, `stamp_ns`, `value`, in order of arrival.

        Parameters
        ----------
        most : predictions to return at the most where there is a backlog; the next calls go on with it.

        Returns
        -------
        The predictions of the samples that were completed and admitted; none while the first contact lasts.
        """
        if self._grows is not None:
            self._grow(self._grows)
        estimator, now = self.estimator, self._now
        if estimator is not None and (
            now is None or now.work is not estimator.work or now.config is not estimator.config
        ):
            self._refresh(estimator)
        alone = self._usual and most is None and not self.behind
        joined = self._receive(self._events.address, self._sample.address, count, alone, learn)
        if joined == 1 and alone:
            if self._predict(*self._arguments):
                self._grows = estimator
            velocity, friction, predicted, deviation = self._outcome.tolist()
            return [(self._stamp.item(), velocity, friction, predicted * self._unit, deviation * self._unit)]
        if joined <= 0:
            return self.work_off(most, learn=learn) if self.behind else []
        pairs = Pairs(*(a[:joined].copy() for a in self._out))  # type: ignore[arg-type]
        samples = self.intake.admit(pairs)
        if self.contact is not None:
            config = self.contact.push(samples)
            if config is None:
                return []
            self.begin(self._build(config))
        else:
            self._fall_behind(samples)
        return self.work_off(most, learn=learn)

    @property
    def settled(self) -> bool:
        """Whether nothing is to be done in the pause behind the last sample."""
        return self._grows is None and not (self.estimator and self.estimator.may_grow_soon)

    def settle(self) -> None:
        """Use the pause behind the last sample: for a range that grows, or is about to (`Estimator.prepare`).

        No prediction need wait for these milliseconds, and the results are those without this call: the next `run`
        makes up for it.
        """
        if self._grows is not None:
            self._grow(self._grows)
        elif self.estimator is not None and self.estimator.may_grow_soon:
            growth = self.estimator.prepare()
            if growth is not None and (self._ahead is None or self._ahead.work is not growth.larger):
                self._ahead = self._connected(growth.after, growth.larger, growth.config)

    def _grow(self, estimator: Estimator) -> None:
        """Let the range grow, as the last sample asked for it."""
        self._grows = None
        estimator.grow()
        self._refresh(estimator)

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
        now, self._ahead = self._ahead, None
        if now is None or now.work is not estimator.work or now.config is not estimator.config:
            now = self._connected(estimator.model, estimator.work, estimator.config)
        self._now = now
        self._sample, self._usual, self._unit = now.sample, now.usual, estimator.model.unit_N
        self._arguments = estimator.law.number, now.batch.address, estimator.work.addresses.address

    def _connected(self, model: Model, work: Workspace, config: Config) -> _Connected:
        """Return tables for one sample of a model."""
        basis, curve = model.basis, model.theory
        usual = (
            model.extension is None
            and self.intake.plain
            and isinstance(basis, WaveletBasis)
            and isinstance(curve, SealCurve | StribeckCurve | None)
        )
        if not isinstance(basis, WaveletBasis) or not usual:
            return _Connected(work, config, False, NOTHING, NOTHING)
        index, row, cell = np.zeros((1, basis.width), np.int32), np.zeros((1, basis.width)), np.zeros(1, np.int64)
        nothing = np.zeros((1, 0))
        given = config.theory
        settings = (
            self.intake.sign,
            model.unit_N,
            model.theory_scale,
            given.ambient_pressure,
            given.default_pressure,
            given.default_temperature,
        )
        velocity, predicted, deviation = (
            self._outcome[place : place + 1] for place in (VELOCITY, PREDICTED, DEVIATION)
        )
        shared: dict[str, Any] = {name: np.zeros(1) for name in ("theory", "target", "beyond")}
        shared["learn"] = np.zeros(1, np.bool_)
        sample = sample_table(
            basis.row_arguments(velocity, index, row, cell),
            curve if isinstance(curve, SealCurve | StribeckCurve) else None,
            settings,
            paired_velocity=self._velocity,
            paired_friction=self._friction,
            held=self._held,
            outcome=self._outcome,
            **shared,
        )
        batch = kernels.SAMPLES.addresses(
            index=index,
            value=row,
            cell=cell,
            velocity=velocity,
            position=self._position,
            extension=nothing,
            column_noise=nothing,
            column_doubt=nothing,
            known=nothing,
            restart=self._restart,
            predicted=predicted,
            deviation=deviation,
            **shared,
        )
        return _Connected(work, config, True, sample, batch)

    @staticmethod
    def _several(estimator: Estimator, samples: Samples, learn: bool) -> list[Prediction]:
        """Take the way of replay."""
        if not len(samples):
            return []
        deviation = np.empty(len(samples))
        predicted = estimator.run(samples, learn, deviation)
        columns = (samples.stamp_ns, samples.velocity_m_s, samples.friction_N, predicted, deviation)
        return list(zip(*(column.tolist() for column in columns), strict=True))
