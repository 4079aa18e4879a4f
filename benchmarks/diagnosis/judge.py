"""What a diagnosis said, as plain data, and how right it was."""

from dataclasses import dataclass
from typing import Any

from friction_estimator.rig.plant import PLANTS

ABOUT_THE_CURVE = ("pressure_dependence",)
"""Names that may stand where the theory is wrong: they say that the curve is another one."""

LOOKS_LIKE_PERCENT = 20.0
"""Left unexplained beside a name, this says "looks like, but does not explain"."""

Line = dict[str, Any]


def told(result: Any) -> Line:
    """Return a result as plain data, whichever of its fields the package's version has."""
    findings = [_finding(e) for e in result.effects]
    faults = [_finding(e) for e in getattr(result, "faults", ())]
    remainder = getattr(result, "remainder", None)
    return {
        "verdict": result.verdict,
        "base": result.nrmse_holdout,
        "floor": result.noise_floor,
        "unexplained": result.unexplained_percent,
        "flagged": remainder is not None,
        "asked": [list(item) for item in getattr(result, "needs_channel", ())],
        "traces": [t if isinstance(t, str) else getattr(t, "name", str(t)) for t in getattr(result, "traces", ())],
        "effects": findings,
        "faults": faults,
    }


def _finding(found: Any) -> Line:
    gain = getattr(found, "gain", None)
    values = getattr(found, "parameters", None) or getattr(found, "values", None) or {}
    return {
        "name": found.name,
        "rivals": list(getattr(found, "rivals", getattr(found, "indistinguishable_from", ()))),
        "p": getattr(found, "p_value", None),
        "gain": None if gain is None else [gain.nrmse_before, gain.nrmse_after],
        "parameters": {name: _interval(value) for name, value in values.items()},
    }


def _interval(value: Any) -> list[float]:
    """Return value and 95 % interval of an estimate: an object, or (value, unit, low, high)."""
    if isinstance(value, tuple):
        number, _, low, high = value
        return [float(number), float(low), float(high)]
    return [float(value.value), float(value.low), float(value.high)]


@dataclass(frozen=True)
class Score:
    """How right the answer to one record is.

    Attributes
    ----------
    line : the record. asserted : every name among effects and faults.
    first : the first effect that is no trait of the plant, or None.
    named : it is the truth, or the truth is among the faults. inset : or the truth is in its set.
    found : for each hidden effect, whether any finding is it or lists it.
    wrong : names that are neither hidden, nor a trait, nor list one of these among what they cannot be told from.
    outside : names that are neither hidden nor a trait, whatever they list.
    intervals : (quantity, inside, value, expected) of each right name.
    """

    line: Line
    asserted: tuple[str, ...]
    first: str | None
    named: bool
    inset: bool
    found: tuple[bool, ...]
    wrong: tuple[str, ...]
    outside: tuple[str, ...]
    intervals: tuple[tuple[str, bool, float, float], ...]


def scored(line: Line) -> Score:
    """Score one record."""
    truth, traits = line["truth"], PLANTS[line["plant"]].traits
    effects, faults = line["effects"], line["faults"]
    fault_names = [f["name"] for f in faults]
    free = [e for e in effects if e["name"] not in traits]
    first = free[0] if free else None
    one = truth[0] if truth and not line["out"] else None
    among_faults = one is not None and one in fault_names
    allowed = {*([] if line["out"] else truth), *traits}
    if line["theory"]:
        allowed |= set(ABOUT_THE_CURVE)
    findings = [*effects, *faults]
    outside = [f for f in findings if f["name"] not in allowed]
    return Score(
        line=line,
        asserted=tuple(f["name"] for f in findings),
        first=None if first is None else first["name"],
        named=among_faults or (first is not None and first["name"] == one),
        inset=among_faults or (first is not None and one in (first["name"], *first["rivals"])),
        found=tuple(any(name in (f["name"], *f["rivals"]) for f in findings) for name in truth),
        wrong=tuple(f["name"] for f in outside if not allowed & set(f["rivals"])),
        outside=tuple(f["name"] for f in outside),
        intervals=tuple(_intervals(line, findings)),
    )


def _intervals(line: Line, findings: list[Line]):
    for finding in findings:
        for name, true in line.get("expected", {}).get(finding["name"], {}).items():
            if name in finding["parameters"]:
                value, low, high = finding["parameters"][name]
                least, most = true if isinstance(true, list) else (true, true)
                inside = low <= most and high >= least
                yield f"{finding['name']}.{name}", inside, value, 0.5 * (least + most)


def explained_by_nothing(line: Line) -> bool:
    """Return whether the answer says that something is there which no name explains."""
    if line["verdict"] == "unexplained":
        return True
    named = bool(line["effects"] or line["faults"])
    return named and (line["flagged"] or line["unexplained"] > LOOKS_LIKE_PERCENT)


def gain_ratio(line: Line) -> float | None:
    """Return the gain in error power over the noise-free one, where both records name the truth first; else None."""
    quiet = line.get("quiet")
    if not quiet or not line["truth"]:
        return None
    powers = []
    for told_ in (line, quiet):
        mine = [e for e in told_["effects"] if e["name"] == line["truth"][0] and e["gain"]]
        if not mine:
            return None
        before, after = mine[0]["gain"]
        powers.append((before**2 - after**2) * told_["friction_std_N"] ** 2)
    return powers[0] / powers[1] if powers[1] > 0.0 else None


def time_is_right(line: Line, score: Score) -> bool:
    """Return whether a delay or filter is within its interval or the stated rival; below half a sample: in the set."""
    if not score.inset:
        return False
    inside = [good for _, good, _, _ in score.intervals]
    short = line["place_s"] < 0.5 / line["rate_hz"]
    return short or score.first != line["truth"][0] or all(inside)
