"""The rows of the study: a fractional design, in which plants and drives turn with effect and seed.

A case is plain data. Each row has about 25 to 30 cases a seed, so that four seeds make a hundred.
"""

from collections.abc import Callable, Iterator
from typing import Any

from draws import CATALOGUE, TIMES, seeded, shows
from drives import ABBA, OTHER, Drive
from forms import THIRD
from records import WRONG_THEORIES

from friction_estimator.core.quantities import LINEAR
from friction_estimator.effects import EFFECTS
from friction_estimator.rig.plant import PLANTS

Case = dict[str, Any]

PLANT_NAMES = tuple(name for name, plant in PLANTS.items() if plant.motion == LINEAR)
ABBA_TURN = tuple(part for drive in ABBA[1:] for part in (ABBA[0], drive))
"""Every other record is of the usual drive."""


def _case(truth: list[str], plant: str, drive: Drive, seed: int, size: float, noise: float, **more: Any) -> Case:
    usual = {"form": "drawn", "place": None, "coloured": False, "theory": "", "out": False, "gain": False}
    named = {"truth": truth, "plant": plant, "drive": drive.name, "seed": seed, "size": size, "noise": noise}
    return named | usual | more


def _placed(truth: list[str], turn: int, drives: tuple[Drive, ...], seed: int) -> tuple[str, Drive] | None:
    """Return the plant and the drive whose turn it is and that can show all of the truth."""
    for step in range(len(drives) * len(PLANT_NAMES)):
        plant = PLANT_NAMES[(turn + step + seed) % len(PLANT_NAMES)]
        drive = drives[(turn + step + 3 * seed) % len(drives)]
        if all(shows(name, drive, plant) for name in truth):
            return plant, drive
    return None


def _singles(drives: tuple[Drive, ...], size: float, noise: float, gains: bool = False) -> Callable:
    def cases(seed: int) -> Iterator[Case]:
        for turn, name in enumerate(CATALOGUE):
            if (place := _placed([name], turn, drives, seed)) is not None:
                # The noise-free gain costs a second diagnosis: every other record has it.
                gain = gains and (turn + seed) % 2 == 0
                yield _case([name], *place, seed, size, noise, gain=gain)

    return cases


def _times(seed: int) -> Iterator[Case]:
    """Delays and time constants from 0.2 to 50 ms, log-uniform, one draw in each of equal parts of the decades."""
    names, count = [name for name in TIMES if name in EFFECTS], 27
    for turn in range(count):
        name = names[turn % len(names)]
        if (place := _placed([name], turn // len(names) + turn, ABBA_TURN, seed)) is not None:
            part = (turn + float(seeded(seed, name, turn).random())) / count
            yield _case([name], *place, seed, 0.0, 0.01, form="physical", place=part)


def _thirds(seed: int) -> Iterator[Case]:
    for turn in range(3 * len(THIRD)):
        name = list(THIRD)[turn % len(THIRD)]
        if (place := _placed([name], turn + turn // len(THIRD), ABBA_TURN, seed)) is not None:
            yield _case([name], *place, seed, 0.04, 0.01, form="third")


def _nothing(seed: int) -> Iterator[Case]:
    """Every plant, white and AR(1) noise, with pauses and jitter, on ABBA drives and others."""
    broken = tuple(drive for drive in (*ABBA, *OTHER) if drive.pauses or drive.jitter or drive.missing)
    for turn, plant in enumerate(PLANT_NAMES):
        for k, drives in enumerate((ABBA[:1], ABBA[1:], broken, OTHER)):
            drive = drives[(turn + seed) % len(drives)]
            coloured = (turn + k + seed) % 2 == 1
            yield _case([], plant, drive, seed, 0.0, (0.01, 0.03)[(k + seed) % 2], coloured=coloured)


def _theory(seed: int) -> Iterator[Case]:
    for turn, theory in enumerate(WRONG_THEORIES):
        for k in range(5):
            plant = PLANT_NAMES[(turn + k + seed) % len(PLANT_NAMES)]
            drive = (*ABBA_TURN, *OTHER)[(5 * turn + k + 7 * seed) % (len(ABBA_TURN) + len(OTHER))]
            yield _case([], plant, drive, seed, 0.0, 0.01, theory=theory)


def _pairs(seed: int) -> Iterator[Case]:
    for turn in range(25):
        names = [str(name) for name in seeded(seed, turn, "pair").choice(CATALOGUE, 2, replace=False)]
        if (place := _placed(names, turn, ABBA_TURN, seed)) is not None:
            yield _case(names, *place, seed, 0.04, 0.01)


def _outside(seed: int) -> Iterator[Case]:
    for turn, name in enumerate(CATALOGUE):
        if (place := _placed([name], turn + 2, ABBA_TURN, seed)) is not None:
            yield _case([name], *place, seed, 0.04, 0.01, out=True)


ROWS: dict[str, Callable[[int], Iterator[Case]]] = {
    "abba 4 %": _singles(ABBA_TURN, 0.04, 0.01, gains=True),
    "abba 1 %": _singles(ABBA_TURN, 0.01, 0.03),
    "other drives": _singles(OTHER, 0.04, 0.01),
    "times": _times,
    "third forms": _thirds,
    "nothing": _nothing,
    "wrong theory": _theory,
    "pairs": _pairs,
    "outside": _outside,
}
"""Row -> its cases of one seed."""


def cases(rows: list[str], seeds: range) -> Iterator[Case]:
    """Yield the cases, seed by seed, so that a study that is cut short has all rows."""
    for seed in seeds:
        for row in rows:
            for case in ROWS[row](seed):
                yield {"row": row} | case
