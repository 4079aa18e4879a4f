"""Claims about the structure: the order of the filters, and the basis of g."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.interpolate import BSpline

from friction_estimator.core.fit.batch import predict
from friction_estimator.core.fit.moments import gather
from friction_estimator.core.fit.variable_projection import on_gauge, refine, start_taps
from friction_estimator.core.metrics import nrmse
from friction_estimator.core.model.basis import WaveletBasis
from friction_estimator.core.model.structure import Model
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.groups import BasisConfig
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.paper.claims import Claim, below, geometric_mean, listed, verdict
from friction_estimator.paper.study import MODELS, Plan, derived, record
from friction_estimator.rig.drive import CONDITIONS, PA_PER_PSI, celsius
from friction_estimator.rig.plant import RigPlant

ORDERS = (0, 2, 4, 8, 12, 16)
PAPER_ORDER = 8
RATES = (200.0, 1000.0)
LITTLE = 0.05
"""A reduction of the error by less than this share is little."""

SIZES = (8, 16, 32, 64)
DRAWS = 4000
REACH_M_S = 0.13
NOISE = 0.01


def order_errors(plan: Plan, condition: str, seed: int, rate_hz: float) -> dict[str, dict[int, float]]:
    """Return by model and order the batch fit's error on the second half of a recording, learned on the first.

    Each order starts from the taps of the one below, so that a higher one cannot fit worse.
    """
    samples = record(plan, condition, seed, rate_hz)
    learned = np.arange(len(samples)) < len(samples) // 2
    errors: dict[str, dict[int, float]] = {}
    for model_type in MODELS:
        errors[model_type] = {}
        taps = np.ones(1)
        for order in ORDERS:
            config = derived(samples, model_type, fir__order=order)
            model = Model(config)
            moments = gather(model, samples, learned)
            longer = np.concatenate([taps, np.zeros(order + 1 - taps.size)])
            starts = [longer, *start_taps(moments, np.random.default_rng(0))[1:2]]
            theta = on_gauge(moments, min((refine(moments, start) for start in starts), key=moments.cost))
            taps = theta[: order + 1]
            predicted = predict(samples, config, model.split(theta))
            errors[model_type][order] = nrmse(samples.friction_N[~learned], predicted[~learned])
    return errors


def higher_orders_help_little(
    plan: Plan, errors: Mapping[tuple[str, float], Sequence[dict[str, dict[int, float]]]]
) -> Claim:
    """Judge the gain of order 16 over 8 by condition, sample rate and model."""
    cases: dict[str, bool | None] = {}
    numbers: dict[str, object] = {}
    for (condition, rate), runs in errors.items():
        for model in MODELS:
            ratio = geometric_mean([run[model][ORDERS[-1]] / run[model][PAPER_ORDER] for run in runs])
            name = f"{model} {condition} at {rate:g} Hz"
            little = below(ratio, 1.0 - LITTLE)
            cases[name] = None if little is None else not little
            numbers[name] = {
                f"order_{ORDERS[-1]}_over_{PAPER_ORDER}": ratio,
                "nrmse_by_order": {str(order): geometric_mean([run[model][order] for run in runs]) for order in ORDERS},
            }
    seeds = len(next(iter(errors.values())))
    return Claim(
        id="orders_above_8_help_little",
        statement="Filters of a higher order than 8 improve the performance slightly, not significantly.",
        experiment=f"{seeds} seeds of conditions a, b, c, {plan.seconds:g} s, {100 * plan.noise:g} % noise, at "
        f"{' and '.join(f'{rate:g}' for rate in RATES)} Hz; batch fit on the first half, error on the second, orders "
        f"{', '.join(map(str, ORDERS))}. Holds where the interval of error(16) / error(8) lies above {1 - LITTLE:g}.",
        numbers=numbers,
        verdict=verdict(cases.values()),
        why=f"Order 16 gains less than {100 * LITTLE:g} % for {listed(cases, True)}; more for {listed(cases, False)}; "
        f"undecided: {listed(cases, None)}.",
    )


def basis_errors(seed: int) -> dict[str, dict[int, float]]:
    """Return by family and number of functions the error of a least-squares fit to the plant's steady curve.

    The curve is learned from `DRAWS` noisy points, uniform in velocity, and scored without noise. Families: db3
    wavelets (the functions that help most are picked one by one, orthogonal matching pursuit, from levels -2 to 3 with
    the scaling functions of level 3), cubic B-splines on equal knots, Chebyshev polynomials; each in velocity as it is,
    and in companded velocity.
    """
    generator = np.random.default_rng([seed, 7])
    curve = RigPlant(SealConfig(), 1000.0).curve
    v = generator.uniform(-REACH_M_S, REACH_M_S, DRAWS)
    grid = np.linspace(-REACH_M_S, REACH_M_S, 2001)
    clean = _steady(curve, v)
    noisy = clean + NOISE * float(np.sqrt(np.mean(np.square(clean)))) * generator.standard_normal(DRAWS)
    truth = _steady(curve, grid)
    errors: dict[str, dict[int, float]] = {}
    for companding, suffix in ((0.0, ""), (BasisConfig().companding, ", companded")):
        inside, probe = (_position(at, companding) for at in (v, grid))
        basis = WaveletBasis(
            BasisConfig(velocity_range=(-REACH_M_S, REACH_M_S), finest_level=-2, companding=companding)
        )
        picked = pursue(basis.dense(v), noisy, max(SIZES))
        dense = basis.dense(grid)
        errors[f"wavelets{suffix}"] = {
            size: nrmse(truth, dense[:, picked[size][0]] @ picked[size][1]) for size in SIZES
        }
        for family, columns in (("B-splines", b_splines), ("polynomials", chebyshev)):
            errors[f"{family}{suffix}"] = {}
            for size in SIZES:
                weights = np.linalg.lstsq(columns(inside, size), noisy, rcond=None)[0]
                errors[f"{family}{suffix}"][size] = nrmse(truth, columns(probe, size) @ weights)
    return errors


def pursue(columns: Floats, target: Floats, most: int) -> list[tuple[list[int], Floats]]:
    """Return for 0 to `most` columns those that orthogonal matching pursuit picks, and their least-squares weights.

    Source: Pati, Rezaiifar, Krishnaprasad 1993. Columns (n, m), target (n,).
    """
    lengths = np.linalg.norm(columns, axis=0)
    unit = columns / np.where(lengths > 0.0, lengths, 1.0)
    gram, against = columns.T @ columns, columns.T @ target
    chosen: list[int] = []
    steps: list[tuple[list[int], Floats]] = [([], np.zeros(0))]
    residual = target
    for _ in range(min(most, columns.shape[1])):
        scores = np.abs(unit.T @ residual)
        scores[chosen] = -1.0
        chosen.append(int(np.argmax(scores)))
        weights = np.linalg.lstsq(gram[np.ix_(chosen, chosen)], against[chosen], rcond=1e-12)[0]
        residual = target - columns[:, chosen] @ weights
        steps.append((list(chosen), np.asarray(weights, np.float64)))
    return steps


def b_splines(position: Floats, size: int) -> Floats:
    """Return `size` cubic B-splines on equal knots over [-1, 1], (n, size)."""
    inner = np.linspace(-1.0, 1.0, size - 2)
    knots = np.concatenate([[-1.0] * 3, inner, [1.0] * 3])
    return np.asarray(BSpline.design_matrix(np.clip(position, -1.0, 1.0), knots, 3).toarray())


def chebyshev(position: Floats, size: int) -> Floats:
    """Return `size` Chebyshev polynomials on [-1, 1], (n, size)."""
    return np.asarray(np.polynomial.chebyshev.chebvander(position, size - 1))


def wavelets_need_fewer(runs: Sequence[dict[str, dict[int, float]]]) -> Claim:
    """Judge the error of B-splines and polynomials over that of as many wavelets."""
    cases: dict[str, bool | None] = {}
    numbers: dict[str, object] = {
        family: {str(size): geometric_mean([run[family][size] for run in runs]) for size in SIZES} for family in runs[0]
    }
    for suffix in ("", ", companded"):
        for rival in ("B-splines", "polynomials"):
            for size in SIZES:
                ratio = geometric_mean([run[f"wavelets{suffix}"][size] / run[f"{rival}{suffix}"][size] for run in runs])
                name = f"{size} {rival}{suffix}"
                cases[name] = below(ratio, 1.0)
                numbers[f"wavelets over {name}"] = ratio
    return Claim(
        id="wavelets_need_fewer_parameters",
        statement="Orthogonality and localisation of the Daubechies wavelets enable us to represent a function with "
        "fewer parameters.",
        experiment=f"{len(runs)} seeds; {DRAWS} points of the plant's steady curve (130 degF, 50 psi, velocities "
        f"uniform within {REACH_M_S} m/s) with {100 * NOISE:g} % noise; {', '.join(map(str, SIZES))} functions of each "
        "family by least squares, the wavelets picked by orthogonal matching pursuit; error over the std, without "
        "noise. Holds where the interval of the error of the wavelets over that of as many rivals lies below 1.",
        numbers=numbers,
        verdict=verdict(cases.values()),
        why=f"Fewer wavelets do for the error of {listed(cases, True)}; not of {listed(cases, False)}.",
    )


def _steady(curve: SealCurve, velocity: Floats) -> Floats:
    pressure = np.full(velocity.size, CONDITIONS["a"][1] * PA_PER_PSI)
    return curve.evaluate(velocity, pressure, np.full(velocity.size, celsius(130.0)))


def _position(velocity: Floats, companding: float) -> Floats:
    """Return velocity mapped onto [-1, 1], companded as the wavelet basis does."""
    u = velocity / REACH_M_S
    return np.asarray(np.arcsinh(companding * u) / np.arcsinh(companding)) if companding > 0.0 else u
