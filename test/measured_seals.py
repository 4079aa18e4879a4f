"""A measured seal, which its rig cannot identify whole: what a diagnosis must say of it, and what it must not."""

from pathlib import Path

import numpy as np
from diagnosis_records import names

from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import diagnose

WITHOUT_THEORY: dict[str, object] = {"model.type": "hammerstein", "theory.kind": "none"}


def measured_seal(shared_data: Path, seal: str) -> list[Samples]:
    """All pressures of one seal, a recording each."""
    path = shared_data / "seal_zillen_pneumatic" / "data.csv"
    table = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    table = table[(table["seal"] == seal) & np.isfinite(table["v_m_s"]) & np.isfinite(table["friction_N"])]
    recordings = []
    for level in np.unique(table["nominal_bar"]):
        part = table[table["nominal_bar"] == level]
        restart = np.concatenate([[True], np.diff(part["segment"]) != 0])
        recordings.append(
            Samples(
                np.round(part["t_s"] * 1e9).astype(np.int64),
                np.asarray(part["v_m_s"], np.float64),
                np.asarray(part["friction_N"], np.float64),
                restart,
                pressure_Pa=np.asarray(part["pressure_Pa"] + 101325.0, np.float64),
                position_m=np.asarray(part["x_m"], np.float64),
            )
        )
    return recordings


def check_measured_seal(shared_data: Path, seal: str, given: dict[str, object], pressures: slice = slice(None)) -> None:
    """Diagnose a seal, each of its pressures (or some) a recording of its own, in rising order; judge what is said."""
    found = diagnose(measured_seal(shared_data, seal)[pressures], Config.from_mapping(given))
    assert found.verdict == "effects_found"
    words = " ".join(found.excitation.warnings)
    assert "do not identify the curve F(v)" in words
    assert "randomise the order" in words
    assert {"direction_asymmetry", "sensor_bias"} & set(names(found))  # their author saw it too
    named = {e.name: e for e in found.effects}
    if (seal, given) == ("O-ring257", {}):
        # The theory's own dependence on pressure takes most of it here: what is left is flagged and has no name.
        assert "pressure_dependence" not in named
        assert found.remainder is not None
        return
    pressure = named["pressure_dependence"]
    assert pressure.gain is not None
    assert pressure.gain.low_percent > 0.0
    assert {"gain_step", "wear", "viscosity_drift", "sensor_drift", "bias_step"} <= set(pressure.rivals)
    assert pressure.experiment
    assert not set(named) & set(pressure.rivals)
