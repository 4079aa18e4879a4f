"""The paper's claims: verdicts follow the numbers, experiments measure what they say, and the verb writes it all."""

import json
import pickle
import re
from dataclasses import replace

import numpy as np
import pages
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.cli.main import main
from friction_estimator.core.fit.moments import gather
from friction_estimator.core.model.structure import Model, Parameters
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.paper import convergence, landscape, structure
from friction_estimator.paper.claims import below, geometric_mean, share, verdict
from friction_estimator.paper.study import BATCH, MODELS, Outcome, Plan, Study, derived, record, run_recording
from friction_estimator.rig.drive import CONDITIONS

SHORT = Plan(seeds=1, seconds=8.0)
IDS = {
    "hammerstein_converges", "parallel_ends_closer", "parallel_converges_faster", "good_before_convergence",
    "g_has_the_theorys_shape", "orders_above_8_help_little", "wavelets_need_fewer_parameters",
    "quadratic_cost_with_unique_minimum",
}  # fmt: skip


@given(st.lists(st.floats(0.01, 100.0), min_size=2, max_size=20), st.floats(0.1, 10.0))
def test_geometric_mean_lies_in_its_interval_and_scales(values, factor):
    one, scaled = geometric_mean(values), geometric_mean([factor * v for v in values])
    assert one.low <= one.value <= one.high
    assert scaled.value == pytest.approx(factor * one.value, rel=1e-9)


def test_intervals_cover_the_truth_as_often_as_they_say():
    generator = np.random.default_rng(0)
    draws = np.exp(generator.standard_normal((2000, 8)))  # geometric mean 1
    means = [geometric_mean(list(draw)) for draw in draws]
    covered = np.mean([i.low <= 1.0 <= i.high for i in means])
    assert covered == pytest.approx(0.95, abs=0.02)
    shares = [share(int(hits), 20) for hits in generator.binomial(20, 0.7, 1000)]
    assert np.mean([i.low <= 0.7 <= i.high for i in shares]) >= 0.94


@given(st.lists(st.sampled_from([True, False, None]), max_size=6))
def test_verdict(cases):
    expected = "depends"
    if cases and all(c is True for c in cases):
        expected = "confirmed"
    if cases and all(c is False for c in cases):
        expected = "refuted"
    assert verdict(cases) == expected
    assert [below(geometric_mean(pair), 1.0) for pair in ([0.5, 0.5], [2.0, 2.0], [0.5, 2.0])] == [True, False, None]


def made_up(errors):
    """A study of 6 seeds whose errors by (model, cycle number) are given, with a little scatter."""
    generator = np.random.default_rng(1)
    empty = Parameters(np.ones(1), np.zeros(1), *[np.zeros(0)] * 3)
    outcomes = {}
    for condition in CONDITIONS:
        for seed in range(6):
            for model in MODELS:
                cycles = np.array(errors[model]) * np.exp(0.01 * generator.standard_normal(len(errors[model])))
                for law in (*LAWS, BATCH):
                    outcomes[condition, seed, model, law] = Outcome(cycles, np.repeat(cycles, 10), cycles[0], empty)
    return Study(Plan(seeds=6), outcomes, {})


FAST = [0.1, 0.02, 0.01, 0.01, 0.01, 0.01, 0.01]
SLOW = [0.8, 0.5, 0.2, 0.02, 0.02, 0.02, 0.02, 0.02]


@pytest.mark.parametrize(("parallel", "hammerstein", "expected"), [(FAST, SLOW, "confirmed"), (SLOW, FAST, "refuted")])
def test_claims_about_parallel_follow_the_errors(parallel, hammerstein, expected):
    study = made_up({"parallel": parallel, "hammerstein": hammerstein})
    ratio = parallel[0] / hammerstein[0]
    scan = [{law: dict.fromkeys(convergence.WRONG_THEORIES, ratio * (1 + 0.001 * i)) for law in LAWS} for i in range(3)]
    assert convergence.parallel_ends_closer(study).verdict == expected
    assert convergence.parallel_converges_faster(study).verdict == expected
    assert convergence.good_before_convergence(study, {"a": scan}).verdict == expected


@pytest.mark.parametrize(
    ("errors", "expected"),
    [(FAST, "confirmed"), ([0.8, *[0.9] * 6], "refuted"), ([0.3, *[0.2] * 6], "refuted")],
)
def test_convergence_of_hammerstein_follows_the_errors(errors, expected):
    assert convergence.hammerstein_converges(made_up({"parallel": FAST, "hammerstein": errors})).verdict == expected


def test_samples_until_counts_from_the_last_window_above_the_level():
    run = Outcome(np.ones(3), np.array([5.0, 2.0, 3.0, 1.0, 1.0]), 1.0, Parameters(*[np.zeros(0)] * 5))
    assert [run.samples_until(level) for level in (5.0, 2.5, 1.0, 0.5)] == [0.0, 3.0, 3.0, float("inf")]
    assert replace(run, window_rms=np.array([1.0, np.nan])).samples_until(2.0) == float("inf")


@pytest.mark.parametrize(("gain", "expected"), [(0.99, "confirmed"), (0.5, "refuted")])
def test_claim_on_orders_follows_the_errors(gain, expected):
    runs = [
        {m: {o: (gain if o == 16 else 1.0) * (1 + 0.001 * i) for o in structure.ORDERS} for m in MODELS} for i in (0, 1)
    ]
    assert structure.higher_orders_help_little(Plan(), {("a", 200.0): runs}).verdict == expected


