"""What a claim is, and how numbers become a verdict."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from scipy import stats

CONFIDENCE = 0.95

ADAPTED, FROZEN, ELSEWHERE = "adapted", "frozen", "elsewhere"
MODES = (ADAPTED, FROZEN, ELSEWHERE)
"""How a claim is scored: while learning; learned on the first part and judged on the rest without learning; learned on
one drive and judged, without learning, on drives that differ in kind."""

Outcomes: TypeAlias = dict[str, bool | None]
"""Name of a case ("lms a") -> whether the claim holds there; None is undecided."""


@dataclass(frozen=True)
class Theorem:
    """What follows from the paper's own equations for every recording: no measurement can change it.

    Attributes
    ----------
    statement, proof : in words. checked : what the computed numbers say of it, which tests the program, not the world.
    """

    statement: str
    proof: str
    checked: str


@dataclass(frozen=True)
class Claim:
    """One claim of the paper with its test.

    Attributes
    ----------
    id : short name.
    statement : what the paper says.
    experiment : what was done, with seeds and conditions, and the criterion.
    numbers : what came out; intervals are 95 %.
    verdict : confirmed, refuted or depends, computed from all cases of all modes (or from the theorems).
    why : a few sentences.
    verdicts : the same by mode (`MODES`), where the claim has modes.
    cases : by mode, how many cases hold, fail and are undecided.
    verdicts_without_companding : verdicts in the paper's own basis, even in velocity, where that was run.
    theorems : what needs no measurement.
    """

    id: str
    statement: str
    experiment: str
    numbers: dict[str, Any]
    verdict: str
    why: str
    verdicts: dict[str, str] = field(default_factory=dict)
    cases: dict[str, dict[str, int]] = field(default_factory=dict)
    verdicts_without_companding: dict[str, str] = field(default_factory=dict)
    theorems: tuple[Theorem, ...] = ()


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % confidence interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3g} [{self.low:.3g}, {self.high:.3g}]"


@dataclass(frozen=True)
class Judged:
    """The cases of a claim in one basis, by mode, and their numbers by name."""

    cases: Mapping[str, Outcomes]
    numbers: Mapping[str, Any]

    @property
    def verdicts(self) -> dict[str, str]:
        """Mode -> verdict."""
        return {mode: verdict(cases.values()) for mode, cases in self.cases.items()}

    @property
    def verdict(self) -> str:
        """The verdict over all modes."""
        return verdict(outcome for cases in self.cases.values() for outcome in cases.values())

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """Mode -> how many cases hold, fail and are undecided."""
        return {mode: counted(cases) for mode, cases in self.cases.items()}

    @property
    def told(self) -> str:
        """The cases in sentences."""
        return " ".join(told(mode, cases) for mode, cases in self.cases.items())


def geometric_mean(values: Sequence[float]) -> Interval:
    """Return the geometric mean of positive values with Student's interval on their logarithms.

    Raises ValueError below two values.

    >>> str(geometric_mean([1.0, 1.0, 1.0]))
    '1 [1, 1]'
    """
    if len(values) < 2:
        raise ValueError("an interval needs at least two values")
    logs = np.log(np.asarray(values, np.float64))
    reach = stats.t.ppf(0.5 + CONFIDENCE / 2, logs.size - 1) * logs.std(ddof=1) / np.sqrt(logs.size)
    return Interval(*(float(np.exp(logs.mean() + shift)) for shift in (0.0, -reach, reach)))


def share(hits: int, trials: int) -> Interval:
    """Return hits / trials with the Clopper-Pearson interval; 0 to 1 without any trial.

    >>> str(share(10, 10))
    '1 [0.692, 1]'
    """
    if not trials:
        return Interval(0.5, 0.0, 1.0)
    interval = stats.binomtest(hits, trials).proportion_ci(CONFIDENCE, method="exact")
    return Interval(hits / trials, float(interval.low), float(interval.high))


def counted(cases: Outcomes) -> dict[str, int]:
    """Return how many cases hold, fail and are undecided."""
    words = {"hold": True, "fail": False, "undecided": None}
    return {word: sum(outcome is wanted for outcome in cases.values()) for word, wanted in words.items()}


def verdict(holds: Iterable[bool | None]) -> str:
    """Return confirmed where every case holds, refuted where every case fails, else depends; None is undecided.

    >>> verdict([True, True]), verdict([False, False]), verdict([True, None]), verdict([True, False])
    ('confirmed', 'refuted', 'depends', 'depends')
    """
    cases = list(holds)
    if cases and all(case is True for case in cases):
        return "confirmed"
    if cases and all(case is False for case in cases):
        return "refuted"
    return "depends"


def below(interval: Interval, level: float) -> bool | None:
    """Return whether the interval lies below (True) or above (False) a level; None where it covers it."""
    if interval.high < level:
        return True
    return False if interval.low > level else None


def denied(outcome: bool | None) -> bool | None:
    """Return the opposite; what is undecided stays so."""
    return None if outcome is None else not outcome


def both(one: bool | None, other: bool | None) -> bool | None:
    """Return whether both hold: False where either fails, None where that is open."""
    if one is False or other is False:
        return False
    return True if one and other else None


def listed(cases: Outcomes, wanted: bool | None) -> str:
    """Return the names of the cases with this outcome, for a sentence; what differs in the condition only is joined.

    A case is named "LEARNER CONDITION" or "LEARNER CONDITION on DRIVE".

    >>> listed({"lms a": True, "lms b": False, "rls a": True, "rls b on triangle": True}, True)
    'lms (a), rls (a, b on triangle)'
    """
    groups: dict[str, list[str]] = {}
    for name, outcome in cases.items():
        if outcome is wanted:
            head, on, drive = name.partition(" on ")
            who, _, condition = head.rpartition(" ")
            groups.setdefault(who or name, []).append(f"{condition}{on}{drive}" if who else "")
    return ", ".join(f"{who} ({', '.join(where)})" if where[0] else who for who, where in groups.items()) or "none"


def told(mode: str, cases: Outcomes) -> str:
    """Return a sentence on the cases of a mode; of those that hold and those that fail it names the fewer.

    >>> told("frozen", {"lms a": True, "lms b": False, "rls a": False, "rls b": None})
    'Frozen: 1 of 4 cases hold. It holds for lms (a); undecided: rls (b); it fails for all others.'
    """
    counts = counted(cases)
    head = f"{mode.capitalize()}: {counts['hold']} of {len(cases)} cases hold."
    if counts["hold"] == len(cases):
        return head
    parts = []
    if counts["undecided"]:
        parts.append(f"undecided: {listed(cases, None)}")
    few, many = ("holds", "fails") if counts["hold"] <= counts["fail"] else ("fails", "holds")
    named = listed(cases, few == "holds")
    if named != "none":
        parts.insert(0, f"it {few} for {named}")
    if counts[{"holds": "hold", "fails": "fail"}[many]]:
        parts.append(f"it {many} for all others" if parts else f"it {many} for every one")
    sentence = "; ".join(parts)
    return f"{head} {sentence[0].upper()}{sentence[1:]}."


def by_step_size(cases: Mapping[str, Outcomes], law: str, default: str) -> str:
    """Return a sentence on where the outcome of a law depends on its step size.

    Cases are named "LAW STEP CONDITION", or "LAW CONDITION" for the `default` step.

    >>> by_step_size({"frozen": {"lms a": True, "lms 0.02 a": False, "lms b": True}}, "lms", "0.005")
    'Of lms it depends on the step size: frozen, a (holds at 0.005; fails at 0.02).'
    """
    parts = []
    for mode, outcomes in cases.items():
        steps: dict[str, dict[str, bool | None]] = {}
        for name, outcome in outcomes.items():
            who, _, rest = name.partition(" ")
            if who != law:
                continue
            first, _, condition = rest.partition(" ")
            is_step = first.replace(".", "", 1).isdigit()
            steps.setdefault(condition if is_step else rest, {})[first if is_step else default] = outcome
        for condition, found in steps.items():
            if len(set(found.values())) > 1:
                where = [
                    f"{word} {', '.join(sorted((s for s, o in found.items() if o is wanted), key=float))}"
                    for word, wanted in (("holds at", True), ("fails at", False), ("undecided at", None))
                    if wanted in found.values()
                ]
                parts.append(f"{mode}, {condition} ({'; '.join(where)})")
    if not parts:
        return f"Of {law} it does not depend on the step size."
    return f"Of {law} it depends on the step size: {'; '.join(parts)}."


def without_companding(judged: Judged, plain: Judged) -> str:
    """Return a sentence on what the paper's own basis, even in velocity, changes."""
    changed = {
        mode: sum(outcome is not judged.cases[mode].get(name) for name, outcome in cases.items())
        for mode, cases in plain.cases.items()
    }
    verdicts = ", ".join(f"{mode} {word}" for mode, word in plain.verdicts.items())
    told_of = ", ".join(f"{count} of {len(plain.cases[mode])} {mode}" for mode, count in changed.items())
    return f"Without companding (the paper's basis): {verdicts}; other outcomes in {told_of}."
