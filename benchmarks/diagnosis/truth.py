"""What a fitted quantity should be: the physical value where the form has it, else what fits the noise-free change.

An effect of another functional form than its regressor has no true parameter of that regressor. The judge then fits
the effect's own columns to the change that the effect makes of the noise-free friction, with the plant's own curve as
reference and what a static curve can absorb (the theory's gain and an odd function of the velocity) projected out.
"""

from dataclasses import fields

import numpy as np
from records import Made
from scipy.optimize import minimize_scalar

from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.effects import EFFECTS, Effect, Trace
from friction_estimator.effects.axis import VelocityAxis
from friction_estimator.effects.extension import theory_parts
from friction_estimator.effects.features import Context, FeatureMaker, Features
from friction_estimator.effects.reference import Reference, tabled
from friction_estimator.rig.plant import CLEAN_TAPS

PHYSICAL = {
    "time_delay": ("delay",),
    "velocity_delay": ("delay",),
    "inertia": ("mass",),
    "sensor_bias": ("bias",),
    "bias_step": ("step", "at"),
    "gain_step": ("at",),
    "position_dependence": ("wavelength",),
    "periodic_disturbance": ("frequency",),
    "sensor_drift": ("total",),
    "saturation": ("level",),
}
"""Quantities that every form of the effect has."""

USUAL_FORM = {
    "viscosity_drift": ("time_constant",),
    "wear": ("length",),
    "presliding": ("length",),
    "viscoelastic_relaxation": ("time_constant",),
    "frictional_lag": ("lag",),
    "sensor_lowpass": ("time_constant",),
}
"""Quantities that the usual form alone has: its times and lengths."""

BOTH_FORMS = ("frictional_lag",)
"""Of these, the other form has them as well. A fit would need the theory's gain, which a static force at one pressure
does not tell: everything odd is in the hats."""

HATS = 24
PRESSURE_NODES = 5
EVALUATIONS = 40
SCAN = 61
ONE_PRESSURE = 0.05
"""Of the largest pressure: a range up to which there is one, at which any share of the friction may be the theory's."""
AT_EDGE = 1.01
"""Factor within which a sought value lies at an end of its bracket: the columns cannot make that change there, as where
a late velocity acts on bristles, which the plant's static curve does not have. Then nobody knows what is true."""


Range = float | list[float]
"""A quantity, or the ends of the plateau on which it changes nothing: a gap between two samples."""


def expected(effect: Effect, made: Made, index: int, plant: str) -> dict[str, Range]:
    """Return the quantities of one hidden effect as its regressor names them, in SI units."""
    cls = type(effect)
    own = PHYSICAL.get(effect.name, ())
    ours = cls is EFFECTS[effect.name]
    if ours and (effect.values.get("form", 0.0) < 0.5 or effect.name in BOTH_FORMS):
        own = (*own, *USUAL_FORM.get(effect.name, ()))
    physical = {name: effect.values[name] for name in own}
    if cls.columns.__func__ is Effect.columns.__func__:
        return {} if effect.values.get("form", 0.0) >= 0.5 else dict(effect.values)
    return best_fit(effect, made, index, plant) | physical