def test_higher_orders_never_fit_worse_and_the_film_wants_more_than_none():
    errors = structure.order_errors(Plan(seeds=1, seconds=8.0), "b", 0, 200.0)
    for by_order in errors.values():
        assert list(by_order) == list(structure.ORDERS)
        assert by_order[8] < 0.9 * by_order[0]


def test_pursuit_finds_the_columns_of_a_sparse_mixture():
    generator = np.random.default_rng(2)
    columns = generator.standard_normal((300, 40))
    target = columns[:, [3, 17, 29]] @ np.array([2.0, -1.0, 0.5])
    steps = structure.pursue(columns, target, 5)
    assert set(steps[3][0]) == {3, 17, 29}
    np.testing.assert_allclose(columns[:, steps[3][0]] @ steps[3][1], target, atol=1e-10)
    assert [len(chosen) for chosen, _ in steps] == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("size", [4, 8, 33])
def test_rival_bases_have_the_size_and_reproduce_cubics(size):
    x = np.linspace(-1.0, 1.0, 201)
    for columns in (structure.b_splines(x, size), structure.chebyshev(x, size)):
        assert columns.shape == (201, size)
        weights = np.linalg.lstsq(columns, x**3 - x, rcond=None)[0]
        np.testing.assert_allclose(columns @ weights, x**3 - x, atol=1e-9)
    np.testing.assert_allclose(structure.b_splines(x, size).sum(axis=1), 1.0, atol=1e-12)


def test_more_functions_fit_the_curve_better_and_no_family_beats_the_noise_by_magic():
    errors = structure.basis_errors(0)
    for by_size in errors.values():
        assert by_size[32] < by_size[8]
        assert min(by_size.values()) > 0.05 * structure.NOISE


def test_stationary_points_are_stationary_and_no_minima():
    """The report's gradient and curvature against differences of a cost computed from predictions."""
    found = landscape.examine(SHORT, "b", "hammerstein")
    samples = record(SHORT, "b", 0)
    moments = gather(Model(derived(samples, "hammerstein")), samples)
    origin = np.zeros(moments.size)
    assert found["origin"].gradient_norm == 0.0
    assert found["origin"].lowest_eigenvalue < -0.1 < 0.1 < found["origin"].highest_eigenvalue
    _, directions = np.linalg.eigh(moments.hessian(origin))
    down = 1e-3 * directions[:, 0]
    assert moments.cost(down) < moments.cost(origin) < moments.cost(1e-3 * directions[:, -1])
    assert found["others"]
    for point in found["others"]:
        assert point.gradient_norm < landscape.STATIONARY
        assert not point.is_minimum
        assert point.cost_over_lowest > 1.5
    assert found["minima"][0].cost_over_lowest == pytest.approx(1.0, abs=1e-3)
    assert found["orbits"]["largest_relative_change_of_cost"] < 1e-6 < found["orbits"]["largest_relative_distance"]
    assert found["not_quadratic"]["cost_halfway"] > 2.0 * found["not_quadratic"]["cost_at_either_end"]


def test_the_verdict_on_the_cost_follows_what_is_found():
    found = landscape.examine(SHORT, "b", "parallel")
    assert landscape.unique_minimum(SHORT, {("b", "parallel"): found}).verdict == "refuted"
    convex = found | {
        "orbits": {"largest_relative_change_of_cost": 1.0, "largest_relative_distance": 1.0},
        "not_quadratic": {
            "cost_at_either_end": 1.0, "cost_halfway": 0.5, "fourth_difference_over_largest_cost": 0.0,
        },
    }  # fmt: skip
    assert landscape.unique_minimum(SHORT, {("b", "parallel"): convex}).verdict == "confirmed"


def test_the_same_seed_gives_the_same_bits():
    one, two = (pickle.dumps(run_recording(SHORT, "b", 3)) for _ in range(2))
    assert one == two
    assert pickle.dumps(run_recording(SHORT, "b", 4)) != one


def test_the_verb_writes_claims_figures_and_one_page(capsys, tmp_path):
    out = tmp_path / "out"
    assert main(["reproduce", "--out", str(out), "--seeds", "2", "--seconds", "30"]) == 0
    told = capsys.readouterr().out
    document = json.loads((out / "claims.json").read_text())
    assert document["schema"] == "friction_estimator/claims/1"
    claims = document["claims"]
    assert {claim["id"] for claim in claims} == IDS
    for claim in claims:
        assert set(claim) == {"id", "statement", "experiment", "numbers", "verdict", "why"}
        assert claim["verdict"] in ("confirmed", "refuted", "depends")
        assert claim["numbers"]
        assert claim["why"].endswith(".")
        assert f"{claim['verdict']:<10} {claim['id']}" in told
    for number in "3456":
        assert (out / f"figure_{number}.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    page = (out / "index.html").read_text()
    assert pages.own(page).count("data:image/png;base64,") == 2  # Figs. 3 and 4; the others are charts
    assert len(pages.data(page)) == 18
    assert not re.search(r'(src|href)="(?!data:|#)', pages.own(page))
    assert not list(out.glob(".*"))
    unique = next(c for c in claims if c["id"] == "quadratic_cost_with_unique_minimum")
    assert unique["verdict"] == "refuted"


@pytest.mark.parametrize(("words", "named"), [(["--seeds", "1"], "--seeds 1"), (["--seconds", "10"], "--seconds 10")])
def test_too_little_is_refused(capsys, tmp_path, words, named):
    assert main(["reproduce", "--out", str(tmp_path / "out"), *words]) == 2
    error = capsys.readouterr().err
    assert named in error
    assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
