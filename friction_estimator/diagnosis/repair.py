"""Repair or mask what is wrong with the data before a cause is looked for."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis import quality
from friction_estimator.diagnosis.base import BaseFit, fit_base, reference_of
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.quality import Finding
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects.base import EFFECTS
from friction_estimator.effects.features import Context, FeatureMaker


def repaired(raw: Record, config: Config, context: Context) -> tuple[Record, Context, list[Finding]]:
    """Look for faults of the data; return the record with them repaired or masked, and what was found."""
    record = raw
    findings: list[Finding] = []
    for test in (quality.velocity_mismatch, quality.clock_jump):
        finding = test(record, context) if test.__name__ in EFFECTS else None
        if finding is not None:
            findings.append(finding)
            record = _with_velocity(record, config, finding.velocity_m_s)
    fit = fit_base(record, config)
    error = float(np.var(fit.residual_N[record.used]))
    lattice = quality.quantization(record, error)
    step = quality.lattice_step(record.friction_N)
    if lattice is not None:
        record = _recentred(record, config, step)
    for finding in (lattice, quality.saturation(record, step), quality.dropout(record, step)):
        if finding is not None and finding.name in EFFECTS:
            findings.append(finding)
            if finding.used is not None:
                record = record.with_force(record.friction_N, record.used & finding.used)
    fit = fit_base(record, config)
    error = float(np.mean(np.square(fit.residual_N[record.used])))
    noisy = quality.velocity_noise(record, _force_slope(fit, record, context), error)
    if noisy is not None and noisy.name in EFFECTS:
        findings.append(noisy)
        record = _with_velocity(record, config, noisy.velocity_m_s)
        fit = fit_base(record, config)
    spikes = quality.outliers(record, fit.residual_N)
    if spikes is not None and spikes.name in EFFECTS:
        findings.append(spikes)
        record = record.with_force(record.friction_N, record.used & (spikes.used if spikes.used is not None else True))
    if float(record.used.mean()) < 0.3:
        raise UnanswerableError("less than a third of the samples remain after masking faults: repair the sensor first")
    top = float(np.abs(fit.fitted_N).max())
    return record, record.context(config, top), findings


def confirmed(findings: Sequence[Finding], raw: Record, final: Joint, coarse: bool) -> list[Finding]:
    """Return the findings without outliers that the final model explains: what looked like spikes was a cause."""
    out = []
    for finding in findings:
        if finding.name == "outliers" and finding.used is not None:
            kept = raw.used & ~(~finding.used & (np.abs(final.residual_N) > 0.0))
            back = raw.with_force(raw.friction_N, kept | ~finding.used)
            again = None if coarse else quality.outliers(back, final.residual_N)
            if again is None:
                continue
        out.append(finding)
    return out


def _recentred(record: Record, config: Config, step_N: float) -> Record:
    """Return the record with half a step added where values were cut off rather than rounded.

    Cutting off shifts the mean by half a step; that much, to a sixth of a step, is the lattice's and no bias.
    """
    bias = float(fit_base(record, config, np.ones((record.used.size, 1))).extra_weights[0])
    if abs(abs(bias) - 0.5 * step_N) > step_N / 6.0:
        return record
    return record.with_force(record.friction_N - np.sign(bias) * 0.5 * step_N, record.used)


def _with_velocity(record: Record, config: Config, velocity_m_s: Floats | None) -> Record:
    """Return the record with another velocity, its features computed anew."""
    if velocity_m_s is None:
        return record
    samples = replace(record.samples, velocity_m_s=velocity_m_s)
    theory = config.theory
    maker = FeatureMaker(theory.ambient_pressure, theory.default_pressure, theory.default_temperature)
    return replace(record, samples=samples, features=maker(samples))


def _force_slope(fit: BaseFit, record: Record, context: Context) -> Floats:
    """Return dF/dv at the samples, (n,), N s/m."""
    reference = reference_of(fit, record, context.sign_velocity_m_s)
    f = record.features
    step = 1e-3 * context.top_speed_m_s
    more = reference.force(f.velocity_m_s + step, f.pressure_Pa)
    less = reference.force(f.velocity_m_s - step, f.pressure_Pa)
    return np.asarray((more - less) / (2.0 * step))
