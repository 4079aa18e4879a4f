"""Find faults of the data before a cause is looked for, and repair or mask them: each effect brings its own test."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.intake.kinks import about, bends
from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base import BaseFit, fit_base, reference_of
from friction_estimator.diagnosis.joint import Joint, is_constant
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects.base import EFFECTS, Effect
from friction_estimator.effects.detection import DataView, Fault
from friction_estimator.effects.features import Context
from friction_estimator.effects.scatter import lattice_step

LEAST_LEFT = 0.3
"""Share of the samples that must remain after masking."""

SLOPE_STEP = 1e-3
"""Share of the top speed, or of the pressures' range, over which a slope is taken."""

LOUD = 4.0
"""Times the noise of the force, from which what a kink of the velocity makes is left out, and what lies about it."""
MOST_KINKS = 0.002
"""Share of kinks beyond which they are no exceptions: a drive that changes its speed in steps, or a noisy channel."""

Catalogue = Mapping[str, type[Effect]]


def repaired(
    raw: Record, config: Config, context: Context, catalogue: Catalogue = EFFECTS
) -> tuple[Record, Context, list[Fault]]:
    """Look for faults of the data; return the record with them repaired or masked, and what was found.

    The effects are asked stage by stage, in the order of the catalogue; each sees the data as repaired so far.

    Raises
    ------
    UnanswerableError : too few samples remain.
    """
    record, found = raw, list[Fault]()
    fit: BaseFit | None = None
    paired: tuple[Ints, Ints] | None = None
    for stage in ("motion", "force", "residual"):
        for cls in catalogue.values():
            if cls.detects_at != stage:
                continue
            if fit is None and stage != "motion":
                fit, paired = fit_base(record, config), record.pairs
            fault = cls.detect(replace(view_of(record, context, found, fit, config), pairs=paired))
            if fault is None:
                continue
            found.append(fault)
            moved = with_repair(record, config, fault)
            if moved is not record:
                record, fit = moved, None
                context = record.context(config, context.force_top_N)
    if record.used.sum() < LEAST_LEFT * (~record.standstill).sum():
        raise UnanswerableError("less than a third of the samples remain after masking faults: repair the sensor first")
    fit = fit or fit_base(record, config)
    steep = _slopes(fit, record, context)[0]
    record = record.with_force(record.friction_N, record.used & ~kinked(record, steep, fit.residual_N))
    context = record.context(config, float(np.abs(fit.fitted_N).max()))
    blurred_m = max((fault.scatter_m_s for fault in found), default=0.0) * context.step_s
    return record, replace(context, blurred_m=blurred_m), found


def scattered(view: DataView, catalogue: Catalogue = EFFECTS) -> list[Fault]:
    """Return the faults that show in the scatter of what the last model leaves (`left_by`)."""
    found = [cls.detect(view) for cls in catalogue.values() if cls.detects_at == "variance"]
    return [fault for fault in found if fault is not None]


def left_by(record: Record, context: Context, final: Joint, found: Sequence[Fault]) -> DataView:
    """Return what a detector sees of what the last model leaves, and of which samples should be equal."""
    return replace(view_of(record, context, found), residual_N=final.residual_N, pairs=record.pairs)


def confirmed(
    found: Sequence[Fault], record: Record, context: Context, final: Joint, catalogue: Catalogue = EFFECTS
) -> list[Fault]:
    """Return the faults without those that the final model explains: what looked like spikes was a cause.

    Asked again are the tests that masked samples by the base model's residual, with those samples given back.
    """
    again = {name: cls for name, cls in catalogue.items() if cls.detects_at == "residual"}
    out = []
    for fault in found:
        if fault.name in again and fault.used is not None:
            back = record.with_force(record.friction_N, record.used | ~fault.used)
            view = left_by(back, context, final, [f for f in found if f is not fault])
            if again[fault.name].detect(view) is None:
                continue
        out.append(fault)
    return out


