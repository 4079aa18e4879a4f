"""Parts of a sweep: which configurations there are, and what order and noise their rows give."""

import math

import numpy as np
import pytest

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.settings.config import Config
from friction_estimator.documents.grid import parse_set, read_grid
from friction_estimator.sweep.grid import axis, drawn, grid, span
from friction_estimator.sweep.ranking import BLOCKS, RECORDINGS, rank

BASE = Config()
SPRING = "spring:centre=0,stiffness=3"

# The grid


def test_a_grid_is_every_combination_and_settings_of_other_laws_make_none_twice():
    found = grid(BASE, [axis("law", ["lms", "rls"]), axis("lms.step_size", [0.001, 0.01]), axis("fir.order", [0, 4])])
    assert len(found.settings) == 4 + 2
    assert {"model.law": "rls", "fir.order": 4} in found.settings
    assert {"model.law": "lms", "lms.step_size": 0.01, "fir.order": 0} in found.settings


def test_a_setting_of_a_law_that_none_uses_is_refused():
    """It was one configuration, ranked alone, and nothing said why."""
    step = axis("nlms.step_size", [0.001, 0.01])
    with pytest.raises(ConfigError, match=r"nlms\.step_size is of the law nlms, and the law is rls: add law=nlms"):
        grid(BASE, [step])
    with pytest.raises(ConfigError, match="the law is lms or rls"):
        drawn(BASE, [axis("law", ["lms", "rls"]), span("nlms.step_size", 0.001, 0.1)], 3, 0)
    assert len(grid(BASE, [axis("law", ["nlms", "rls"]), step]).settings) == 3


def test_combinations_that_cannot_be_are_left_out_and_told():
    found = grid(BASE, [axis("basis.finest_level", [-1, 2]), axis("basis.coarsest_level", [1, 3])])
    assert len(found.settings) == 3
    assert len(found.left_out) == 1
    assert "coarsest_level is 1, below basis.finest_level 2" in found.left_out[0]
    with pytest.raises(ConfigError, match=r"none of 1 combinations is a configuration: basis\.coarsest_level"):
        grid(BASE, [axis("basis.finest_level", [4])])


def test_a_million_combinations_are_refused_with_number_and_limit_before_any_is_made():
    axes = [axis(f"prior.{name}", list(np.linspace(0.1, 0.9, 100))) for name in ("tap_deviation", "tap_decay")]
    axes.append(axis("rls.forgetting_factor", list(np.linspace(0.9, 1.0, 100))))
    with pytest.raises(ConfigError, match=r"1000000 configurations \(100 x 100 x 100\), at most 10000"):
        grid(BASE, axes)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("fir.ordr", [1], "unknown parameter fir.ordr; nearest: fir.order"),
        ("step_size", [0.1], "step_size may be lms.step_size or nlms.step_size"),
        ("fir.order", [4, 99], r"fir.order: 99 is out of range \[0, 64\]"),
        ("fir.order", ["many"], "expected int"),
        ("fir.order", [[1, 2]], "expected int"),
        ("law", ["rls", "kalman"], "'kalman' is not one of lms, nlms, rls"),
        ("load.terms", ["inertia", "gravity"], "load.terms takes lists"),
        ("basis.velocity_range", [[-1.0, float("nan")]], "not a finite number"),
    ],
)
def test_alternatives_are_checked_as_a_parameter_file_is(name, values, message):
    with pytest.raises(ConfigError, match=message):
        axis(name, values)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("fir.order=0,4", ("fir.order", [0, 4])),
        (
            "load.terms=[],[inertia, 'gravity:sin=1.2,cos=0']",
            ("load.terms", [[], ["inertia", "gravity:sin=1.2,cos=0"]]),
        ),
        ("rls.forgetting_factor=1e-3,1", ("rls.forgetting_factor", [0.001, 1])),
        ("lms.guard=true,false", ("lms.guard", [True, False])),
        ("theory.table=a..b.csv", ("theory.table", ["a..b.csv"])),
    ],
)
def test_set_takes_values_as_yaml_has_them(text, expected):
    assert parse_set(text) == expected


