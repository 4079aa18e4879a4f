"""The extended model: base and named terms as a configuration that every verb and the live node accept."""

import numpy as np

from friction_estimator.core.model.basis import basis_from_config
from friction_estimator.core.model.structure import theory_scale
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import chosen
from friction_estimator.diagnosis.base import BaseFit
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.odd_curve import BEND
from friction_estimator.diagnosis.result import Diagnosis
from friction_estimator.effects.base import EFFECTS, Effect
from friction_estimator.effects.extension import reference_from_config
from friction_estimator.effects.features import Features
from friction_estimator.effects.reference import Reference
from friction_estimator.effects.term import TermSpec, held_variable

CURVE_POINTS = 3001
RIDGE = 1e-7


def is_offered(result: Diagnosis) -> bool:
    """Return whether there is an extended model: terms that gain on held-out data, or a repair that it takes up."""
    if any(EFFECTS[f.name].repairing_term(f) is not None for f in result.faults):
        return True
    if any(found.p_value is None for found in result.effects):
        return True
    return result.total_gain is not None and result.total_gain.low_percent > 0.0


def extended_config(result: Diagnosis) -> Config:
    """Return the configuration of the base model with the named terms, warm with everything that was fitted.

    The base's odd splines are projected on the wavelet basis over the velocities as they were used, that is repaired;
    the FIR and the theory's gain are taken over as they are. The terms' reference curve is taken at the temperature of
    the recordings, and no term goes beyond what was measured of its cause (`effects.extension`). A fault that the
    model can take up becomes a term of coefficient one, one that the intake can keep out a setting.
    """
    model = result.models[-1]
    units = chosen(result.config, result.record.features.velocity_m_s, result.record.friction_N)
    # Shapes over the speed are spread over the speeds that were fitted.
    units = units.updated({"learned.velocity_scale": model.reference.top_m_s})
    base = model.base
    structure: dict[str, object] = {
        "model.type": "parallel" if base.theory is not None else "hammerstein",
        "basis.companding": BEND,
        "fir.order": int(base.taps.size),
        "extension.terms": (),
        "learned.fir_taps": (),
        "learned.theory_taps": (),
        "learned.wavelet_weights": (),
        "learned.extension_weights": (),
    }
    for finding in result.faults:
        structure.update(EFFECTS[finding.name].repairing_settings(finding, result.config))
    units = units.updated(structure)
    shape = np.concatenate([[1.0], base.taps])
    norm = float(np.linalg.norm(shape))
    learned: dict[str, object] = {
        "learned.fir_taps": tuple((shape / norm).tolist()),
        "learned.wavelet_weights": tuple((projected_curve(base, units) * norm).tolist()),
    }
    if base.theory is not None:
        learned["theory.default_temperature"] = float(result.record.features.temperature_degC.mean())
        # The estimator's taps stand behind the scaled curve.
        own = np.concatenate([[-base.own_lags.sum()], base.own_lags])
        taps = (base.theory_gain * shape + own) / theory_scale(units, base.theory)
        learned["learned.theory_taps"] = tuple(taps.tolist())
    warm = units.updated(learned)
    specs, weights = terms_of(model, reference_from_config(warm))
    for finding in result.faults:
        params = EFFECTS[finding.name].repairing_term(finding)
        if params is not None:
            specs.append(TermSpec(EFFECTS[finding.name], params))
            weights.append(1.0)
    terms = {"extension.terms": tuple(spec.text for spec in specs), "learned.extension_weights": tuple(weights)}
    return warm.updated(terms)


def terms_of(model: Joint, reference: Reference) -> tuple[list[TermSpec], list[float]]:
    """Return the terms of a model, one for each column, each scaled to an rms of 1 N, and their coefficients.

    `reference` is what the extended model makes its columns from. What stands at a force for the whole drive, as the
    one at top speed, is another one there: more pressures are tabulated.
    """
    specs: list[TermSpec] = []
    weights: list[float] = []
    for term in model.terms:
        effect = term.effect
        params, told = effect.elsewhere(term.params, term.weights)
        fitted, own = (_rms(effect.columns(params)(model.features, r)) for r in (model.reference, reference))
        for part, scale in enumerate(own.tolist()):
            specs.append(TermSpec(effect, params, part, scale, measured(effect, model.features)))
            # What is of coefficient one is so of its own column.
            size = scale if effect.fixed_gain else float(fitted[part])
            weights.append(float(told[part]) * size)
    return specs, weights


def _rms(columns: Floats) -> Floats:
    """Return the rms of each column, (c,); 1 of one that is nothing."""
    size = np.sqrt(np.mean(np.square(columns), axis=0))
    return np.where(size > 0.0, size, 1.0)


def measured(effect: type[Effect], features: Features) -> tuple[float, float] | None:
    """Return what was measured of the variable in which a term of this effect goes no further, or None."""
    name = held_variable(effect)
    if name is None:
        return None
    values = getattr(features, name)
    return float(values.min()), float(values.max())


def projected_curve(base: BaseFit, config: Config) -> Floats:
    """Return wavelet weights (size,), in units of `force_unit`, of the base's odd curve."""
    basis = basis_from_config(config)
    low, high = basis.reach
    top = base.curve.top
    grid = base.curve.bend * np.sinh(np.linspace(-1.0, 1.0, CURVE_POINTS) * np.arcsinh(BEND))
    grid = grid[(grid >= low) & (grid <= high)]
    grid = np.clip(grid, -top, top)
    index, value = basis.rows(grid)
    psi = np.zeros((grid.size, basis.size))
    np.put_along_axis(psi, index.astype(np.int64), value, axis=1)
    target = base.curve(grid) @ base.weights / config.unit_N
    gram = psi.T @ psi
    gram += RIDGE * float(np.trace(gram)) / basis.size * np.eye(basis.size)
    return np.asarray(np.linalg.solve(gram, psi.T @ target))