def concealed(
    found: Sequence[Fault], record: Record, context: Context, final: Joint, catalogue: Catalogue = EFFECTS
) -> list[Fault]:
    """Return the spoiled samples, and the steps of the force, that only show in what the last model leaves.

    The base model's error was larger. A constant force that was told as a cause may be what cutting off such steps
    makes: it is left as well where steps are looked for, and where they were found but not that they are cut off.
    """
    whole = {fault.name for fault in found if fault.lattice_N and not fault.offset_N}
    known = {fault.name for fault in found} - whole
    left = left_by(record, context, final, found)
    constant_N = sum(filter(is_constant, final.parts_N), np.zeros(final.residual_N.size))
    views = {"force": replace(left, residual_N=final.residual_N + constant_N), "residual": left}
    asked = [cls for name, cls in catalogue.items() if cls.detects_at in views and name not in known]
    faults = [fault for cls in asked if (fault := cls.detect(views[cls.detects_at])) is not None]
    return [f for f in faults if f.offset_N or (f.name not in whole and (f.used is not None or f.lattice_N))]


def view_of(
    record: Record, context: Context, found: Sequence[Fault], fit: BaseFit | None = None, config: Config | None = None
) -> DataView:
    """Return what a detector sees; with a fit, its residual and slopes as well."""
    view = DataView(
        samples=record.samples,
        features=record.features,
        context=context,
        force_N=record.friction_N,
        used=record.used,
        restart=record.restart,
        recording=record.recording,
        block=record.block,
        lattice_N=lattice_step(record.friction_N),
        found=tuple(found),
    )
    if fit is None or config is None:
        return view
    by_speed, by_pressure = _slopes(fit, record, context)
    return replace(view, residual_N=fit.residual_N, force_slope=by_speed, pressure_slope=by_pressure)


def with_repair(record: Record, config: Config, fault: Fault) -> Record:
    """Return the record with a fault repaired: channels replaced, samples masked; the same where nothing is."""
    channels: dict[str, Any] = {
        name: values
        for name, values in (
            ("velocity_m_s", fault.velocity_m_s),
            ("position_m", fault.position_m),
            ("pressure_Pa", fault.pressure_Pa),
        )
        if values is not None
    }
    if channels:
        record = record.with_channels(config, **channels)
    if fault.offset_N:
        record = record.with_force(record.friction_N - fault.offset_N, record.used)
    if fault.used is not None:
        record = record.with_force(record.friction_N, record.used & fault.used)
    return record


def kinked(record: Record, force_slope: Floats, residual_N: Floats) -> Bools:
    """Return the samples about a kink of the velocity where the curve is steep, (n,) bool.

    Where a drive changes its acceleration between two samples just as it passes through zero, the velocity between them
    is unknown by up to a quarter of its second difference, and the force by that times dF/dv: such samples say nothing
    of a time of the force, and are as wrong as they are loud.
    """
    bend, unusual = bends(record.features.velocity_m_s, record.restart)
    noise = 1.4826 * float(np.median(np.abs(residual_N[record.used])))
    near = np.maximum.reduce([np.abs(force_slope), np.abs(np.roll(force_slope, 1)), np.abs(np.roll(force_slope, -1))])
    hit = unusual & (0.25 * np.abs(bend) * near > LOUD * noise)
    if float(hit.mean()) > MOST_KINKS:
        return np.zeros(bend.size, np.bool_)
    return about(hit)


def _slopes(fit: BaseFit, record: Record, context: Context) -> tuple[Floats, Floats]:
    """Return dF/dv, N s/m, and dF/dp, N/Pa, at the samples, (n,) each."""
    reference = reference_of(fit, context.sign_velocity_m_s)
    v, p = record.features.velocity_m_s, record.features.pressure_Pa
    step = SLOPE_STEP * context.top_speed_m_s
    by_speed = (reference.force(v + step, p) - reference.force(v - step, p)) / (2.0 * step)
    step = SLOPE_STEP * max(context.pressure_span_Pa, 1.0)
    by_pressure = (reference.force(v, p + step) - reference.force(v, p - step)) / (2.0 * step)
    return by_speed, by_pressure
