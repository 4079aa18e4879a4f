"""C99: a header with the static curve and the whole model, for a controller."""

import re
from collections.abc import Iterable, Mapping
from importlib import resources
from typing import Any, ClassVar

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.model.basis import WaveletBasis
from friction_estimator.core.model.structure import Model
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.model.theory_stribeck import StribeckCurve
from friction_estimator.export.formats import FORMATS, Exported
from friction_estimator.export.learned import Learned

NAME = "friction_model"
"""Prefix of all that the header defines."""

A_LINE = 6
"""Numbers a line."""


@FORMATS.named("c")
class C99Header:
    """A header without dependencies: the node's predictions to rounding."""

    summary: ClassVar[str] = "C99 header without dependencies: the static curve and the whole model with its memory"
    needs_recording: ClassVar[bool] = False

    @staticmethod
    def write(learned: Learned) -> Exported:
        """Return the header; raises ConfigError for terms or curves that have no form in C."""
        model = learned.estimator.model
        if learned.extension is not None:
            raise ConfigError(
                f"{learned.name} has terms of a diagnosis ({', '.join(learned.config.extension.terms)}), which have "
                "no form in C yet: export the model without them, or its static curve by --format csv"
            )
        error = None if learned.samples is None else learned.error_rms_N(learned.predicted_N)
        comment = [
            f"Friction model learned by friction_estimator, from {learned.name}.",
            *learned.cost(error),
        ]
        rate = learned.spacing_s
        values = {
            "COMMENT": "\n".join(f" * {line.replace('*/', '* /')}" for line in comment),
            "name": NAME,
            "GUARD": NAME.upper(),
            "VELOCITY": learned.quantities.velocity,
            "FORCE": learned.quantities.force,
            "RATE": "the rate of the recording" if rate is None else f"{1.0 / rate:.6g} Hz",
            **_basis(learned),
            **_filters(learned),
        }
        values["THEORY"] = filled(*_theory(model))
        return Exported(filled("friction_model.h.in", values), error)


def filled(template: str, values: Mapping[str, Any]) -> str:
    """Return a template of this folder with each @KEY@ replaced; KeyError where a value is missing."""
    text = (resources.files(__package__) / template).read_text(encoding="utf-8")
    return re.sub(r"@(\w+?)@", lambda match: _plain(values[match[1]]), text)


def _plain(value: Any) -> str:
    return repr(float(value)) if isinstance(value, float) else str(value)


def _basis(learned: Learned) -> dict[str, Any]:
    """Return what evaluates g(v), in newton or newton metre."""
    model = learned.estimator.model
    basis = model.basis
    assert isinstance(basis, WaveletBasis)
    nothing = np.zeros(0)
    arguments = basis.row_arguments(nothing, np.zeros((0, 0), np.int32), nothing, np.zeros(0, np.int64))
    _, unit, low, high, bend, scale, amplitude, first, kind, table, *_ = arguments
    place = f"{bend!r} * asinh(held / {bend!r}) / {unit!r}" if bend > 0.0 else f"held / {unit!r}"
    return {
        "LOW": float(low),
        "HIGH": float(high),
        "POSITION": place,
        "PART": "fine - row" if table.shape[2] > 1 else "0.0",  # Haar is a step function
        "STEPS": table.shape[1] - 1,
        "SUPPORT": table.shape[2],
        "TABLE": _numbers(table.ravel()),
        "BLOCKS": scale.size,
        "SCALE": _numbers(scale),
        "AMPLITUDE": _numbers(amplitude),
        "FIRST": ", ".join(map(str, first)),
        "KIND": ", ".join(map(str, kind)),
        "WEIGHTS": basis.size,
        "WEIGHT_VALUES": _numbers(model.unit_N * learned.parameters.wavelet_weights),
    }


def _filters(learned: Learned) -> dict[str, Any]:
    fir = learned.parameters.fir_taps
    theory = learned.parameters.theory_taps if learned.parameters.theory_taps.size else np.zeros(fir.size)
    return {
        "TAPS": fir.size,
        "FIR": _numbers(fir),
        "THEORY_FIR": _numbers(theory),
        "FIR_SUM": float(fir.sum()),
        "THEORY_SUM": float(theory.sum()),
    }


def _theory(model: Model) -> tuple[str, dict[str, Any]]:
    """Return the template of the theoretical curve and its values."""
    if model.theory is None or not model.split(model.initial_theta()).theory_taps.size:
        return "no_theory.h.in", {"name": NAME}
    if isinstance(model.theory, StribeckCurve):
        return "stribeck_curve.h.in", {
            "name": NAME,
            "THEORY_SCALE": float(model.theory_scale),
            **model.theory.constants,
        }
    if not isinstance(model.theory, SealCurve):
        raise ConfigError(
            f"theory.kind {model.config.theory.kind} has no form in C yet: export the static curve by --format csv"
        )
    return "seal_curve.h.in", {
        "name": NAME,
        "THEORY_SCALE": float(model.theory_scale),
        "AMBIENT_PRESSURE": float(model.config.theory.ambient_pressure),
        **model.theory.constants,
    }


def _numbers(values: Iterable[float]) -> str:
    """Return the numbers of an initialiser, each exactly."""
    texts = [repr(float(value)) for value in values]
    lines = [", ".join(texts[k : k + A_LINE]) for k in range(0, len(texts), A_LINE)]
    return lines[0] if len(lines) == 1 else "\n    " + ",\n    ".join(lines)
