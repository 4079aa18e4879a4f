"""CSV: the static curve with its band."""

from typing import ClassVar

import numpy as np

from friction_estimator.core.quantities import LINEAR, ROTARY
from friction_estimator.export.formats import FORMATS, Exported
from friction_estimator.export.learned import Learned

HEADS = {
    LINEAR: "velocity_m_s,friction_N,low_N,high_N",
    ROTARY: "velocity_rad_s,friction_N_m,low_N_m,high_N_m",
}


@FORMATS.named("csv")
class CsvTable:
    """Rows of velocity, friction and 95 % band; comment lines begin with #."""

    summary: ClassVar[str] = "static curve with its 95 % band, for plots and look-up tables"
    needs_recording: ClassVar[bool] = False

    @staticmethod
    def write(learned: Learned) -> Exported:
        """Return the table; the band is empty where it was not kept."""
        curve = learned.static_curve()
        error = None if learned.samples is None else learned.static_error_rms_N()
        comment = [
            f"Static friction learned by friction_estimator, from {learned.name},",
            f"at {curve.pressure_Pa:.6g} Pa gauge and {curve.temperature_degC:.4g} degC.",
            *learned.cost(error),
        ]
        rows = zip(curve.velocity_m_s, curve.friction_N, curve.low_N, curve.high_N, strict=True)
        lines = [
            *(f"# {line}" for line in comment),
            HEADS[learned.quantities.motion],
            *(",".join(map(_cell, row)) for row in rows),
        ]
        return Exported("\n".join(lines) + "\n", error)


def _cell(value: float) -> str:
    return repr(float(value)) if np.isfinite(value) else ""
