"""The moments at which what acts before a time of the whole force is worked out, over a record and as samples come.

The motion is moved, not its columns: a reversal between two samples is then as sharp as before. For a filter the
moments divide the time to the sample before, the last one the sample's own: after a reversal a column bends between two
samples.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.sample import Floats, Samples
from friction_estimator.effects.base import Effect
from friction_estimator.effects.features import FeatureMaker, Features
from friction_estimator.effects.kernels import DELAY_LINE

PARTS = 4
"""Parts of a sample period in which a filter of the force takes what acts before it as straight."""

WITHIN = tuple(i / PARTS for i in range(PARTS - 1, 0, -1))
"""How long before a sample the moments are, as shares of the time to the sample before; the last one is its own."""

STAMPED = ("time_s", "step_s", "temperature_degC", "active_time_s", "piece", "recording")
"""Features that hang on the stamps or the temperature alone: they stay the samples' own where others are moved."""

LAST = 2
"""Length of the state of `share_ago`: the last value, and whether there is one."""

Seen = Callable[[str, Floats], Floats]
"""(channel, values of now) -> what was seen of it at a moment, (n,); a channel is velocity_m_s, pressure_Pa or
position_m."""


def features_at(maker: FeatureMaker, samples: Samples, features: Features, seen: Seen) -> Features:
    """Return the features of other motion and pressure.

    `features` are those of the samples, `maker` has made those of the same moment of the samples before.
    """
    moved = {"velocity_m_s": seen("velocity_m_s", features.velocity_m_s)}
    for name in ("pressure_Pa", "position_m"):
        values = getattr(samples, name)
        if values is not None:
            moved[name] = seen(name, values)
    made = maker(replace(samples, **moved))  # type: ignore[arg-type]
    return replace(made, **{name: getattr(features, name) for name in STAMPED})


def share_ago(values: Floats, step_s: Floats, share: float, state: Floats | None = None) -> Floats:
    """Return values (n,) of a share of the time to the sample before ago, linear between samples.

    `state` is carried from piece to piece, (LAST,), zeros to begin with; it is not needed for a whole record.
    """
    out = np.empty(values.size)
    _share_ago(step_s, values, share, np.zeros(LAST) if state is None else state, out)
    return out


@njit(cache=True)
def _share_ago(step, values, share, state, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    for k in range(values.size):
        if step[k] <= 0.0 or state[1] == 0.0:
            state[0], state[1] = values[k], 1.0
        out[k] = values[k] + (state[0] - values[k]) * share
        state[0] = values[k]


class Moments:
    """These moments as samples come: fed with consecutive pieces, it gives what one piece would.

    Parameters
    ----------
    effect, params : the time of the whole force. make : gives a maker of features that knows no past.
    """

    def __init__(self, effect: type[Effect], params: Mapping[str, float], make: Callable[[], FeatureMaker]) -> None:
        self._effect, self._params = effect, params
        self._makers = [make() for _ in WITHIN] if effect.smooths else [make()]
        self.restart()

    @property
    def count(self) -> int:
        """Number of moments for a sample."""
        return len(self._makers) + self._effect.smooths

    def restart(self) -> None:
        """Forget the past."""
        for maker in self._makers:
            maker.restart()
        length = LAST if self._effect.smooths else DELAY_LINE
        self._states = [defaultdict[str, Floats](lambda: np.zeros(length)) for _ in self._makers]

    def __call__(self, samples: Samples, features: Features) -> list[Features]:
        """Return the features of the next samples at each moment, the last one that of the sample if it smooths."""
        made = [
            features_at(maker, samples, features, partial(self._seen, features, i))
            for i, maker in enumerate(self._makers)
        ]
        return [*made, features] if self._effect.smooths else made

    def _seen(self, features: Features, i: int, channel: str, values: Floats) -> Floats:
        state = self._states[i][channel]
        if self._effect.smooths:
            return share_ago(values, features.step_s, WITHIN[i], state)
        return self._effect.seen_so_far(self._params, channel, values, features, state)
