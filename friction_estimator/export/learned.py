"""A learned model that learns no more, and the recording that its simplifications are judged on."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from friction_estimator.core import metrics
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.fit.band import Curve
from friction_estimator.core.intake.standstill import standstill
from friction_estimator.core.model.structure import Extension, Parameters
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.quantities import FORCE, Quantities
from friction_estimator.core.sample import Bools, Floats, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.text import LONGEST_NAME, shown


@dataclass(frozen=True)
class Learned:
    """What was learned from a drive.

    Parameters
    ----------
    source : where it stands, for the text of the export.
    config : with range, units and learned values.
    extension : terms of `extension.terms`.
    curve : static curve with its band as it was when learning ended; None where it was not kept.
    samples : of the recordings to be judged on; None where there are none.
    recordings : their names.

    Raises
    ------
    ConfigError : nothing was learned, or range or unit are missing.
    """

    source: str
    config: Config
    extension: Extension | None = None
    curve: Curve | None = None
    samples: Samples | None = None
    recordings: Sequence[str] = ()

    def __post_init__(self) -> None:
        if not self.config.learned.wavelet_weights or not self.config.is_met:
            raise ConfigError(
                f"{self.source} holds no learned model: give the folder that replay or identify wrote with --out, "
                "its config.yaml, or the parameters that a running node dumped"
            )

    @property
    def name(self) -> str:
        """`source` for the text of an export: printable, in one line."""
        return shown(self.source, LONGEST_NAME)

    @property
    def quantities(self) -> Quantities:
        """What the drive's numbers are."""
        return self.config.quantities

    @property
    def recording_names(self) -> str:
        """The recordings' names, printable."""
        return ", ".join(shown(name, LONGEST_NAME) for name in self.recordings)

    @cached_property
    def estimator(self) -> Estimator:
        """The estimator with the learned values."""
        return Estimator(self.config, self.extension)

    @property
    def parameters(self) -> Parameters:
        """The learned values."""
        return self.estimator.parameters

    @property
    def spacing_s(self) -> float | None:
        """Median time between samples of the recording, s: that of the taps; None without a recording."""
        return None if self.samples is None else 1.0 / self.samples.sample_rate_hz

    def static_curve(self) -> Curve:
        """Return the static curve: with its band where it was kept, else with NaN for it."""
        if self.curve is not None:
            return self.curve
        bare = self.estimator.curve(self.samples)
        unknown = np.full(bare.velocity_m_s.size, np.nan)
        return Curve(
            bare.velocity_m_s, bare.friction_N, unknown, unknown, None, bare.pressure_Pa, bare.temperature_degC
        )

    @cached_property
    def predicted_N(self) -> Floats:
        """Prediction of the whole model over the recording without learning, (n,), N."""
        assert self.samples is not None
        if self.extension is not None:
            self.extension.restart()
        return Estimator(self.config, self.extension).run(self.samples, learn=False)

    @cached_property
    def judged(self) -> Bools:
        """Samples that count, (n,): in motion, and late enough for the model's memory to be filled.

        At rest friction is whatever holds the shaft, up to breakaway: no curve can be wrong there.
        """
        assert self.samples is not None
        moving = ~standstill(self.samples, self.config.velocity_scale)
        return np.asarray(moving & metrics.settled(self.samples.restart, self.config.fir.order))

    def error_rms_N(self, predicted_N: Floats) -> float:
        """Return the rms error of a prediction (n,) over the samples that count, N."""
        assert self.samples is not None
        error = (self.samples.friction_N - predicted_N)[self.judged]
        return float(np.sqrt(np.mean(np.square(error))))

    def static_error_rms_N(self) -> float:
        """Return the rms error of the static curve, interpolated linearly and held at its ends, N."""
        assert self.samples is not None
        curve = self.static_curve()
        return self.error_rms_N(np.interp(self.samples.velocity_m_s, curve.velocity_m_s, curve.friction_N))

    def cost(self, error_rms_N: float | None) -> list[str]:
        """Return the lines that say what an export costs, for its comment."""
        if self.samples is None or error_rms_N is None:
            return ["Error on a recording: not measured (none was given)."]
        whole = self.error_rms_N(self.predicted_N)
        spread = metrics.spread(self.samples.friction_N[self.judged])
        told = self.quantities.text
        return [
            f"Error over {int(np.count_nonzero(self.judged))} samples in motion of {self.recording_names}, rms:",
            f"this file {told(error_rms_N, FORCE)}, the whole model without learning {told(whole, FORCE)}; "
            f"friction itself varies by {told(spread, FORCE)}.",
        ]