@pytest.mark.parametrize(
    "text", ["fir.order", "fir.order=", "=4", "fir.order=4,,8", "fir.order=[4", "a={b: 1}", "x=1..2,3"]
)
def test_set_without_values_is_one_line(text):
    with pytest.raises(ConfigError, match=r"--set ") as caught:
        parse_set(text)
    assert "\n" not in str(caught.value)


def test_a_file_says_alternatives_by_lists_and_of_lists_by_lists_of_lists(tmp_path):
    path = tmp_path / "grid.yaml"
    path.write_text(
        "/**:\n  ros__parameters:\n    model: {law: [rls, nlms]}\n    fir.order: 6\n"
        "    basis.velocity_range: [-0.1, 0.1]\n    load.terms: [[], [inertia]]\n    theory.table: [a.csv, /b.csv]\n"
    )
    given = read_grid(path)
    assert dict(given.shared) == {"fir.order": 6, "basis.velocity_range": [-0.1, 0.1]}
    assert given.alternatives == {
        "model.law": ["rls", "nlms"],
        "load.terms": [[], ["inertia"]],
        "theory.table": [str(tmp_path / "a.csv"), "/b.csv"],
    }
    path.write_text("/**:\n  ros__parameters:\n    load.terms: [[[inertia]]]\n")
    with pytest.raises(ConfigError, match=r"grid\.yaml: .*expected a number or a word"):
        read_grid(path)


def test_draws_are_the_same_for_a_seed_within_their_spans_and_none_comes_twice():
    ways = [
        axis("law", ["nlms", "rls"]),
        span("fir.order", 0, 8),
        span("prior.tap_deviation", 0.01, 1.0, logarithmic=True),
    ]
    first, again, other = (drawn(BASE, ways, 200, seed).settings for seed in (0, 0, 1))
    assert first == again != other
    deviations = np.array([one["prior.tap_deviation"] for one in first])
    assert deviations.min() >= 0.01
    assert deviations.max() <= 1.0
    assert abs(np.mean(np.log10(deviations)) + 1.0) < 0.15  # even in the logarithm: the mean is the middle
    assert {one["fir.order"] for one in first} == set(range(9))
    few = drawn(BASE, [axis("law", ["nlms", "rls"])], 50, 0).settings
    assert sorted(one["model.law"] for one in few) == ["nlms", "rls"]
    with pytest.raises(ConfigError, match="--random 0"):
        drawn(BASE, ways, 0, 0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("law", 0, 1), "is no number"),
        (("fir.order", 8, 4), "lower end first"),
        (("fir.order", 0, 400), "out of range"),
        (("prior.weight_slope", 0, 4, True), "lower end above 0"),
    ],
)
def test_spans_are_checked(arguments, message):
    name, low, high, *log = arguments
    with pytest.raises(ConfigError, match=message):
        span(name, low, high, logarithmic=bool(log))


# Order and noise


def row(squares, samples=100, spread=1.0, begin=0, baselines=()):
    """Return a row whose blocks have these mean squares."""
    squares = np.asarray(squares, np.float64)
    return {
        "motion": "linear",
        "samples": 1000,
        "judged": [
            {
                "recording": "r",
                "samples": samples * squares.size,
                "spread_N": spread,
                "error_N": math.sqrt(squares.mean()),
                "baselines_N": dict(baselines),
                "begin_ns": list(range(begin, begin + squares.size)),
                "block_samples": [samples] * squares.size,
                "block_error_N2": (samples * squares).tolist(),
            }
        ],
    }


def named(count):
    return [{"fir.order": k} for k in range(count)]


def test_what_is_hard_for_all_drops_out_of_a_comparison():
    hard = np.exp(np.random.default_rng(0).normal(size=32))
    ranking = rank(named(2), [[row(0.01 * hard)], [row(0.0102 * hard)]])
    first, second = ranking.ranked
    assert ranking.noise_over == BLOCKS
    assert first.standard_error / first.nrmse > 0.05
    assert second.told
    assert second.comparison.ratio == pytest.approx(math.sqrt(1.02))
    assert second.comparison.high - second.comparison.low < 1e-9


