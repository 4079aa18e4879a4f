"""The estimator: model, law and state put together. Replay runs it over arrays, the live node over one sample."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.model.structure import CHUNK, Extension, Model, Parameters
from friction_estimator.core.online import kernels, workspace
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.online.relinearisation import Relinearisation
from friction_estimator.core.online.workspace import Workspace
from friction_estimator.core.sample import Bools, Floats, Samples
from friction_estimator.core.settings.config import PARAMETERS, Config

STATE_VERSION = 2

STRUCTURE = (
    "model.type",
    "model.law",
    "force_unit",
    "fir.order",
    "extension.terms",
    *(name for name in PARAMETERS if name.startswith("basis.")),
)
"""Settings that must agree between a state and the estimator that takes it."""

THEORY_STRUCTURE = ("theory.kind", "theory.table", *(name for name in PARAMETERS if name.startswith("seal.")))
"""The same for the parallel model, whose theory taps belong to one curve."""


@dataclass(frozen=True)
class Health:
    """What the estimator says about itself.

    Attributes
    ----------
    samples, learned : samples seen, and those learned from.
    guarded : steps that the divergence guard shortened or refused.
    clipped : errors that nlms or rls took for outliers and shortened.
    outside : samples outside the velocity range (nothing was learned from them).
    alarmed : abrupt changes of friction that rls noticed (it then learns afresh, from the present parameters).
    adopted : fits to the past from which rls went on.
    error_rms_N : running rms of the a priori error, N.
    """

    samples: int
    learned: int
    guarded: int
    clipped: int
    outside: int
    alarmed: int
    adopted: int
    error_rms_N: float


class Estimator:
    """Predict friction, then learn from the measurement, sample by sample.

    Parameters
    ----------
    config : with units set (see `derive.with_units`).
    extension : terms that a diagnosis added (see `effects`).

    Examples
    --------
    >>> config = Config.from_mapping({"basis.velocity_range": [-0.1, 0.1], "force_unit": 5.0})
    >>> estimator = Estimator(config)
    >>> round(estimator.step(stamp_ns=1, velocity_m_s=0.02, friction_N=4.0), 2) > 0  # the theory, before learning
    True
    """

    def __init__(self, config: Config, extension: Extension | None = None) -> None:
        self.config = config
        self.model = Model(config, extension)
        self.reset()

    def reset(self) -> None:
        """Forget what was learned and start from the configuration's values."""
        config, model = self.config, self.model
        law = LAWS[config.model.law]
        theta = model.initial_theta()
        prior = law.prior_variance(config, model.prior_deviation())
        covariance = prior if law.keeps_covariance else np.zeros(0)
        taps, _, theory_taps, _ = model.shape
        self.relinearisation = Relinearisation(model)
        kept, proposal, due = Relinearisation.arrays(model, config)
        status = np.zeros(workspace.STATUS_SIZE, np.int64)
        status[workspace.DUE] = due
        self._law_number = law.number
        self._work = Workspace(
            shape=model.shape.copy(),
            theta=theta,
            ring=np.zeros((taps, model.basis.size)),
            ring_theory=np.zeros(max(1, theory_taps)),
            root=np.diag(np.sqrt(covariance)),
            diagonal=covariance.copy(),
            prior=prior,
            law=law.constants(config),
            moments=np.array([1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0]),
            status=status,
            kept=kept,
            proposal=proposal,
        )
        if model.extension is not None:
            model.extension.restart()

    def run(self, samples: Samples, learn: Bools | bool = True) -> Floats:
        """Predict and learn over samples in order.

        Parameters
        ----------
        samples : admitted samples (finite velocity and friction).
        learn : (n,) or one value: where to learn after predicting.

        Returns
        -------
        (n,) float64, friction predicted before each measurement was used, N.
        """
        predicted = np.empty(len(samples))
        learns = np.broadcast_to(np.asarray(learn, np.bool_), (len(samples),))
        work = self._work
        for start in range(0, len(samples), CHUNK):
            part = slice(start, start + CHUNK)
            inputs = self.model.inputs(samples[part])
            work.status[workspace.OUTSIDE] += int(inputs.inside.size - np.count_nonzero(inputs.inside))
            arrays = (
                inputs.index,
                inputs.value,
                samples.velocity_m_s[part],
                inputs.theory,
                inputs.extension,
                inputs.target,
                inputs.restart,
                learns[part] & inputs.inside,
                predicted[part],
            )
            begin = 0
            while taken := kernels.run(self._law_number, *(array[begin:] for array in arrays), *work.arrays()):
                self.relinearisation.visit(work)
                begin += taken
        predicted *= self.config.force_unit
        return predicted

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
        self._work.law[:] = LAWS[self.config.model.law].constants(self.config)

    @property
    def parameters(self) -> Parameters:
        """The learned values."""
        return self.model.split(self._work.theta)

    @parameters.setter
    def parameters(self, values: Parameters) -> None:
        self._work.theta[:] = self.model.checked(values)
        self._work.status[workspace.PROPOSED] = 0  # what is proposed went on from other values

    @property
    def health(self) -> Health:
        """Counters and running error."""
        status = self._work.status
        return Health(
            samples=int(status[workspace.SEEN]),
            learned=int(status[workspace.LEARNED]),
            guarded=int(status[workspace.GUARDED]),
            clipped=int(status[workspace.CLIPPED]),
            outside=int(status[workspace.OUTSIDE]),
            alarmed=int(status[workspace.ALARMED]),
            adopted=int(status[workspace.ADOPTED]),
            error_rms_N=float(np.sqrt(self._work.moments[workspace.ERROR_POWER]) * self.config.force_unit),
        )

    def state(self) -> dict[str, Any]:
        """Return everything that the next prediction depends on: plain values and arrays, copied.

        The delay lines of extension terms are not part of it; they restart with the next sample.
        """
        self.relinearisation.settle(self._work)
        work = self._work.copy()
        return {
            "version": STATE_VERSION,
            "structure": {name: PARAMETERS[name].of(self.config) for name in self._structure()},
            "arrays": {f.name: getattr(work, f.name) for f in fields(work)},
        }

    def _structure(self) -> tuple[str, ...]:
        return STRUCTURE + (THEORY_STRUCTURE if self.config.model.type == "parallel" else ())

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a state; the estimator is unchanged if it does not fit.

        Raises ConfigError naming the setting or array that differs.
        """
        if state.get("version") != STATE_VERSION:
            raise ConfigError(
                f"state has version {state.get('version')}, this program reads {STATE_VERSION}: delete it to start cold"
            )
        for name in self._structure():
            theirs, ours = state["structure"].get(name), PARAMETERS[name].of(self.config)
            if _plain(theirs) != _plain(ours):
                raise ConfigError(f"state was learned with {name} = {theirs}, this estimator has {ours}")
        taken: dict[str, Any] = {}
        arrays: dict[str, Any] = dict(state["arrays"])
        kept, proposal, due = Relinearisation.arrays(self.model, self.config)
        fresh = {"kept": kept, "proposal": proposal}
        alike = all(np.asarray(arrays.get(name)).shape == array.shape for name, array in fresh.items())
        if not alike:  # rls.relinearise was switched: what was learned stays, what was kept starts afresh
            arrays |= fresh
        for item in fields(Workspace):
            ours = getattr(self._work, item.name)
            theirs = np.asarray(arrays.get(item.name))
            if theirs.shape != ours.shape or theirs.dtype != ours.dtype:
                raise ConfigError(
                    f"state array {item.name} is {theirs.dtype}{theirs.shape}, expected {ours.dtype}{ours.shape}"
                )
            if not np.all(np.isfinite(theirs)):
                raise ConfigError(f"state array {item.name} holds values that are not finite")
            taken[item.name] = theirs.copy()
        status = taken["status"]
        if not alike:
            status[workspace.KEPT :] = 0
            status[workspace.DUE] = due
        if np.any(np.delete(status, [workspace.SLOT, workspace.DIRECTION]) < 0) or not (
            -1 <= status[workspace.SLOT] < workspace.KEPT_BLOCKS
        ):
            raise ConfigError("state array status holds impossible counts")
        taken["shape"] = self._work.shape
        taken["law"] = self._work.law
        self._work = Workspace(**taken)
        self.relinearisation = Relinearisation(self.model)
        if self.model.extension is not None:
            self.model.extension.restart()


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