def best_fit(effect: Effect, made: Made, index: int, plant: str) -> dict[str, Range]:
    """Return what the effect's own columns, fitted to its noise-free change, make of its quantities."""
    cls = EFFECTS[effect.name]
    config, samples = made.config, made.samples
    maker = FeatureMaker(
        config.theory.ambient_pressure, config.theory.default_pressure, config.theory.default_temperature
    )
    features = maker(samples).with_force(made.clean_N)
    context = _context(features, made)
    change, clean = made.changes_N[index], made.clean_N
    z = _absorbed(features, made)
    coefficients, *_ = np.linalg.lstsq(z, clean, rcond=None)
    reference = _reference(made, features, float(coefficients[0]), context, plant)
    q, _ = np.linalg.qr(z)
    # An effect on another channel changes what belongs to that channel: the force is then short of it.
    target = change if cls.change is Effect.change else -change
    target = target - q @ (q.T @ target)

    def fitted(params: dict[str, float]) -> tuple[float, np.ndarray]:
        columns = _columns(cls, params, features, reference)
        columns = columns - q @ (q.T @ columns)
        if cls.fixed_gain:
            return float(np.sum(np.square(target - columns[:, 0]))), np.ones(1)
        weights, *_ = np.linalg.lstsq(columns, target, rcond=None)
        return float(np.sum(np.square(target - columns @ weights))), weights

    told: dict[str, tuple[float, Range]] = {}
    for params in _starts(cls, effect, context):
        plateaus: dict[str, Range] = {}
        unknown: set[str] = set()
        for name in [n for n in cls.refined if n in params]:
            if name in getattr(cls, "shares", ()):  # nothing hidden departs from the theory
                continue
            low, high = cls.bracket(name, params[name], context)
            ends = _sought(lambda v, n=name, p=params: fitted(p | {n: v})[0], low, high, name in cls.steps)
            params[name] = 0.5 * (ends[0] + ends[1])
            if name in cls.steps:
                plateaus[name] = ends
            elif not low * AT_EDGE < params[name] < high / AT_EDGE:
                unknown.add(name)
        loss, weights = fitted(params)
        found: dict[str, Range] = {
            name: value for name, (value, _) in cls.told(params, weights, context, reference).items()
        }
        for name, value in (found | plateaus).items():
            # A shape may have quantities of its own: each is that of the best shape that has it.
            if name not in told or loss < told[name][0]:
                told[name] = loss, (np.nan if name in unknown else value)
    return {name: value for name, (_, value) in told.items() if not np.isnan(value).any()}


def _columns(cls: type[Effect], params: dict[str, float], features: Features, reference: Reference):
    """Return what the diagnosis fits: where the velocity is late it looks ahead, which the live column cannot."""
    late = cls.late_s(params) if cls.delays else 0.0
    if late >= 0.0:
        return cls.columns(params)(features, reference)
    v, p = features.velocity_m_s, features.pressure_Pa
    return (reference.force(cls.seen(params, "velocity_m_s", v, features), p) - reference.force(v, p))[:, None]


def _starts(cls: type[Effect], effect: Effect, context: Context) -> list[dict[str, float]]:
    """Return each shape of the grid once, its refined parameters at the hidden values."""
    start = {name: effect.values[name] for name in cls.refined if name in effect.values}
    shapes: list[dict[str, float]] = []
    for params in cls.grid(context) or [{}]:
        shape = dict(params) | start
        if shape not in shapes:
            shapes.append(shape)
    if len(shapes) > 16:
        raise RuntimeError(f"{cls.name}: a refined parameter has another name than its key")
    return [*shapes, *(other for shape in shapes[:1] for other in cls.variants(shape))]


def _sought(loss, low: float, high: float, jumps: bool) -> list[float]:
    """Return the value of the least loss twice, or the ends of its plateau where the loss jumps."""
    if jumps:
        points = np.geomspace(low, high, SCAN) if low > 0.0 else np.linspace(low, high, SCAN)
        losses = np.array([loss(float(p)) for p in points])
        flat = np.flatnonzero(losses <= losses.min() * (1.0 + 1e-9))
        # The plateau reaches to the neighbouring points at most.
        return [float(points[max(flat[0] - 1, 0)]), float(points[min(flat[-1] + 1, SCAN - 1)])]
    found = minimize_scalar(
        lambda u: loss(float(np.exp(u))),
        bounds=(np.log(low), np.log(high)),
        method="bounded",
        options={"maxiter": EVALUATIONS, "xatol": 1e-5},
    )
    return [float(np.exp(found.x))] * 2


