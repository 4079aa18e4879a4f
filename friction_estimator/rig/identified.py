"""An identified model as the plant: what was learned from a rig, driven along another schedule."""

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.model.structure import Extension
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import Floats, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.effects.trace import Trace


class IdentifiedPlant:
    """The friction law f = H1 d + H2 g + terms with the learned values of a configuration, learning nothing.

    The model lives at the recording's rate: between its samples the friction is linear. It has no film of its own, so
    effects of the stage `lubrication` cannot act in it.

    Parameters
    ----------
    config : with units and learned values (as a replay or a diagnosis writes them).
    rate_hz : of the recording, the rate at which the taps were learned.
    extension : the terms of `extension.terms`.

    Raises
    ------
    ConfigError : nothing was learned, units are missing, or terms of the configuration have no extension.
    """

    def __init__(self, config: Config, rate_hz: float, extension: Extension | None = None) -> None:
        if not config.learned.wavelet_weights:
            raise ConfigError("learned.wavelet_weights is empty: only a model that has learned can play the plant")
        if not config.is_met:
            raise ConfigError(
                "learned.velocity_range or learned.force_unit is missing: copy them with what was learned"
            )
        if config.extension.terms and extension is None:
            raise ConfigError(f"extension.terms has {', '.join(config.extension.terms)}: their columns are needed too")
        self._config = config
        self._extension = extension
        self._spacing_s = 1.0 / rate_hz

    def __call__(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N."""
        every = max(1, round(self._spacing_s / trace.step_s))
        at = trace.sampled(every)
        restart = np.zeros(at.time_s.size, np.bool_)
        restart[:1] = True
        if self._extension is not None:
            self._extension.restart()
        friction = Estimator(self._config, self._extension).run(
            Samples(
                stamp_ns=at.stamp_ns,
                velocity_m_s=at.velocity_m_s,
                friction_N=np.zeros(at.time_s.size),
                restart=restart,
                pressure_Pa=at.pressure_Pa + self._config.theory.ambient_pressure,
                temperature_degC=at.temperature_degC,
                position_m=at.position_m,
            ),
            learn=False,
        )
        return np.interp(trace.time_s, at.time_s, friction)
