"""The estimator: model, law and state put together. Replay runs it over arrays, the live node over one sample."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.fit.band import POWER, PRODUCT, Curve, median_conditions, static_curve
from friction_estimator.core.fit.load_report import LearnedLoad, learned_loads
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.model.structure import CHUNK, LEARNED, Extension, Model, Parameters
from friction_estimator.core.online import kernels, recovery, state_check, workspace
from friction_estimator.core.online.adaptation import LAWS, constants
from friction_estimator.core.online.growth import Growth, cold_start, next_growth
from friction_estimator.core.online.larger_unit import in_larger_units, units_too_small
from friction_estimator.core.online.workspace import Workspace
from friction_estimator.core.sample import Bools, Floats, Samples
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.core.settings.setting import Value
from friction_estimator.core.settings.units import CHOSEN_UNITS, with_units_of
from friction_estimator.core.text import LONGEST_NAME, shown

STATE_VERSION = 5

STATE_WITHOUT_THEORY = 4
"""A former version, which is read too: nothing is said of the theoretical curve but its kind."""

STATE_WITHOUT_KEPT = 3
"""The one before: no models kept aside either, and three more moments of an alarm that is no more."""

SINCE_THE_LOAD = ("load.terms", "load.half_width")
"""Settings that states from before there were loads do not name: those were learned without."""

STRUCTURE = (
    "model.type",
    "model.law",
    "force_unit",
    "fir.order",
    "extension.terms",
    *SINCE_THE_LOAD,
    *(name for name in PARAMETERS if name.startswith(("basis.", "prior."))),
)
"""Settings that must agree between a state and the estimator that takes it."""

THEORY_STRUCTURE = (
    "theory.kind",
    "theory.table",
    *(name for name in PARAMETERS if name.startswith(("seal.", "stribeck."))),
)
"""The same for the parallel model, whose theory taps belong to one curve."""

CHOSEN = (*CHOSEN_UNITS, "learned.theory", "learned.stribeck")
"""What the first contact chose: a state brings its own."""


@dataclass(frozen=True)
class Health:
    """What the estimator says about itself.

    Attributes
    ----------
    samples, learned : samples seen, and those learned from.
    guarded : steps that the divergence guard shortened or refused.
    clipped : errors that nlms or rls took for outliers and shortened.
    outside : samples outside the velocity range (nothing was learned from them).
    alarmed : times that errors far beyond the usual held learning: bad data, or friction had changed.
    grown : times that the velocity range grew.
    stood : samples at standstill (nothing was learned from them: a stuck shaft shows no friction of motion).
    held : samples since learning is held, 0 while it is not: the model from before the alarm predicts, while the
        samples decide whether they were bad or friction has changed (`recovery`).
    restored : alarms after which the model from before went on, as if the samples between had not been.
    error_rms_N : running rms of the a priori error, N.
    """

    samples: int
    learned: int
    guarded: int
    clipped: int
    outside: int
    alarmed: int
    grown: int
    stood: int
    held: int
    restored: int
    error_rms_N: float


class Estimator:
    """Predict friction, then learn from the measurement, sample by sample.

    Parameters
    ----------
    config : with range and units known (`Config.is_met`; see `settings.units`).
    extension : terms that a diagnosis added (see `effects`).

    Attributes
    ----------
    config : with the velocity range as it has grown.
    model : of the present range.

    Examples
    --------
    >>> known = {"basis.velocity_range": [-0.1, 0.1], "force_unit": 5.0, "theory.kind": "seal"}
    >>> config = Config.from_mapping(known)
    >>> estimator = Estimator(config)
    >>> round(estimator.step(stamp_ns=1, velocity_m_s=0.02, friction_N=4.0), 2) > 0  # the theory, before learning
    True
    """

    def __init__(self, config: Config, extension: Extension | None = None) -> None:
        self.config = config
        self.model = Model(config, extension)
        self.law = LAWS[config.model.law]
        self._prior = Prior.of(self.model)
        self._growth: Growth | None = None
        self.work = self._cold()

    def _cold(self) -> Workspace:
        if self.model.extension is not None:
            self.model.extension.restart()
        metric, given = self.law.metric(self._prior), constants(self.law, self.config, self.model.basis)
        return cold_start(self.model, self._prior, metric, self.law.keeps_covariance, given)

    def run(self, samples: Samples, learn: Bools | bool = True, deviation: Floats | None = None) -> Floats:
        """Predict and learn over samples in order.

        Parameters
        ----------
        samples : admitted samples (finite velocity and friction).
        learn : (n,) or one value: where to learn after predicting.
        deviation : (n,), filled with the standard deviation of each prediction, N, where given.

        Returns
        -------
        (n,) float64, friction predicted before each measurement was used, N.
        """
        predicted = np.empty(len(samples))
        spread = np.empty(len(samples)) if deviation is None else deviation
        # An array of its own: numba takes a broadcast view for another type, and a running node would compile anew.
        learns = np.array(np.broadcast_to(np.asarray(learn, np.bool_), (len(samples),)))
        for start in range(0, len(samples), CHUNK):
            chunk = samples[start : start + CHUNK]
            theory = self.model.theoretical_friction(chunk)
            columns = self.model.extension_columns(chunk, theory)
            done = 0
            while done < len(chunk):
                rest = slice(done, None)
                here = slice(start + done, start + len(chunk))
                inputs = self.model.inputs(chunk[rest], theory[rest], columns[rest])
                batch = kernels.batch(inputs, chunk[rest], learns[here], predicted[here], spread[here])
                taken = kernels.run(self.law.number, batch.address, self.work.addresses.address)
                ready = slice(here.start, here.start + taken if taken else here.stop)
                predicted[ready] *= self.model.unit_N
                spread[ready] *= self.model.unit_N
                if not taken:
                    break
                if self.grow():
                    theory = self.model.theoretical_friction(chunk)
                done += taken
        return predicted

    @property
    def may_grow_soon(self) -> bool:
        """Whether samples in a row beyond an edge have said how far the range has to reach if more of them follow."""
        status = self.work.status
        return abs(status.item(workspace.BEYOND)) >= kernels.DECIDED_AFTER and status.item(workspace.MAY_GROW) == 1

    def prepare(self) -> Growth | None:
        """Make a part of the growth that may come: a third of a millisecond with a hundred parameters.

        For pauses between samples; the results are those without any of these calls. Returns the growth when all of
        it is made.
        """
        under_way = self._growth
        self._growth = self._next_growth()
        if self._growth is None or self._growth is not under_way:  # the first pause has made its model
            return None
        return None if self._growth.prepare() else self._growth

    def _next_growth(self) -> Growth | None:
        return next_growth(self.model, self.work, self.config, self.law, self._growth)

    def grow(self) -> bool:
        """Let the range reach the first velocities in a row beyond its edge; too large a basis stays as it is.

        Returns
        -------
        Whether the force unit rose with it (`larger_unit`); the theory's scale may then be another, too.
        """
        growth, self._growth = self._next_growth(), None
        status = self.work.status
        status[workspace.BEYOND] = 0
        if growth is None:
            status[workspace.MAY_GROW] = 0
            return False
        status[workspace.GROWN] += 1
        self.model, self._prior, self.work, self.config = growth.after, growth.prior, growth.done(), growth.config
        rise = 1.0 if self.config.force_unit > 0.0 else units_too_small(self.work)
        if rise > 1.0:
            self._raise_unit(rise)
        return rise > 1.0

    def _raise_unit(self, rise: float) -> None:
        """Raise the force unit by this factor."""
        before = self.model
        self.model = Model(before.config.updated({"learned.force_unit": rise * before.unit_N}), before.extension)
        self._prior = Prior.of(self.model)
        self.work = in_larger_units(self.work, before, self.model, self._prior)
        self.config = with_units_of(self.config, self.model.config)
        self.work.law[:] = constants(self.law, self.config, self.model.basis)

    def step(
        self,
        stamp_ns: int,
        velocity_m_s: float,
        friction_N: float,
        *,
        pressure_Pa: float = float("nan"),
        temperature_degC: float = float("nan"),
        position_m: float = float("nan"),
        restart: bool = False,
        learn: bool = True,
    ) -> float:
        """Predict the friction of one sample (N), then learn from it; `run` over arrays of one."""
        samples = Samples(
            stamp_ns=np.array([stamp_ns], np.int64),
            velocity_m_s=np.array([velocity_m_s]),
            friction_N=np.array([friction_N]),
            restart=np.array([restart]),
            pressure_Pa=np.array([pressure_Pa]),
            temperature_degC=np.array([temperature_degC]),
            position_m=np.array([position_m]),
        )
        return float(self.run(samples, learn)[0])

    def retune(self, config: Config) -> None:
        """Take over the live settings of `config` (step sizes, forgetting); what was learned stays.

        Settings that are not live are kept as they are until an estimator is built anew.
        """
        live = {name: item.of(config) for name, item in PARAMETERS.items() if item.live and not item.learned}
        self.config = self.config.updated(live)
        self.work.law[:] = constants(self.law, self.config, self.model.basis)

    @property
    def _predicting(self) -> tuple[Floats, Floats, Floats]:
        """Parameters, root of the covariance and running errors of the model that predicts: the held one in a hold."""
        work = self.work
        if not work.hold[workspace.HOLDING]:
            return work.theta, work.root, work.errors
        held = recovery.Kept.of(work.kept[recovery.HELD], work)
        # Nobody knows yet whether this is still the friction: the curve may be off by the present errors anywhere.
        errors = held.errors.copy()
        errors[:, [POWER, PRODUCT]] += work.hold[workspace.HELD_POWER]
        return held.theta, work.kept_root[recovery.HELD], errors

    @property
    def parameters(self) -> Parameters:
        """The learned values; while learning is held, those from before the alarm."""
        return self.model.split(self._predicting[0])

    @parameters.setter
    def parameters(self, values: Parameters) -> None:
        self.work.theta[:] = self.model.checked(values)
        self._growth = None  # it was to carry other values over
        for array in (self.work.kept, self.work.kept_root, self.work.trial, self.work.hold):
            array[:] = 0.0  # what was kept aside belongs to other values

    @property
    def learned_config(self) -> Config:
        """The configuration that starts warm from here: range, units and parameters as they are."""
        values = self.parameters
        return self.config.updated({f"learned.{name}": getattr(values, name) for name in LEARNED})

    @property
    def covariance(self) -> Floats | None:
        """Posterior covariance of the parameters, (n, n), normalised units; None for laws that keep none."""
        if not self.law.keeps_covariance:
            return None
        root = self._predicting[1]
        return np.asarray(self._prior.residual_variance * (root @ root.T))

    def snapshot(self) -> "Estimator":
        """Return what this one is now, to be read while it goes on: for curve, state and health, not for samples."""
        taken = copy.copy(self)
        taken.work = self.work.copy()
        return taken

    def predicting(self) -> "Estimator":
        """Return what predicts now, to draw its curve while this one goes on: a part of `snapshot`, in less time."""
        theta, root, errors = self._predicting
        taken = copy.copy(self)
        taken.work = replace(
            self.work, theta=theta.copy(), root=root.copy(), errors=errors.copy(), hold=np.zeros_like(self.work.hold)
        )
        return taken

    def curve(self, samples: Samples | None = None, velocity_m_s: Floats | None = None) -> Curve:
        """Return the static curve with its band.

        Parameters
        ----------
        samples : whose median pressure and temperature the curve holds for; the configured defaults without any.
        velocity_m_s : (m,), where; 401 evenly over the learned velocities unless given.
        """
        conditions = median_conditions(self.model, samples)
        theta, root, errors = self._predicting

        def spread(gradient: Floats) -> Floats:  # without the covariance itself, whose product costs n^3
            return np.asarray(self._prior.residual_variance * np.sum(np.square(gradient @ root), axis=1))

        known = spread if self.law.keeps_covariance else None
        return static_curve(self.model, theta, errors, known, self._prior, conditions, velocity_m_s)

    @property
    def loads(self) -> list[LearnedLoad]:
        """What is learned of the unknown load terms."""
        if not self.model.load.size:
            return []
        work, model, moments = self.work, recovery.PRESENT, self.work.moments
        if work.hold[workspace.HOLDING]:
            model, moments = recovery.HELD, recovery.Kept.of(work.kept[recovery.HELD], work).moments
        weight = float(moments[workspace.ABSORBED]) / self._prior.residual_variance
        misfit = float(np.sqrt(work.residual[model]))
        return learned_loads(self.model, self._predicting[0], self.covariance, weight, misfit)

    @property
    def health(self) -> Health:
        """Counters and running error."""
        status, hold = self.work.status, self.work.hold
        holds = bool(hold[workspace.HOLDING])
        power = hold[workspace.HELD_POWER] if holds else self.work.moments[workspace.ERROR_POWER]
        return Health(
            samples=int(status[workspace.SEEN]),
            learned=int(status[workspace.LEARNED]),
            guarded=int(status[workspace.GUARDED]),
            clipped=int(status[workspace.CLIPPED]),
            outside=int(status[workspace.OUTSIDE]),
            alarmed=int(status[workspace.ALARMED]),
            grown=int(status[workspace.GROWN]),
            stood=int(status[workspace.STOOD]),
            held=1 + int(hold[workspace.HELD_SINCE]) if holds else 0,
            restored=int(hold[workspace.RESTORED]),
            error_rms_N=float(np.sqrt(power) * self.model.unit_N),
        )

    def state(self) -> dict[str, Any]:
        """Return everything that the next prediction depends on: plain values and arrays, copied.

        The delay lines of extension terms are not part of it; they restart with the next sample.
        """
        work = self.work.copy()
        if not recovery.roots_in_use(work):
            work = replace(work, kept_root=work.kept_root[:0])
        return {
            "version": STATE_VERSION,
            "structure": {name: structural(self.config, name) for name in self._structure()},
            "chosen": {name: PARAMETERS[name].of(self.config) for name in CHOSEN},
            "arrays": {
                name: np.ascontiguousarray(getattr(work, name))
                for name in workspace.NAMES
                if name not in workspace.CONSTANTS
            },
        }

    def check_state(self) -> None:
        """Raise ConfigError where the state has come to hold what `restore` would refuse."""
        state_check.check(self.work)

    def _structure(self) -> tuple[str, ...]:
        return STRUCTURE + (THEORY_STRUCTURE if self.config.is_parallel else ())

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a state, with the range and units that it was learned in; unchanged if it does not fit.

        Raises ConfigError naming the setting or array that differs, or the array that is not sound (`state_check`).
        """
        config = stated_config(self.config, state)
        for name in self._structure():
            item = PARAMETERS[name]
            # A former version knows no stribeck.*: what is the default now.
            former = name.startswith("stribeck.") and state["version"] != STATE_VERSION
            unknown = item.default if former or name in SINCE_THE_LOAD else None
            theirs, ours = state["structure"].get(name, unknown), structural(config, name)
            if _plain(theirs) != _plain(ours):
                told = shown(theirs, LONGEST_NAME)
                raise ConfigError(f"state was learned with {name} = {told}, this estimator has {ours}")
        extension = self.model.extension
        arrays = state_check.arrays_of(state, Model(config, extension), self.law.keeps_covariance)
        other = Estimator(config, extension)
        if state["version"] == STATE_WITHOUT_KEPT:
            arrays = state_check.with_nothing_kept(arrays, other.work)
        # Former versions kept neither: some sixty samples' worth of noise; for the errors the robust mean is next best.
        state_check.take_over(other.work, {"noise": other.work.noise, "residual": other.work.residual, **arrays})
        if "residual" not in arrays:
            models = (recovery.Kept.of(row, other.work).moments for row in other.work.kept)
            other.work.residual[:] = [each[workspace.MISFIT_POWER] for each in (*models, other.work.moments)]
        self.config, self.model, self._prior, self.work = other.config, other.model, other._prior, other.work


