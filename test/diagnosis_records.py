"""Simulated recordings that the tests of the diagnosis share."""

from collections.abc import Sequence

from friction_estimator.core.sample import Samples
from friction_estimator.diagnosis.diagnose import Diagnosis
from friction_estimator.diagnosis.result import Found
from friction_estimator.effects import EFFECTS, Effect, parse_effect
from friction_estimator.rig.drive import Segment, segment
from friction_estimator.rig.simulate import Scenario, simulate


def abba() -> tuple[Segment, ...]:
    """Half the length of the benchmark's records."""
    return tuple(segment(t, psi, s) for psi in (50.0, 200.0, 200.0, 50.0) for t, s in ((1.0, 6.0), (5.0, 10.0)))


LONG_ABBA = tuple(segment(t, psi, s) for psi in (50.0, 200.0, 200.0, 50.0) for t, s in ((1.0, 12.0), (5.0, 20.0)))
"""The benchmark's own length."""

ONE_PRESSURE = (segment(1.0, 50.0, 20.0), segment(5.0, 50.0, 40.0))


def record(
    effects: Sequence[str | Effect] = (),
    *,
    plant: str = "clean",
    noise: float = 0.01,
    seed: int = 3,
    segments: tuple[Segment, ...] | None = None,
) -> Samples:
    """Return 64 s at 200 Hz with effects hidden in it."""
    hidden = tuple(parse_effect(e) if isinstance(e, str) else e for e in effects)
    return simulate(Scenario(segments or abba(), plant, 200.0, noise, seed, hidden)).samples


def chosen(*names: str) -> dict[str, type[Effect]]:
    """Return a catalogue of these alone: what is hidden, what a plant has, and what was told instead. Half the time."""
    return {name: EFFECTS[name] for name in names}


def names(result: Diagnosis) -> list[str]:
    """Everything that is named: faults of the data, then effects in their order."""
    return [*(f.name for f in result.faults), *(e.name for e in result.effects)]


def set_of(found: Found) -> set[str]:
    """Return the effect with those that the data cannot tell from it."""
    return {found.name, *found.rivals}
