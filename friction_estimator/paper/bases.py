"""The claim that wavelets represent the curve with fewer parameters than other families of functions."""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import BSpline

from friction_estimator.core.metrics import nrmse
from friction_estimator.core.model.basis import WaveletBasis
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.groups import BasisConfig
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.paper.claims import ELSEWHERE, FROZEN, Claim, Judged, below, geometric_mean
from friction_estimator.rig.drive import CONDITIONS, PA_PER_PSI, celsius
from friction_estimator.rig.plant import RigPlant

SIZES = (8, 16, 32, 64)
DRAWS = 4000
REACH_M_S = 0.13
NOISE = 0.01


PICKED_AT, REUSED_AT = "a", "c"
"""Conditions: the wavelets are picked from the curve of the one and used, with new weights, on that of the other."""


def basis_errors(seed: int) -> dict[str, dict[str, dict[int, float]]]:
    """Return, frozen and elsewhere, by family and number of functions the error of a least-squares fit to the plant's
    steady curve.

    The curve is learned from `DRAWS` noisy points, uniform in velocity, and scored without noise. Families: db3
    wavelets (the functions that help most are picked one by one, orthogonal matching pursuit, from levels -2 to 3 with
    the scaling functions of level 3), cubic B-splines on equal knots, Chebyshev polynomials; each in velocity as it is,
    and in companded velocity. Elsewhere is another curve (`REUSED_AT`), to which all weights are fitted anew: the
    wavelets picked from the first one have to serve.
    """
    generator = np.random.default_rng([seed, 7])
    curve = RigPlant(SealConfig(), 1000.0).curve
    v = generator.uniform(-REACH_M_S, REACH_M_S, DRAWS)
    grid = np.linspace(-REACH_M_S, REACH_M_S, 2001)
    noise = generator.standard_normal(DRAWS)
    noisy, truth = {}, {}
    for mode, condition in ((FROZEN, PICKED_AT), (ELSEWHERE, REUSED_AT)):
        clean = _steady(curve, v, condition)
        noisy[mode] = clean + NOISE * float(np.sqrt(np.mean(np.square(clean)))) * noise
        truth[mode] = _steady(curve, grid, condition)
    errors: dict[str, dict[str, dict[int, float]]] = {mode: {} for mode in noisy}
    for companding, suffix in ((0.0, ""), (BasisConfig().companding, ", companded")):
        inside, probe = (_position(at, companding) for at in (v, grid))
        basis = WaveletBasis(
            BasisConfig(velocity_range=(-REACH_M_S, REACH_M_S), finest_level=-2, companding=companding)
        )
        columns, dense = basis.dense(v), basis.dense(grid)
        picked = pursue(columns, noisy[FROZEN], max(SIZES))
        for mode, target in noisy.items():
            errors[mode][f"wavelets{suffix}"] = {}
            for size in SIZES:
                chosen, weights = picked[size]
                if mode == ELSEWHERE:
                    weights = np.asarray(np.linalg.lstsq(columns[:, chosen], target, rcond=1e-12)[0], np.float64)
                errors[mode][f"wavelets{suffix}"][size] = nrmse(truth[mode], dense[:, chosen] @ weights)
            for family, functions in (("B-splines", b_splines), ("polynomials", chebyshev)):
                errors[mode][f"{family}{suffix}"] = {}
                for size in SIZES:
                    weights = np.asarray(np.linalg.lstsq(functions(inside, size), target, rcond=None)[0], np.float64)
                    errors[mode][f"{family}{suffix}"][size] = nrmse(truth[mode], functions(probe, size) @ weights)
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


def wavelets_need_fewer(runs: Sequence[dict[str, dict[str, dict[int, float]]]]) -> Claim:
    """Judge the error of wavelets over that of as many B-splines and polynomials."""
    cases: dict[str, dict[str, bool | None]] = {mode: {} for mode in runs[0]}
    numbers: dict[str, object] = {}
    for mode in runs[0]:
        ending = "" if mode == FROZEN else f" {mode}"
        for family in runs[0][mode]:
            numbers[f"{family}{ending}"] = {
                str(size): geometric_mean([run[mode][family][size] for run in runs]) for size in SIZES
            }
        for suffix in ("", ", companded"):
            for rival in ("B-splines", "polynomials"):
                for size in SIZES:
                    ratio = geometric_mean(
                        [run[mode][f"wavelets{suffix}"][size] / run[mode][f"{rival}{suffix}"][size] for run in runs]
                    )
                    cases[mode][f"{rival}{suffix} {size}"] = below(ratio, 1.0)
                    numbers[f"wavelets over {size} {rival}{suffix}{ending}"] = ratio
    judged = Judged(cases, numbers)
    return Claim(
        id="wavelets_need_fewer_parameters",
        statement="Orthogonality and localisation of the Daubechies wavelets enable us to represent a function with "
        "fewer parameters.",
        experiment=f"{len(runs)} seeds; {DRAWS} points of the plant's steady curve (130 °F, 50 psi, velocities "
        f"uniform within {REACH_M_S} m/s) with {100 * NOISE:g} % noise; {', '.join(map(str, SIZES))} functions of each "
        "family by least squares, the wavelets picked by orthogonal matching pursuit; error over the std, without "
        "noise. Elsewhere: the curve at 200 psi, weights fitted anew, with the wavelets picked at 50 psi. Holds where "
        "the interval of the error of the wavelets over that of as many rivals lies below 1.",
        numbers=numbers,
        verdict=judged.verdict,
        why=judged.told,
        verdicts=judged.verdicts,
        cases=judged.counts,
    )


def _steady(curve: SealCurve, velocity: Floats, condition: str) -> Floats:
    pressure = np.full(velocity.size, CONDITIONS[condition][1] * PA_PER_PSI)
    return curve.evaluate(velocity, pressure, np.full(velocity.size, celsius(130.0)))


def _position(velocity: Floats, companding: float) -> Floats:
    """Return velocity mapped onto [-1, 1], companded as the wavelet basis does."""
    u = velocity / REACH_M_S
    return np.asarray(np.arcsinh(companding * u) / np.arcsinh(companding)) if companding > 0.0 else u
