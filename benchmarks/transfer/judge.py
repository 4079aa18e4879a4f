"""Learning, freezing and scoring, the same in every part."""

import copy

import numpy as np

from friction_estimator.core.fit.baselines import fit_baselines, scores
from friction_estimator.core.fit.batch import BatchFit, fit_batch, predict
from friction_estimator.core.metrics import nrmse, settled
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import chosen, meet
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config

MODELS = ("parallel", "hammerstein")
DEFAULT = "parallel"
STATIC = ("coulomb_viscous", "stribeck", "stribeck_asymmetric")
"""The curves of whose test errors the least is called static."""

NORMAL_95 = 1.96


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def config_of(model: str, law: str = "rls") -> Config:
    return Config.from_mapping({"model.type": model, "model.law": law})


def learned(samples: Samples, config: Config) -> tuple[Estimator, np.ndarray]:
    """Learn as the node does: first contact, then sample by sample; return the estimator and what it predicted."""
    contact = meet(config, samples)
    assert not contact.dropped
    estimator = Estimator(contact.config)
    return estimator, estimator.run(samples)


def fitted(samples: Samples, config: Config, use=True) -> BatchFit:
    """Fit as `identify` does, the first samples or all: range, units and theory from those that are fitted."""
    known = np.broadcast_to(use, (len(samples),))
    units = chosen(config, samples[: int(known.sum())])
    return fit_batch(samples, units, use=use)


def frozen(model, test: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Return prediction and its standard deviation, (n,) N each, without learning; `model` stays as it is.

    A batch fit has no deviation of a prediction: that of its static curve at the sample's velocity stands in.
    """
    if isinstance(model, BatchFit):
        predicted = predict(test, model.model.config, model.parameters)
        velocity = np.linspace(test.velocity_m_s.min(), test.velocity_m_s.max(), 801)
        curve = model.curve(test, velocity)
        half = np.interp(test.velocity_m_s, velocity, 0.5 * (curve.high_N - curve.low_N))
        return predicted, half / NORMAL_95
    judged = copy.copy(model)
    judged.work = model.work.copy()
    deviation = np.empty(len(test))
    return judged.run(test, False, deviation), deviation


def scored(samples: Samples, config: Config) -> np.ndarray:
    """Return the samples that count: those whose delay lines measurement has filled, (n,)."""
    return settled(samples.restart, config.fir.order)


def static_error(curves, test: Samples, use) -> tuple[str, float]:
    """Return the textbook's curve of least test error and that error."""
    errors = scores({name: curves[name] for name in STATIC}, test.velocity_m_s[use], test.friction_N[use])
    best = min(errors, key=errors.__getitem__)
    return best, errors[best]


def covered(error, deviation) -> float:
    """Return the share of errors inside the 95 % band."""
    return float(np.mean(np.abs(error) <= NORMAL_95 * deviation))


def both_fits(train: Samples, model: str) -> dict:
    """Return what rls (live) and identify (batch) learn from the same samples."""
    config = config_of(model)
    return {"rls": learned(train, config)[0], "identify": fitted(train, config)}


__all__ = [
    "DEFAULT", "MODELS", "NORMAL_95", "both_fits", "config_of", "covered", "fit_baselines", "fitted", "frozen",
    "learned", "nrmse", "rms", "scored", "static_error",
]  # fmt: skip