def stated_config(config: Config, state: Mapping[str, Any]) -> Config:
    """Return `config` with the range and units that a state was learned in.

    Raises ConfigError for a state of another version, or one that names no range.
    """
    version = state.get("version")
    if version not in (STATE_VERSION, STATE_WITHOUT_THEORY, STATE_WITHOUT_KEPT):
        raise ConfigError(
            f"state has version {shown(version, LONGEST_NAME)}, this program reads {STATE_VERSION}: "
            "delete it to start cold"
        )
    chosen, structure = state.get("chosen"), state.get("structure")
    names = CHOSEN if version == STATE_VERSION else CHOSEN_UNITS
    if not isinstance(chosen, Mapping) or not isinstance(structure, Mapping) or set(chosen) != set(names):
        raise ConfigError("state does not say which range and units it was learned in: delete it to start cold")
    nothing: dict[str, Any] = dict.fromkeys(LEARNED, ())
    learned = replace(config.learned, **nothing)
    if version != STATE_VERSION and structure.get("theory.kind") == "seal":
        learned = replace(learned, theory="seal")
    return replace(config, learned=learned).updated(chosen)


def structural(config: Config, name: str) -> Value:
    """Return a setting that a state depends on; of the theoretical curve, what auto has come to."""
    return config.theory_kind if name == "theory.kind" else PARAMETERS[name].of(config)


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