def test_of_equal_configurations_the_true_best_is_told_from_the_apparent_one_in_few_sweeps():
    """The choice of the best of 20 is an advantage of its own: without the correction far more would be wrong."""
    generator = np.random.default_rng(1)
    wrong = 0
    for _ in range(200):
        rows = [[row(0.01 * np.exp(0.5 * generator.normal(size=24)))] for _ in range(20)]
        ranking = rank(named(20), rows)
        wrong += next(one for one in ranking.ranked if one.number == 0).told
    assert wrong <= 0.08 * 200


def test_blocks_that_drift_together_are_not_taken_for_independent_ones():
    slow = 0.01 * np.exp(np.sin(np.linspace(0.0, 2 * np.pi, 64)))
    fast = np.random.default_rng(0).permutation(slow)
    drifting, mixed = (rank(named(1), [[row(values)]]).ranked[0].standard_error for values in (slow, fast))
    assert drifting > 2.0 * mixed


def test_the_coverage_of_a_ratio_holds_for_blocks_that_follow_each_other():
    """Autoregressive blocks, 0.5 from one to the next: the interval of one comparison covers the true ratio."""
    generator, covered, trials = np.random.default_rng(2), 0, 300
    for _ in range(trials):
        noise = generator.normal(size=(2, 64))
        for k in range(1, 64):
            noise[:, k] = 0.5 * noise[:, k - 1] + math.sqrt(0.75) * noise[:, k]
        one, other = (row(0.01 * np.exp(0.2 * values)) for values in noise)
        ranking = rank(named(2), [[one], [other]])
        comparison = ranking.ranked[1].comparison
        covered += comparison.low <= 1.0  # the true ratio is 1, and the worse one is second by its figure
    assert covered >= 0.9 * trials


def test_six_recordings_give_the_noise_over_recordings_and_five_do_not():
    generator = np.random.default_rng(3)
    own = [row(0.01 * np.exp(generator.normal()) * np.ones(16)) for _ in range(6)]
    worse = [row(1.3 * np.array(one["judged"][0]["block_error_N2"]) / 100) for one in own]
    ranking = rank(named(2), [own, worse])
    assert ranking.noise_over == RECORDINGS
    assert ranking.ranked[1].comparison.ratio == pytest.approx(math.sqrt(1.3))
    assert ranking.ranked[1].told
    assert rank(named(2), [own[:5], worse[:5]]).noise_over == BLOCKS


def test_a_loud_recording_does_not_outvote_quiet_ones():
    """One recording gains 40 % where errors are 30 times as large, three others lose 30 %: the others win."""
    one = [row([0.9] * 8), *[row([0.001] * 8)] * 3]
    other = [row([0.9 / 1.96] * 8), *[row([0.00169] * 8)] * 3]
    assert rank(named(2), [other, one]).ranked[0].number == 1


def test_who_fails_on_a_recording_that_another_could_do_comes_after():
    good, bad = row([0.01] * 8), row([0.04] * 8)
    ranking = rank(named(3), [[good, None, None], [bad, bad, None], [None, None, None]])
    assert [(one.number, one.recordings, one.failed) for one in ranking.ranked] == [(1, 2, 0), (0, 1, 1)]


def test_rows_whose_blocks_differ_are_compared_unpaired():
    generator = np.random.default_rng(4)
    hard = np.exp(0.3 * generator.normal(size=32))
    paired = rank(named(2), [[row(0.01 * hard)], [row(0.012 * hard)]]).ranked[1].comparison
    apart = rank(named(2), [[row(0.01 * hard)], [row(0.012 * hard, begin=1)]]).ranked[1].comparison
    assert paired.ratio == apart.ratio
    assert paired.high - paired.low < 0.01 * (apart.high - apart.low)


def test_a_perfect_model_stays_a_number():
    ranking = rank(named(2), [[row([0.0] * 8)], [row([0.01] * 8)]])
    assert ranking.ranked[0].nrmse == pytest.approx(1e-12)
    assert ranking.ranked[1].told
