"""What is measured of the sample loops: a record, and bodies that run over it."""

import shutil
from collections.abc import Callable

import numpy as np
from in_c import InC

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.online import kernels
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import chosen
from friction_estimator.core.online.live import LiveStep
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config

LAWS, MODELS = ("lms", "nlms", "rls"), ("hammerstein", "parallel")

COMPILER = shutil.which("cc")
"""Where there is none, nothing stands beside C."""

Body = Callable[[], object]


def record(n: int) -> Samples:
    """A sine drive at 1 kHz with a Stribeck-like friction and 1 % noise."""
    rng = np.random.default_rng(1)
    v = 0.025 * np.cos(2 * np.pi * 0.2 * np.arange(n) / 1000.0)
    f = np.tanh(v / 0.002) * (1.0 + 4.0 * np.exp(-np.abs(v) / 0.005))
    restart = np.zeros(n, np.bool_)
    restart[0] = True
    return Samples(1 + np.arange(n, dtype=np.int64) * 1_000_000, v, f + 0.02 * rng.standard_normal(n), restart)


def estimator(samples: Samples, model: str, law: str, **settings: object) -> Estimator:
    config = Config.from_mapping({"model.type": model, "model.law": law} | settings)
    return Estimator(chosen(config, samples))


def loop_of(est: Estimator, samples: Samples) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
    """Return the compiled loop alone, from the start, on rows and theory made before."""
    inputs, n = est.model.inputs(samples), len(samples)
    predicted, deviation = np.empty(n), np.empty(n)
    batch = kernels.batch(inputs, samples, inputs.inside, predicted, deviation)

    def body() -> tuple[np.ndarray, np.ndarray]:
        work = est.work.copy()
        kernels.run(est.law.number, batch.address, work.addresses.address)
        return work.theta, predicted

    return body


def c_of(library: object, est: Estimator, samples: Samples) -> InC:
    return InC(library, est, est.model.inputs(samples), samples.velocity_m_s)


def live_of(est: Estimator, samples: Samples) -> Body:
    """Return a body that hands over sample by sample as the node does, at stamps that go on from call to call."""
    step = LiveStep(Intake(est.config), est.config, estimator=est)
    velocity, friction = samples.velocity_m_s.tolist(), samples.friction_N.tolist()
    now = 10**15

    def body() -> None:
        nonlocal now
        for v, f in zip(velocity, friction, strict=True):
            now += 1_000_000
            step.stream[0], step.stream[1] = 0, 1
            step.stamp_ns[0] = step.stamp_ns[1] = now
            step.value[0], step.value[1] = v, f
            assert len(step.run(2, learn=True)) == 1

    return body
