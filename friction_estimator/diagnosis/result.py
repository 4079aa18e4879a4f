"""What a diagnosis answers."""

from dataclasses import dataclass

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.excitation import Excitation
from friction_estimator.diagnosis.held_out import Gain
from friction_estimator.diagnosis.intervals import Estimate
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.remainder import Remainder
from friction_estimator.effects.base import EFFECTS
from friction_estimator.effects.detection import Fault
from friction_estimator.effects.features import Context

EFFECTS_FOUND, NOTHING_FOUND, UNEXPLAINED, UNDECIDABLE = "effects_found", "nothing_found", "unexplained", "undecidable"


@dataclass(frozen=True)
class Found:
    """One named effect.

    Attributes
    ----------
    name : effect id. p_value : family-wise, of the test that was run; None where evidence alone names it.
    parameters : fitted, with intervals. gain : held-out, from the model before it; None where the base's own memory
        had taken it up, so that nothing is predicted better.
    rivals : effects that the data cannot tell from it. experiment : what would. evidence : a sentence.
    term : its place among the model's terms.
    """

    name: str
    p_value: float | None
    parameters: dict[str, Estimate]
    gain: Gain | None
    rivals: tuple[str, ...]
    experiment: str | None
    evidence: str
    term: int

    @property
    def sized(self) -> bool:
        """Whether a size of it is apart from 0 with its interval; where it has none, a time or a length."""
        refined = EFFECTS[self.name].refined
        sizes = [e for name, e in self.parameters.items() if name not in refined] or list(self.parameters.values())
        return any(e.apart_from_zero for e in sizes)


@dataclass(frozen=True)
class Trace:
    """Something that is there but too small for a finding: effect id and percent of the error power."""

    name: str
    share_percent: float


@dataclass(frozen=True)
class Diagnosis:
    """The result, with everything that figures and words need.

    Attributes
    ----------
    config : as it was given, with the theoretical curve that was used.
    verdict : EFFECTS_FOUND, NOTHING_FOUND, UNEXPLAINED or UNDECIDABLE.
    effects : in the order in which they were taken up. faults : of the data. traces : below the least share.
    total_gain : from the base model to the last one, held-out. needs_channel : (effect id, channel).
    unexplained_percent : share of the held-out rms after all effects that is above the noise floor.
    nrmse_holdout, noise_floor : of the base model, over the standard deviation of the measured friction.
    detection_limit_N : effect id -> rms of the smallest change that would have been named, N; where nothing was found.
    record : repaired. raw : as it was read. models : base alone, then with each effect added.
    remainder : dependence that is left, or None.
    """

    config: Config
    verdict: str
    excitation: Excitation
    nrmse_holdout: float
    noise_floor: float
    faults: tuple[Fault, ...]
    effects: tuple[Found, ...]
    total_gain: Gain | None
    traces: tuple[Trace, ...]
    needs_channel: tuple[tuple[str, str], ...]
    unexplained_percent: float
    remainder: Remainder | None
    detection_limit_N: dict[str, float]
    record: Record
    raw: Record
    context: Context
    models: tuple[Joint, ...]
