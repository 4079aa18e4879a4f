"""What a search for causes found: the causes in their order, and the models with them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

from friction_estimator.diagnosis.base_problem import BaseProblem
from friction_estimator.diagnosis.evidence import Evidence
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.screening import Screened

LEAST_SHARE = 0.002
"""Share of the error power that a cause must bring, whatever its significance."""

LATER_SHARE = 0.015
"""The same of a further cause that is held against nothing else, and beside causes of a remainder. What the form of an
earlier cause, or the base's curve, leaves is no noise: in a record of 25,000 samples it passes every test, and what
repeats with the drive looks like it (decision 0133)."""

FORMS_SHARE = 0.006
"""The same of a further cause that is more than other forms of the earlier ones; where less is left above the noise
floor, the alternatives of a named cause are not looked at (decision 0232)."""

SMALL_SHARE = 0.02
"""The same of one that brings less than `LEAST_SHARE` of the error power of the base alone: beside causes that explain
nearly all, what their forms leave looks like a small one (decision 0189)."""


MISFIT_SHARE, MISFIT_LEFT = 0.01, 0.75
"""Share of the largest cause's gain that the form of that cause may lack, and of what is left: what a cause as small
must bring (decision 0198)."""


@dataclass(frozen=True)
class Cause:
    """A named cause.

    Attributes
    ----------
    name : effect id. p_value : family-wise, None where evidence alone names it.
    gain : held-out decrease of the error power with what the prior of the memory saves, summed, N^2.
    rivals : effects that explain the data as well, best first.
    behind_N2 : of others that come close, by how much less they explain, N^2.
    apart : quantity -> by how much it differs in other forms of the cause that explain nearly as much.
    untold : quantity -> its least and largest value in forms that the drive does not tell from this one.
    """

    name: str
    p_value: float | None
    gain: float
    rivals: tuple[str, ...]
    behind_N2: Mapping[str, float] = field(default_factory=dict)
    apart: Mapping[str, float] = field(default_factory=dict)
    untold: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def within(self, left_N2: float) -> "Cause":
        """Return the cause with those as rivals, too, that are behind by less than what no cause explains.

        A model that misses that much says nothing of a smaller difference between two of them.
        """
        close = [name for name, behind in self.behind_N2.items() if behind < left_N2]
        return replace(self, rivals=tuple(dict.fromkeys([*self.rivals, *close])))


def least_further_N2(share: float, power_N2: float, causes: Sequence[Cause]) -> float:
    """Return the gain that a cause beside others must bring, N^2: a share of the error power that these leave.

    A larger one (`SMALL_SHARE`), unless it is `LEAST_SHARE` of what the base alone leaves.

    >>> one = [Cause("inertia", None, gain=900.0, rivals=())]
    >>> least_further_N2(0.006, 100.0, one), least_further_N2(0.006, 100.0, []), least_further_N2(0.006, 1.0, one)
    (2.0, 0.6, 0.02)
    """
    alone = power_N2 + sum(cause.gain for cause in causes)
    return max(share * power_N2, min(LEAST_SHARE * alone, SMALL_SHARE * power_N2))


def as_misfit(
    causes: Sequence[Cause], formed: Collection[str], left_N2: float, sure: Collection[str] = ()
) -> int | None:
    """Return the place of the smallest cause if it may be what the form of the largest one lacks; None otherwise.

    It is where it brings less than `MISFIT_SHARE` of the largest one's gain, and less than `MISFIT_LEFT` of what is
    left beside all of them.

    Parameters
    ----------
    formed : causes of which there is another form; a constant has none. left_N2 : above the noise floor. sure : causes
        that no form of another one makes (`time_alone`).

    >>> two = [Cause("backlash", None, 900.0, ()), Cause("squeeze_film", None, 3.0, ())]
    >>> as_misfit(two, {"backlash"}, 4.1), as_misfit(two, {"backlash"}, 3.9), as_misfit(two, {"squeeze_film"}, 4.1)
    (1, None, None)
    """
    doubtful = (i for i, cause in enumerate(causes) if cause.name not in sure)
    place = min(doubtful, key=lambda i: causes[i].gain, default=None)
    if place is None:
        return None
    largest = max((cause.gain for cause in causes if cause.name in formed), default=0.0)
    return place if causes[place].gain < min(MISFIT_SHARE * largest, MISFIT_LEFT * left_N2) else None


@dataclass(frozen=True)
class Search:
    """What a search found.

    Attributes
    ----------
    problem : the base model on the record. causes : in the order in which they were taken up.
    models : base alone, then with each cause added.
    gates : by effect, the gain that neither chance nor rounding makes, N^2.
    warnings : in words. asked : effects that would have won but need a channel.
    """

    problem: BaseProblem
    causes: tuple[Cause, ...]
    models: tuple[Joint, ...]
    gates: Mapping[str, float]
    warnings: tuple[str, ...]
    asked: tuple[str, ...]
    last_evidence: Evidence
    screened: tuple[Screened, ...]

    @property
    def least_N2(self) -> float:
        """Gain below which what passes the test is a trace, N^2."""
        power = float(self.last_evidence.ee.sum())
        return least_further_N2(LATER_SHARE, power, self.causes) if self.causes else LEAST_SHARE * power
