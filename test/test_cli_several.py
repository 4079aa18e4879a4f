"""`replay` and `identify` over several recordings, and other recordings as judges of what was learned."""

import json
from dataclasses import replace

import numpy as np
import pytest

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.bag.write import write_samples, writing
from friction_estimator.cli.main import main
from friction_estimator.core.metrics import spread
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import joined
from friction_estimator.core.settings.config import Config

pytestmark = pytest.mark.xdist_group("cli_several")

RIVALS = {"coulomb_viscous", "stribeck", "stribeck_asymmetric", "persistence", "theory"}
DRIVES = {"sine": "1:50:6", "triangle": "1:50:4:triangle", "slow": "2:50:6"}
MEMORY = Config().fir.order


def run(verb, *words):
    try:
        return main([verb, *map(str, words)])
    except SystemExit as end:
        return end.code


def result_of(capsys, verb, *words):
    capsys.readouterr()
    assert run(verb, *words, "--json", "-") == 0
    return json.loads(capsys.readouterr().out)


def samples_of(bag):
    return to_samples(read_recording(bag), Config()).samples


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Recordings of the rig, a few seconds at 200 Hz each."""
    folder = tmp_path_factory.mktemp("bags")
    for number, (name, schedule) in enumerate(DRIVES.items()):
        words = ["--out", folder / name, "--schedule", schedule, "--rate", 200, "--seed", number]
        assert run("simulate", *words) == 0
    return folder


# Learning


def test_recordings_are_learned_in_order(bags, capsys):
    result = result_of(capsys, "replay", bags / "sine", bags / "slow")
    parts = [samples_of(bags / name) for name in ("sine", "slow")]
    assert result["bags"] == [str(bags / "sine"), str(bags / "slow")]
    assert result["samples"] == {"read": 2400, "used": 2400, "rejected": {}}
    assert result["duration_s"] == pytest.approx(sum(part.duration_s for part in parts))
    assert result["sample_rate_hz"] == pytest.approx(200.0)
    assert (result["test"], result["baselines"], result["nrmse_frozen"]) == ([], None, None)
    other = result_of(capsys, "replay", bags / "slow", bags / "sine")
    assert other["nrmse"] != result["nrmse"]
    assert result["units"] == {"velocity": "m/s", "friction": "N"}


def test_errors_are_by_cycle_of_each_recording(bags, capsys):
    alone = [len(result_of(capsys, "replay", bags / name)["nrmse_by_cycle"]) for name in ("sine", "slow")]
    assert len(result_of(capsys, "replay", bags / "sine", bags / "slow")["nrmse_by_cycle"]) == sum(alone)


def test_the_same_recording_may_come_twice(bags, capsys):
    once = result_of(capsys, "replay", bags / "sine")
    twice = result_of(capsys, "replay", bags / "sine", bags / "sine", "--test", bags / "sine", bags / "sine")
    assert twice["samples"]["used"] == 2 * once["samples"]["used"]
    assert twice["duration_s"] == pytest.approx(2 * once["duration_s"])
    assert twice["nrmse_final"] < once["nrmse"]
    assert twice["test"][0] == twice["test"][1]


def test_a_restart_separates_the_recordings(bags):
    """The first prediction of a recording knows nothing of the one before but what was learned from it."""
    one, two = samples_of(bags / "sine"), samples_of(bags / "triangle")
    whole = joined([one, two])
    config = read_units(whole)
    share = len(one) / len(whole)
    frozen = replay(whole, config, freeze_after=share, starts=(0, len(one)))
    still = replace(one, velocity_m_s=one.velocity_m_s * np.linspace(1.0, 0.5, len(one)))
    mixed = replay(joined([still, two]), config, freeze_after=0.0, starts=(0, len(one)))
    fresh = replay(joined([one, two]), config, freeze_after=0.0, starts=(0, len(one)))
    np.testing.assert_array_equal(mixed.predicted_N[len(one) :], fresh.predicted_N[len(one) :])
    assert frozen.parts == [slice(0, len(one)), slice(len(one), len(whole))]
    assert np.all(np.diff(frozen.time_s[:]) > 0.0)


def read_units(samples):
    return Config.from_mapping(
        {"theory.kind": "seal", "basis.velocity_range": (-0.14, 0.14), "force_unit": float(np.std(samples.friction_N))}
    )


# Judging


@pytest.mark.usefixtures("blank_drawings")
def test_three_ways_to_the_same_judgement(bags, tmp_path, capsys):
    """--test, --freeze-after at the end of the first recording, and a learned configuration that does not learn."""
    given = tmp_path / "given.yaml"
    given.write_text("/**:\n  ros__parameters:\n    force_unit: 3.0\n    basis: {velocity_range: [-0.14, 0.14]}\n")
    words = ["--test", bags / "triangle", "--out", tmp_path / "out", "--config", given]
    learned = result_of(capsys, "replay", bags / "sine", *words)
    (test,) = learned["test"]
    count = len(samples_of(bags / "triangle"))
    assert (test["bag"], test["samples"]) == (str(bags / "triangle"), count)
    assert set(test) == {"bag", "samples", "nrmse", "baselines", "in_motion"}
    assert set(test["baselines"]) == RIVALS
    settings = tmp_path / "out" / "config.yaml"
    scored = result_of(capsys, "replay", bags / "triangle", "--config", settings, "--freeze-after", 0)
    assert scored["nrmse_frozen"] == pytest.approx(test["nrmse"], rel=1e-9)
    assert scored["parameters"] == learned["parameters"]
    total = count + learned["samples"]["used"]
    frozen = result_of(
        capsys, "replay", bags / "sine", bags / "triangle", "--freeze-after", learned["samples"]["used"] / total,
        "--config", given,
    )  # fmt: skip
    assert frozen["nrmse_frozen"] == pytest.approx(test["nrmse"], rel=1e-9)
    assert frozen["baselines"] == pytest.approx(test["baselines"], rel=1e-9)


@pytest.mark.parametrize("verb", ["replay", "identify"])
def test_without_learning_the_curves_have_nothing_to_be_fitted_to(bags, capsys, verb):
    extra = ["--fit-only"] if verb == "identify" else []
    result = result_of(capsys, verb, bags / "sine", "--freeze-after", 0.5, *extra)
    assert set(result["baselines"]) == RIVALS
    assert all(value > 0.0 for value in result["baselines"].values())
    assert result["schema"] == f"friction_estimator/{verb}/2"
    if verb == "replay":
        result = result_of(capsys, "replay", bags / "sine", "--freeze-after", 0)
        known = {name for name, value in result["baselines"].items() if value is not None}
        assert known == {"persistence", "theory"}
        assert result["nrmse_frozen"] is not None
        assert result["health"]["learned"] == 0


def test_a_model_without_theory_has_no_rival_of_that_name(bags, capsys):
    words = [bags / "sine", "--model", "hammerstein", "--freeze-after", 0.5, "--test", bags / "slow"]
    result = result_of(capsys, "replay", *words)
    assert result["baselines"]["theory"] is None
    assert result["test"][0]["baselines"]["theory"] is None


def test_the_memory_of_a_test_recording_does_not_count(bags, tmp_path, capsys):
    """What is measured where the delay lines are not filled yet changes no score: at the start, and after a gap."""
    samples = samples_of(bags / "triangle")
    stamps = samples.stamp_ns.copy()
    stamps[400:] += 5 * 10**9
    spoilt = samples.friction_N.copy()
    for begin in (0, 400):
        spoilt[begin : begin + MEMORY - 1] += 1e3  # the last of them is what f[k-1] guesses from
    write_samples(tmp_path / "whole", replace(samples, stamp_ns=stamps))
    write_samples(tmp_path / "spoilt", replace(samples, stamp_ns=stamps, friction_N=spoilt))
    words = ["--test", tmp_path / "whole", tmp_path / "spoilt"]
    one, other = result_of(capsys, "replay", bags / "sine", *words)["test"]
    assert {**one, "bag": ""} == {**other, "bag": ""}


def test_what_judges_is_not_learned_from(bags, tmp_path, capsys):
    samples = samples_of(bags / "triangle")
    write_samples(tmp_path / "wrong", replace(samples, friction_N=-3.0 * samples.friction_N))
    alone = result_of(capsys, "replay", bags / "sine")
    judged = result_of(capsys, "replay", bags / "sine", "--test", tmp_path / "wrong", bags / "triangle")
    assert judged["parameters"] == alone["parameters"]
    assert judged["nrmse"] == alone["nrmse"]
    assert judged["test"][0]["nrmse"] > 1.0 > judged["test"][1]["nrmse"]


@pytest.mark.usefixtures("blank_drawings")
def test_identify_fits_all_and_is_judged(bags, tmp_path, capsys):
    words = [bags / "sine", bags / "slow", "--test", bags / "triangle", "--fit-only", "--out", tmp_path / "out"]
    result = result_of(capsys, "identify", *words)
    assert result["bags"] == [str(bags / "sine"), str(bags / "slow")]
    assert result["samples"]["used"] == 2400
    (test,) = result["test"]
    assert test["nrmse"] < test["baselines"]["coulomb_viscous"]
    scored = result_of(
        capsys, "replay", bags / "triangle", "--config", tmp_path / "out" / "config.yaml", "--freeze-after", 0
    )
    assert scored["nrmse_frozen"] == pytest.approx(test["nrmse"], rel=1e-9)


# Shown


def test_the_table_has_every_rival_in_nrmse_and_in_newton(bags, capsys):
    assert run("replay", bags / "sine", "--test", bags / "slow", "--freeze-after", 0.7) == 0
    lines = capsys.readouterr().out.splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("without learning"))
    assert lines[head].split()[-8:] == ["unit", "model", "coulomb+viscous", "stribeck", "asym.", "stribeck", "f[k-1]",
                                        "theory"]  # fmt: skip
    frozen, _, test, newton = (line.split() for line in lines[head + 1 : head + 5])
    assert frozen[:2] == ["after", "--freeze-after"]
    assert test[0] == str(bags / "slow")
    scale = spread(samples_of(bags / "slow").friction_N[MEMORY:])
    assert [float(n) for n in newton[1:]] == pytest.approx([scale * float(n) for n in test[3:]], rel=2e-3)


@pytest.mark.usefixtures("blank_drawings")
def test_results_hold_a_recording_each(bags, tmp_path, capsys):
    out = tmp_path / "out"
    result = result_of(capsys, "replay", bags / "sine", bags / "slow", "--test", bags / "triangle", "--out", out)
    assert sorted(path.name for path in (out / "bag").iterdir()) == ["1_sine", "2_slow"]
    for name in ("sine", "slow"):
        place = next((out / "bag").glob(f"*_{name}"))
        measured, made = samples_of(bags / name), samples_of(place)
        np.testing.assert_array_equal(made.friction_N, measured.friction_N)
        topics = {"friction": "/friction_estimator/residual"}
        residual = to_samples(read_recording(place, topics=topics), Config()).samples
        np.testing.assert_array_equal(residual.stamp_ns, measured.stamp_ns)
    page = (out / "report.html").read_text()
    assert "On other data" in page
    assert str(bags / "triangle") in page
    assert f"{result['test'][0]['nrmse']:.4g}" in page
    assert json.loads((out / "summary.json").read_text()) == result
    # One recording takes the place of several, and the reverse.
    assert run("replay", bags / "slow", "--out", out) == 0
    np.testing.assert_array_equal(samples_of(out / "bag").friction_N, samples_of(bags / "slow").friction_N)
    assert "On other data" not in (out / "report.html").read_text()
    assert run("replay", bags / "slow", bags / "sine", "--out", out) == 0
    assert sorted(path.name for path in (out / "bag").iterdir()) == ["1_slow", "2_sine"]


def test_a_folder_of_the_users_is_not_replaced(bags, tmp_path, capsys):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "notes.txt").write_text("mine")
    assert run("replay", bags / "sine", bags / "slow", "--out", tmp_path) == 2
    assert "does not hold such results" in one_line(capsys)
    assert (tmp_path / "bag" / "notes.txt").read_text() == "mine"


# Wrong uses


def one_line(capsys):
    lines = [line for line in capsys.readouterr().err.splitlines() if "warning:" not in line]
    assert len(lines) == 1
    assert "Traceback" not in lines[0]
    return lines[0]


@pytest.mark.parametrize("verb", ["replay", "identify"])
def test_a_missing_judge_is_known_before_anything_is_computed(bags, tmp_path, capsys, verb):
    assert run(verb, bags / "sine", "--test", bags / "slow", tmp_path / "none", "--out", tmp_path / "out") == 2
    assert f"{tmp_path / 'none'}: no such file" in one_line(capsys)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("verb", ["replay", "identify"])
def test_a_judge_without_the_topics_cannot_answer(bags, tmp_path, capsys, verb):
    with writing(tmp_path / "oil") as writer:
        stamps = np.arange(1, 11, dtype=np.int64) * 10**8
        writer.add_stream("/oil", "sensor_msgs/msg/Temperature", stamps, np.full(10, 50.0), quantity="temperature")
    assert run(verb, bags / "sine", "--test", tmp_path / "oil") == 1
    assert str(tmp_path / "oil") in one_line(capsys)


def test_a_topic_that_the_judge_lacks_is_one_line(bags, tmp_path, capsys):
    samples = samples_of(bags / "slow")
    with writing(tmp_path / "other") as writer:
        for name, kind in (("velocity", "TwistStamped"), ("friction", "WrenchStamped")):
            value = getattr(samples, {"velocity": "velocity_m_s", "friction": "friction_N"}[name])
            writer.add_stream(f"/b/{name}", f"geometry_msgs/msg/{kind}", samples.stamp_ns, value, quantity=name)
    assert run("replay", bags / "sine", "--test", tmp_path / "other") == 0
    capsys.readouterr()
    assert run("replay", bags / "sine", "--test", tmp_path / "other", "--topic", "velocity=/velocity") == 2
    assert f"{tmp_path / 'other'}" in one_line(capsys)


@pytest.mark.parametrize(("part", "says"), [(slice(0, MEMORY + 1), "too few"), (slice(0, 200), "friction is constant")])
def test_a_judge_that_cannot_judge_is_named(bags, tmp_path, capsys, part, says):
    samples = samples_of(bags / "slow")[part]
    constant = samples.friction_N if len(samples) < 100 else np.full(len(samples), 2.0)
    write_samples(tmp_path / "poor", replace(samples, friction_N=constant))
    assert run("replay", bags / "sine", "--test", tmp_path / "poor") == 1
    line = one_line(capsys)
    assert says in line
    assert str(tmp_path / "poor") in line


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--freeze-after", "-0.01"], "0 to 1"),
        (["--freeze-after", "1.01"], "0 to 1"),
        (["--freeze-after", "nan"], "0 to 1"),
        (["--test"], "--test"),
    ],
)
@pytest.mark.parametrize("verb", ["replay", "identify"])
def test_wrong_words_are_one_line(bags, capsys, verb, words, says):
    assert run(verb, bags / "sine", *words) == 2
    assert says in one_line(capsys)


def test_identify_does_not_score_without_fitting_and_says_who_does(bags, capsys):
    assert run("identify", bags / "sine", "--freeze-after", 0) == 2
    assert "replay takes 0" in one_line(capsys)
