"""JSON: Coulomb, Stribeck and viscous parameters, each direction its own, with intervals."""

import json
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from friction_estimator.core import metrics
from friction_estimator.export.formats import FORMATS, Exported
from friction_estimator.export.learned import Learned
from friction_estimator.export.simplified import Interval, curve_with_intervals

SCHEMA = "friction_estimator/export/1"

_UNITS = (("_N_s_m", "N s/m"), ("_m_s", "m/s"), ("_N", "N"), ("_exponent", "1"))
"""How the names of parameters end, and the unit of these on a linear drive."""
_DIRECTIONS = {"positive": "_pos_", "negative": "_neg_"}


@FORMATS.named("json")
class ParametersJson:
    """The parameters of four textbook curves' two most used, and what each costs."""

    summary: ClassVar[str] = "Coulomb, Stribeck and viscous parameters of each direction, with 95 % intervals"
    needs_recording: ClassVar[bool] = True

    @staticmethod
    def write(learned: Learned) -> Exported:
        """Return the object; the first error is that of the curve with a direction each."""
        assert learned.samples is not None
        velocity, curve = learned.samples.velocity_m_s, learned.static_curve()
        each, each_way = curve_with_intervals(learned, "stribeck_asymmetric")
        both, both_ways = curve_with_intervals(learned, "coulomb_viscous")
        error = learned.error_rms_N(each.evaluate(velocity))
        document = {
            "schema": SCHEMA,
            "model": learned.source,
            "recordings": list(learned.recordings),
            "units": learned.quantities.names,
            "conditions": {"pressure_Pa": curve.pressure_Pa, "temperature_degC": curve.temperature_degC},
            "directions": {
                "formula": "f = s (coulomb + stribeck exp(-|v / stribeck_velocity|^exponent)) + viscous v, "
                "s = tanh(v / width)",
                **{way: _named(learned, each_way, part) for way, part in _DIRECTIONS.items()},
                "shared": {name: _json(learned, name, value) for name, value in each_way.items() if "_N" not in name},
                "error_rms_N": error,
            },
            "coulomb_viscous": {
                "formula": "f = offset + coulomb tanh(v / width) + viscous v",
                **{name: _json(learned, name, value) for name, value in both_ways.items()},
                "error_rms_N": learned.error_rms_N(both.evaluate(velocity)),
            },
            "model_error_rms_N": learned.error_rms_N(learned.predicted_N),
            "static_curve_error_rms_N": learned.static_error_rms_N(),
            "spread_N": metrics.spread(learned.samples.friction_N[learned.judged]),
            "samples": int(np.count_nonzero(learned.judged)),
        }
        return Exported(json.dumps(document, indent=2, allow_nan=False) + "\n", error)


def _named(learned: Learned, parameters: Mapping[str, Interval], part: str) -> dict[str, Any]:
    """Return the parameters of one direction, without the direction in their names."""
    return {name.replace(part, "_"): _json(learned, name, value) for name, value in parameters.items() if part in name}


def _json(learned: Learned, name: str, interval: Interval) -> dict[str, Any]:
    unit = learned.quantities.unit(next(unit for ending, unit in _UNITS if name.endswith(ending)))
    return {"value": interval.value, "unit": unit, "ci95": [interval.low, interval.high]}
