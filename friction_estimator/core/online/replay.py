"""The estimator over a recording, and the figures that `replay` reports."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_estimator.core import metrics
from friction_estimator.core.errors import ConfigError, UnanswerableError
from friction_estimator.core.model.structure import Extension, Model, Parameters
from friction_estimator.core.online.estimator import Estimator, Health
from friction_estimator.core.sample import Bools, Floats, Samples
from friction_estimator.core.settings.config import Config

BLOCK = 65536
"""Samples between two reports of progress, and between two snapshots of the parameters at the most."""

SNAPSHOTS = 200
"""Parameter snapshots kept over a replay."""

DIVERGED = 2.0
"""An error rms over the last fifth above this many standard deviations of the whole record is divergence."""


@dataclass(frozen=True)
class Replay:
    """A recording with what the estimator made of it.

    Attributes
    ----------
    config : the configuration that was run, units filled in.
    samples : the admitted samples.
    predicted_N : (n,), friction predicted before each measurement was used.
    theory_N : (n,), the theoretical curve at the samples; None for Hammerstein.
    learned : (n,), where the estimator was allowed to learn.
    snapshot_stamp_ns : (k,) and snapshots : the parameters after the sample of that stamp.
    health : the estimator's own counters.
    seconds : wall-clock time of prediction and learning.
    """

    config: Config
    samples: Samples
    predicted_N: Floats
    theory_N: Floats | None
    learned: Bools
    snapshot_stamp_ns: list[int]
    snapshots: list[Parameters]
    health: Health
    seconds: float
    estimator: Estimator

    @property
    def parameters(self) -> Parameters:
        """The values learned at the end."""
        return self.estimator.parameters

    @property
    def residual_N(self) -> Floats:
        """Measured minus predicted, (n,), N."""
        return self.samples.friction_N - self.predicted_N

    def figures(self) -> dict[str, Any]:
        """Return the figures of merit of `replay --json` (INTERFACE names)."""
        measured, predicted = self.samples.friction_N, self.predicted_N
        last = slice(len(self.samples) - max(2, len(self.samples) // 5), None)
        final = metrics.nrmse(measured[last], predicted[last])
        end_rms = float(np.sqrt(np.mean(np.square(self.residual_N[last]))))
        frozen = ~self.learned
        theory = None if self.theory_N is None else metrics.nrmse(measured, self.theory_N)
        return {
            "sample_rate_hz": self.samples.sample_rate_hz,
            "duration_s": self.samples.duration_s,
            "nrmse": metrics.nrmse(measured, predicted),
            "nrmse_persistence": metrics.nrmse_persistence(measured, self.samples.restart),
            "nrmse_final": final,
            "nrmse_by_cycle": metrics.by_cycle(measured, predicted, self.samples.velocity_m_s),
            "nrmse_frozen": metrics.nrmse(measured[frozen], predicted[frozen]) if frozen.any() else None,
            "fit_percent": 100.0 * (1.0 - final),
            "theory_nrmse": theory,
            "diverged": bool(not np.isfinite(predicted).all() or end_rms > DIVERGED * metrics.spread(measured)),
            "samples_per_second": len(self.samples) / self.seconds if self.seconds > 0.0 else None,
            "parameters": parameters_of(self.estimator.model, self.parameters),
        }


def replay(
    samples: Samples,
    config: Config,
    *,
    extension: Extension | None = None,
    freeze_after: float | None = None,
    advance: Callable[[int], None] = lambda _: None,
) -> Replay:
    """Run the estimator over samples in order.

    Parameters
    ----------
    config : with units set (see `derive.with_recorded_units`).
    freeze_after : learn on this fraction of the samples only, (0, 1]; None learns throughout.
    advance : told the number of samples just done.

    Raises
    ------
    UnanswerableError : fewer than two samples, or constant friction.
    ConfigError : `freeze_after` outside (0, 1].
    """
    check_answerable(samples)
    n = len(samples)
    if freeze_after is not None and not 0.0 < freeze_after <= 1.0:
        raise ConfigError(
            f"freeze-after is {freeze_after:g}: give the fraction of the record to learn on, above 0 to 1"
        )
    learn = np.full(n, config.model.adapt)
    if freeze_after is not None:
        learn[round(freeze_after * n) :] = False
    estimator = Estimator(config, extension)
    predicted = np.empty(n)
    stamps, snapshots = [], []
    seconds = 0.0
    block = min(BLOCK, max(1, n // SNAPSHOTS))
    for start in range(0, n, block):
        part = slice(start, min(start + block, n))
        begin = time.perf_counter()
        predicted[part] = estimator.run(samples[part], learn[part])
        seconds += time.perf_counter() - begin
        stamps.append(int(samples.stamp_ns[part.stop - 1]))
        snapshots.append(estimator.parameters)
        advance(part.stop - part.start)
    parallel = config.model.type == "parallel"
    return Replay(
        config=config,
        samples=samples,
        predicted_N=predicted,
        theory_N=estimator.model.theoretical_friction(samples) if parallel else None,
        learned=learn,
        snapshot_stamp_ns=stamps,
        snapshots=snapshots,
        health=estimator.health,
        seconds=seconds,
        estimator=estimator,
    )


def check_answerable(samples: Samples) -> None:
    """Raise UnanswerableError where no figure of merit exists: fewer than two samples, or constant friction."""
    if len(samples) < 2:
        raise UnanswerableError(f"{len(samples)} usable samples: at least two are needed")
    if not metrics.spread(samples.friction_N) > 0.0:
        raise UnanswerableError(
            f"friction is constant at {samples.friction_N[0]:g} N in all {len(samples)} samples: there is nothing to "
            "predict; is it the right topic, axis or joint?"
        )


def parameters_of(model: Model, parameters: Parameters) -> dict[str, Any]:
    """Return learned values and the basis that they belong to, as JSON has them."""
    config = model.config
    return {
        "fir_taps": parameters.fir_taps,
        "theory_taps": parameters.theory_taps if parameters.theory_taps.size else None,
        "wavelet_weights": parameters.wavelet_weights,
        "extension_weights": parameters.extension_weights if parameters.extension_weights.size else None,
        "force_unit_N": config.force_unit,
        "basis": {
            "wavelet": config.basis.wavelet,
            "finest_level": config.basis.finest_level,
            "coarsest_level": config.basis.coarsest_level,
            "velocity_range_m_s": config.basis.velocity_range,
            "velocity_unit_m_s": model.basis.unit,
            "companding": config.basis.companding,
        },
    }


def with_learned(config: Config, parameters: Parameters) -> Config:
    """Return the configuration that starts warm from these values."""
    learned: Mapping[str, object] = {
        "learned.fir_taps": parameters.fir_taps,
        "learned.theory_taps": parameters.theory_taps,
        "learned.wavelet_weights": parameters.wavelet_weights,
        "learned.extension_weights": parameters.extension_weights,
    }
    return config.updated(learned)