def _absorbed(features: Features, made: Made):
    """Return the columns of theory and odd static curve, (n, 1 + HATS)."""
    curve = SealCurve(made.config.seal)
    theory = curve.evaluate(features.velocity_m_s, features.pressure_Pa, features.temperature_degC)
    speed = np.abs(features.velocity_m_s)
    top = float(speed.max())
    knots = top / 60.0 * np.sinh(np.linspace(0.0, np.arcsinh(60.0), HATS + 1))
    place = np.interp(speed, knots, np.arange(HATS + 1.0))
    hats = np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(1.0, HATS + 1.0)))
    return np.column_stack([theory, np.sign(features.velocity_m_s)[:, None] * hats])


def _context(features: Features, made: Made) -> Context:
    """Return the facts of the record, whatever further ones the package asks for at their defaults."""
    inside = features.step_s[features.step_s > 0.0]
    low, high = float(features.position_m.min()), float(features.position_m.max())
    top = float(np.abs(features.velocity_m_s).max())
    facts = {
        "duration_s": float(features.time_s[-1]),
        "step_s": float(np.median(inside)),
        "distance_m": float(features.distance_m[-1]),
        "stroke_m": high - low,
        "centre_m": 0.5 * (low + high),
        "top_speed_m_s": top,
        "force_rms_N": float(np.sqrt(np.mean(np.square(made.samples.friction_N)))),  # as it is measured
        "force_top_N": float(np.abs(made.clean_N).max()),
        "pressure_mean_Pa": float(features.pressure_Pa.mean()),
        "pressure_span_Pa": float(np.ptp(features.pressure_Pa)),
        "sign_velocity_m_s": min(made.config.seal.sign_velocity, top / 20.0),
        "pressure_levels": int(np.count_nonzero(np.histogram(features.pressure_Pa, 10)[0] > 0.02 * features.size)),
        "channels": ("position", "pressure", "temperature"),
        "theory_told": float(np.ptp(features.pressure_Pa)) > ONE_PRESSURE * float(np.abs(features.pressure_Pa).max()),
    }
    known = {field.name for field in fields(Context)}
    return Context(**{name: value for name, value in facts.items() if name in known})


def _reference(made: Made, features: Features, gain: float, context: Context, plant: str) -> Reference:
    """Return the tables of the plant's own static curve; the theory's parts at the gain that the plant has of it."""
    temperature = float(features.temperature_degC.mean())
    low, high = float(features.pressure_Pa.min()), float(features.pressure_Pa.max())
    nodes = np.linspace(low, high, PRESSURE_NODES) if high - low > 1e-3 * abs(high) else np.array([low])
    viscous, boundary, theory = theory_parts(SealCurve(made.config.seal), gain, temperature)
    taps = np.array(CLEAN_TAPS[1:]) / CLEAN_TAPS[0] if plant == "clean" else np.zeros(0)

    def static(velocity, pressure):
        return _static(made, velocity, pressure, temperature)

    axis = VelocityAxis(context.top_speed_m_s)
    signs = context.sign_velocity_m_s, made.config.seal.sign_velocity
    tables = tabled((static, viscous, boundary, theory), axis, nodes)
    return Reference.of(tables, axis, nodes, signs[0], taps, signs[1])


def _static(made: Made, velocity, pressure, temperature: float):
    """Return the steady state of the plant: each velocity held for longer than anything remembers, (n,), N."""
    hold, step_s = 12, 1e3
    v, p = np.repeat(velocity, hold), np.repeat(pressure, hold)
    n = v.size
    time, zero, one = step_s * np.arange(n), np.zeros(n), np.ones(n)
    stamp = np.arange(n, dtype=np.int64)
    warm = np.full(n, temperature)
    trace = Trace(
        time, zero, v, zero, p, warm, zero, v, zero, stamp, stamp, np.abs(v), one, one, zero, law=made.law
    )  # fmt: skip
    return made.law(trace)[hold - 1 :: hold]
