"""The base model of the diagnosis: its descent, its two memories, one time of the whole force."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_records import abba, names, record, set_of

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis import base_problem
from friction_estimator.diagnosis.base import BaseFit, fit_base
from friction_estimator.diagnosis.base_problem import ALARM, BaseProblem, Capacity, Coefficients
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.diagnosis.lagged import LaggedProducts, lagged
from friction_estimator.diagnosis.odd_curve import SPLINES
from friction_estimator.diagnosis.record import build_record
from friction_estimator.effects import EFFECTS

SEAL = Config.from_mapping({"theory.kind": "seal"})

LATE = ["time_delay:delay=0.003", "time_delay:delay=0.02", "sensor_lowpass:time_constant=0.009", ""]


@pytest.fixture(scope="module", params=LATE)
def problem(request: pytest.FixtureRequest) -> BaseProblem:
    hidden = [request.param] if request.param else []
    return BaseProblem(build_record([record(hidden)], Config()), SEAL, Capacity(SPLINES, 8))


def test_the_base_fit_descends_to_where_its_tangent_promises_no_more(problem: BaseProblem) -> None:
    assert problem.fit().promise < ALARM


def cost(found: Coefficients, variance: float) -> float:
    """Return the cost of a fit at a given variance of the residual: error power and prior."""
    return found.power + variance * (found.cost - found.power) / found.variance


def test_no_start_gets_worse_and_the_best_is_kept(problem: BaseProblem, monkeypatch: pytest.MonkeyPatch) -> None:
    best = problem.fit()
    rng = np.random.default_rng(2)
    starts = [replace(best, taps=t) for t in (np.zeros(8), np.ones(8), 3.0 * 0.9 ** np.arange(8), rng.random(8))]
    ends = [problem.fit(starts=[start]) for start in starts]
    again = problem.fit(starts=[best])
    monkeypatch.setattr(base_problem, "STEPS", 0)
    for start, end in zip(starts, ends, strict=True):
        assert cost(end, end.variance) <= cost(problem.fit(starts=[start]), end.variance)
        assert cost(best, best.variance) <= 1.01 * cost(end, best.variance)
    assert cost(again, best.variance) <= 1.001 * best.cost


def test_theory_and_mismatch_may_have_unlike_memories(monkeypatch: pytest.MonkeyPatch) -> None:
    """f = d + H g: the theory passes through, the mismatch has a memory of six samples; one FIR cannot be both."""
    data = build_record([record(plant="parallel_memory")], Config())
    rms = float(np.sqrt(np.mean(np.square(data.friction_N))))
    assert np.std(fit_base(data, SEAL).residual_N) == pytest.approx(0.01 * rms, rel=0.03)
    monkeypatch.setattr(base_problem, "OWN_LAGS", 1e-9)
    assert np.std(fit_base(data, SEAL).residual_N) > 0.011 * rms


@pytest.mark.parametrize("plant", ["parallel_memory", "stribeck"])
def test_plants_of_another_hand_show_nothing_where_nothing_is_hidden(plant: str) -> None:
    result = diagnose([record(plant=plant)], Config())
    assert result.verdict == "nothing_found", names(result)
    assert result.nrmse_holdout < 1.05 * result.noise_floor


def test_a_lagging_film_is_a_frictional_lag_and_nothing_else() -> None:
    result = diagnose([record(plant="film_lag", segments=abba()[:4])], Config())
    assert names(result) == ["frictional_lag"]
    assert result.unexplained_percent < 5.0


@pytest.mark.parametrize("delay", [0.0003, 0.003, 0.02])
def test_a_delay_is_found_within_its_interval(delay: float) -> None:
    result = diagnose([record([f"time_delay:delay={delay}"], segments=abba()[:4])], Config())
    assert len(names(result)) == 1
    first = result.effects[0]
    assert "time_delay" in set_of(first)
    if delay > 0.5 * result.context.step_s:  # shorter ones are told from a filter of the same delay by luck
        assert first.name == "time_delay"
    (fitted,) = first.parameters.values()
    assert fitted.low <= delay <= fitted.high
    assert fitted.high - fitted.low < max(0.2 * delay, 0.25 * result.context.step_s)
    assert result.unexplained_percent < 5.0


@pytest.mark.parametrize("time_constant", [0.002, 0.009])
def test_a_filter_is_found_within_its_interval(time_constant: float) -> None:
    result = diagnose([record([f"sensor_lowpass:time_constant={time_constant}"], segments=abba()[:4])], Config())
    assert len(names(result)) == 1
    first = result.effects[0]
    assert "sensor_lowpass" in set_of(first)
    if first.name == "sensor_lowpass":
        fitted = first.parameters["time_constant"]
        assert fitted.low <= time_constant <= fitted.high
    assert result.unexplained_percent < 5.0


def test_the_model_of_one_time_is_the_static_force_of_another_time() -> None:
    """A delay of three whole samples, taken in by the columns, leaves the taps what they were without it."""
    plain = fit_base(build_record([record()], Config()), SEAL)
    late = BaseProblem(build_record([record(["time_delay:delay=0.015"])], Config()), SEAL, Capacity(SPLINES, 8))
    moved = late.with_static(EFFECTS["time_delay"].whole({"delay": 0.015}, late.tables, late.record.features))
    fit = BaseFit.of(moved, moved.fit())
    assert fit.effective_taps[:3] == pytest.approx(plain.effective_taps[:3], abs=0.03)
    assert np.std(fit.residual_N) == pytest.approx(np.std(plain.residual_N), rel=0.05)


@pytest.mark.parametrize(("order", "gaps"), [(0, 0.0), (5, 0.0), (5, 0.05), (40, 0.02)])
def test_products_of_lagged_columns_are_sums_over_the_samples_in_use(order: int, gaps: float) -> None:
    """Formed from those of lag 0, across pieces shorter than the memory and samples out of use."""
    rng = np.random.default_rng(5)
    n, width = 300, 3
    static, force = rng.standard_normal((n, width)), rng.standard_normal(n)
    static[rng.random((n, width)) < 0.4] = 0.0
    used, restart = rng.random(n) >= gaps, rng.random(n) < gaps
    restart[0] = True
    block = np.sort(rng.integers(0, 4, n))
    found = LaggedProducts(static, order, force, used, restart, block)
    for b, gram, cross in zip(range(4), found.gram, found.cross, strict=True):
        columns = np.array([lagged(static, i, found.start) for i in range(order + 1)]).transpose(1, 0, 2).reshape(n, -1)
        here = columns * (used & (block == b))[:, None]
        np.testing.assert_allclose(gram, here.T @ here, atol=1e-11)
        np.testing.assert_allclose(cross, here.T @ force, atol=1e-11)
