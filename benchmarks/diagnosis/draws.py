"""What is hidden: effects drawn by seed, off the regressors' grids, by size of their change or in physical units."""

from zlib import crc32

import numpy as np
from drives import Drive
from forms import THIRD

from friction_estimator.effects import EFFECTS, Effect
from friction_estimator.rig.plant import PLANTS
from friction_estimator.rig.profiles import Geometry

CATALOGUE = tuple(name for name, cls in EFFECTS.items() if cls.size_key and cls.stage != "stamps" and not cls.rotary)
"""Effects that a simulated recording can hide by size."""

TIMES = ("time_delay", "velocity_delay", "sensor_lowpass", "frictional_lag")
"""Effects that are a delay or a time constant."""
SHORTEST_S, LONGEST_S = 2e-4, 5e-2

STROKE_M = 2.0 * Geometry().eccentric_m


def seeded(*words: object) -> np.random.Generator:
    """Return random numbers that depend on the words alone."""
    return np.random.default_rng([w if isinstance(w, int) else crc32(str(w).encode()) for w in words])


def shows(name: str, drive: Drive, plant: str) -> bool:
    """Return whether an effect can be seen at all on this drive, and is not the plant's own."""
    if name in PLANTS[plant].traits:
        return False
    return drive.pressures > 1 or EFFECTS[name].channel != "pressure"


def hidden(name: str, drive: Drive, seed: int, size: float, third: bool = False) -> Effect:
    """Draw an effect of a given size: keys log-uniform in the drive's own units, either form, or the third."""
    rng = seeded(seed, name, drive.name)

    def wide(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    length, motion, nyquist = drive.duration_s, drive.motion, 0.5 * drive.rate_hz
    shortest = min(part[0] for part in drive.parts)
    draws = {
        "viscosity_drift": lambda: {"time_constant": wide(0.12, 0.64) * length},
        "wear": lambda: {"length": wide(0.1, 0.7) * _distance_m(drive)},
        "bias_step": lambda: {"at": rng.uniform(0.15, 0.85) * length},
        "gain_step": lambda: {"at": rng.uniform(0.15, 0.85) * length},
        "breakaway": lambda: {"length": wide(3e-4, 2e-3) * STROKE_M * motion, "rest_speed": wide(1e-3, 4e-3) * motion},
        "presliding": lambda: {"length": wide(2.5e-4, 2e-3) * STROKE_M * motion},
        "stick_slip": lambda: {
            "frequency": min(wide(15.0, 60.0), 0.6 * nyquist),
            "decay": wide(0.03, 0.15) * min(shortest, 1.0),
        },
        "squeeze_film": lambda: {"speed": wide(5e-3, 3e-2) * motion},
        "viscoelastic_relaxation": lambda: {"time_constant": wide(0.1, 1.5)},
        "periodic_disturbance": lambda: {"frequency": wide(3.0, 0.6 * nyquist)},
        "position_dependence": lambda: {
            "wavelength": wide(0.04, 0.4) * STROKE_M * motion,
            "phase": rng.uniform(-3.1, 3.1),
        },
        "dropout": lambda: {"length": float(rng.integers(3, 13))},
        "outliers": lambda: {"fraction": wide(2e-4, 1e-3)},
    }
    cls = THIRD[name] if third else EFFECTS[name]
    values = draws[name]() if name in draws else {}
    if any(key.name == "form" for key in cls.keys):
        # A coin of its own: the draws above are the same in every form.
        values["form"] = 0.0 if third else float(seeded(seed, name, "form").integers(0, 2))
    # Lengths on a machine of 1 mm/s come near the least that the effects know.
    bounds = {key.name: (key.low, key.high) for key in cls.keys}
    return cls(size=size, **{key: float(np.clip(value, *bounds[key])) for key, value in values.items()})


def physical(name: str, drive: Drive, seed: int, place: float) -> Effect:
    """Draw a delay or a time constant in seconds; `place` in [0, 1] spreads the draws over the decades."""
    cls = EFFECTS[name]
    value = SHORTEST_S * (LONGEST_S / SHORTEST_S) ** place
    values = {cls.size_key: value}
    if any(key.name == "form" for key in cls.keys):
        values["form"] = float(seeded(seed, name, drive.name, "form").integers(0, 2))
    return cls(**values)


def _distance_m(drive: Drive) -> float:
    """Return the distance that the drive runs, m."""
    return sum(2.0 * STROKE_M * drive.motion * seconds / period for period, _, seconds, _ in drive.parts)
