"""The verb `replay`: figures, files, wrong uses; real measurements where they are at hand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pages
import pytest

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.bag.source import Source
from friction_estimator.bag.write import RecordingWriter, write_samples, writing
from friction_estimator.cli.main import main
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import usual_magnitude
from friction_estimator.documents.configuration import read_config

ROOT = Path(__file__).parents[1]
DEMO = ROOT / "bags" / "demo"
KEYS = {
    "schema", "bags", "units", "baselines", "curve", "test",
    "model", "law", "samples", "sample_rate_hz", "duration_s", "nrmse", "nrmse_persistence",
    "nrmse_final", "nrmse_by_cycle", "nrmse_frozen", "fit_percent", "theory_nrmse", "diverged", "samples_per_second",
    "parameters",
}  # fmt: skip


def run(*words):
    try:
        return main(["replay", *map(str, words)])
    except SystemExit as end:
        return end.code


def replayed(capsys, *words):
    assert run(*words, "--json", "-") == 0
    return json.loads(capsys.readouterr().out)


@pytest.fixture
def demo() -> Samples:
    return to_samples(read_recording(DEMO), Config()).samples


def test_json_has_every_key_of_the_contract(capsys):
    result = replayed(capsys, DEMO)
    assert set(result) >= KEYS
    assert result["schema"] == "friction_estimator/replay/2"
    assert result["samples"] == {"read": 4400, "used": 4400, "rejected": {}}
    assert result["nrmse_frozen"] is None
    assert result["nrmse_final"] < 0.05 < result["nrmse_persistence"]
    assert result["fit_percent"] == pytest.approx(100 * (1 - result["nrmse_final"]))
    assert len(result["nrmse_by_cycle"]) == 10  # tenths: three drives have no cycle in common
    assert not result["diverged"]


@pytest.mark.parametrize("law", ["lms", "nlms", "rls"])
@pytest.mark.parametrize("model", ["hammerstein", "parallel"])
def test_every_law_and_model_runs_and_learns(capsys, law, model):
    result = replayed(capsys, DEMO, "--law", law, "--model", model)
    assert (result["law"], result["model"]) == (law, model)
    assert (result["theory_nrmse"] is None) == (model == "hammerstein")
    assert (result["parameters"]["theory_taps"] is None) == (model == "hammerstein")
    cycles = result["nrmse_by_cycle"]
    assert cycles[-1] < 0.8 * cycles[0]


def test_frozen_part_is_predicted_without_learning(capsys, demo):
    result = replayed(capsys, DEMO, "--freeze-after", 0.5)
    assert result["nrmse_frozen"] < 0.06
    config = Config()
    frozen = replay(demo, config, freeze_after=0.5)
    # Nothing after the freeze may depend on the measurements there.
    half = round(0.5 * len(demo))
    wrong = demo.friction_N.copy()
    wrong[half:] = 0.0
    blind = replay(replace(demo, friction_N=wrong), config, freeze_after=0.5)
    np.testing.assert_array_equal(blind.predicted_N, frozen.predicted_N)


def test_results_are_whole_and_feed_the_next_run(tmp_path, capsys):
    out = tmp_path / "out"
    assert run(DEMO, "--out", out) == 0
    assert {p.name for p in out.iterdir()} == {"bag", "figures", "report.html", "summary.json", "config.yaml"}
    assert {p.name for p in (out / "figures").iterdir()} == {
        "signals.png", "convergence.png", "friction_map.png", "taps.png",
    }  # fmt: skip
    page = (out / "report.html").read_text()
    assert len(pages.data(page)) == 9
    assert "http" not in pages.own(page)
    assert "Predicted to ±" in pages.words(page)
    first = json.loads((out / "summary.json").read_text())
    capsys.readouterr()
    warm = replayed(capsys, out / "bag", "--config", out / "config.yaml")
    assert warm["samples"] == first["samples"]
    assert warm["nrmse"] < 0.9 * first["nrmse"]  # the values are warm, their covariance is that of a cold start
    config = read_config(out / "config.yaml")
    assert len(config.learned.fir_taps) == config.fir.order + 1
    # The enriched recording holds the predictions, stamp by stamp.
    topics = {"friction": "/friction_estimator/friction_predicted"}
    predicted = to_samples(read_recording(out / "bag", topics=topics), Config()).samples
    residual = to_samples(read_recording(out / "bag", topics={"friction": "/friction_estimator/residual"}), Config())
    measured = to_samples(read_recording(out / "bag"), Config()).samples
    np.testing.assert_allclose(predicted.friction_N + residual.samples.friction_N, measured.friction_N, atol=1e-12)


def test_a_replay_repeats_bit_for_bit(capsys):
    first, second = replayed(capsys, DEMO), replayed(capsys, DEMO)
    first.pop("samples_per_second")
    second.pop("samples_per_second")
    assert first == second


def test_an_existing_folder_of_the_users_is_not_touched(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("mine")
    assert run(DEMO, "--out", tmp_path) == 2
    assert "does not hold such results" in capsys.readouterr().err
    assert [item.name for item in tmp_path.iterdir()] == ["notes.txt"]


def faulty(tmp_path, demo, **changes):
    """Write the demo with changed arrays; stamps are written as they are, in this order."""
    samples = replace(demo, **changes)
    path = tmp_path / "faulty"
    log = 1_000_000_000 + np.arange(len(samples), dtype=np.int64) * 5_000_000
    with writing(path) as writer:
        assert isinstance(writer, RecordingWriter)
        for quantity, kind, values in (
            ("velocity", "geometry_msgs/msg/TwistStamped", samples.velocity_m_s),
            ("friction", "geometry_msgs/msg/WrenchStamped", samples.friction_N),
        ):
            writer.add_stream(f"/{quantity}", kind, samples.stamp_ns, values, quantity=quantity, log_time_ns=log)
    return path


def test_bad_samples_are_counted_by_reason(tmp_path, demo, capsys):
    demo = demo[:2000]
    stamp, v, f = demo.stamp_ns.copy(), demo.velocity_m_s.copy(), demo.friction_N.copy()
    f[100:103] = np.nan
    v[200] = np.nan
    f[300] = np.inf
    stamp[400] = stamp[399]
    stamp[500:502] = stamp[490:492]
    stamp[600] = 0
    result = replayed(capsys, faulty(tmp_path, demo, stamp_ns=stamp, velocity_m_s=v, friction_N=f))
    assert result["samples"]["rejected"] == {
        "nan": 4, "infinite": 1, "duplicate_stamp": 1, "backward_stamp": 2, "zero_stamp": 1,
    }  # fmt: skip
    assert result["samples"]["used"] == 2000 - 9
    assert result["samples"]["read"] == 2000


def test_missing_partners_are_counted(tmp_path, demo, capsys):
    demo = demo[:1000]
    path = tmp_path / "lossy"
    keep = np.ones(1000, np.bool_)
    keep[[10, 500, 501]] = False
    with writing(path) as writer:
        writer.add_stream(
            "/velocity", "geometry_msgs/msg/TwistStamped", demo.stamp_ns, demo.velocity_m_s, quantity="velocity"
        )
        writer.add_stream("/friction", "geometry_msgs/msg/WrenchStamped", demo.stamp_ns[keep], demo.friction_N[keep])
    result = replayed(capsys, path)
    assert result["samples"] == {"read": 1000, "used": 997, "rejected": {"unmatched": 3}}


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["nowhere"], 2, "no such file"),
        ([DEMO, "--freeze-after", "1.5"], 2, "freeze-after"),
        ([DEMO, "--law", "kalman"], 2, "--law"),
        ([DEMO, "--topic", "speed=/v"], 2, "unknown input"),
        ([DEMO, "--topic", "velocity=/none"], 2, "/none"),
        ([DEMO, "--config", "none.yaml"], 2, "none.yaml"),
        ([], 2, "BAG"),
    ],
)
def test_wrong_uses_say_what_to_do_in_one_line(words, code, says, capsys):
    assert run(*words) == code
    err = capsys.readouterr().err
    assert says in err
    assert "Traceback" not in err
    assert len(err.strip().splitlines()) == 1


def test_parallel_without_a_theory_is_hammerstein_and_says_so(tmp_path, capsys):
    config = tmp_path / "none.yaml"
    config.write_text("/**:\n  ros__parameters:\n    theory:\n      kind: none\n")
    assert run(DEMO, "--config", config) == 0
    assert "theory.kind is none, so parallel is run as hammerstein" in capsys.readouterr().out


def test_force_unit_is_blind_to_spikes_and_standstill():
    t = np.arange(10_000)
    f = 5.0 * np.sign(np.sin(t / 50.0))
    f[(t // 1000) % 5 != 0] = 0.0
    f[::100] = 1e6
    assert usual_magnitude(lambda: [f]) == pytest.approx(5.0, rel=0.1)
    assert usual_magnitude(lambda: [np.zeros(5)]) == 0.0
    assert usual_magnitude(lambda: [np.array([np.nan])]) == 0.0


def test_emps_is_predicted_without_a_configuration(shared_data, tmp_path, capsys):
    table = shared_data / "emps_nlgreyfast" / "data.csv"
    assert (
        main(
            ["import", str(table), "--out", str(tmp_path / "emps"), "--time", "t_s", "--map",
             "velocity=v_m_s,friction=friction_filt_N,position=q_filt_m"]
        )
        == 0
    )  # fmt: skip
    capsys.readouterr()
    result = replayed(capsys, tmp_path / "emps", "--law", "rls", "--model", "hammerstein", "--freeze-after", 0.5)
    assert result["samples"]["used"] == 24841
    assert result["nrmse_frozen"] <= 0.055


@pytest.mark.parametrize("level", [0.0, 3.3])  # the standard deviation of 1000 times 3.3 is rounded to 4e-16
@pytest.mark.parametrize("verb", ["replay", "identify"])
def test_constant_friction_cannot_answer(tmp_path, capsys, demo, level, verb):
    write_samples(tmp_path / "bag", replace(demo, friction_N=np.full(len(demo), level)))
    assert main([verb, str(tmp_path / "bag"), "--json", "-"]) == 1
    out, err = capsys.readouterr()
    assert not out
    assert f"friction is constant at {level:g} N" in err.splitlines()[-1]


def test_a_clock_that_jumps_back_leaves_the_duration_positive(demo):
    stamps = demo.stamp_ns.copy()
    stamps[2000:] -= 3600 * 10**9
    looped = replace(demo, stamp_ns=stamps, restart=np.isin(np.arange(len(demo)), (0, 2000)))
    step_s = (stamps[1] - stamps[0]) / 1e9
    assert looped.duration_s == pytest.approx(demo.duration_s - step_s)


def test_an_end_at_rest_is_no_divergence(demo):
    samples = with_rest(demo)
    figures = replay(samples, Config()).figures()
    assert figures["nrmse_final"] > 2.0
    assert not figures["diverged"]


def with_rest(samples: Samples) -> Samples:
    """Return the samples, the last third at rest under a friction that hardly changes."""
    rest = np.arange(len(samples)) >= 2 * len(samples) // 3
    ripple = 1e-9 * (np.arange(len(samples)) % 2)
    return replace(
        samples,
        velocity_m_s=np.where(rest, 0.0, samples.velocity_m_s),
        friction_N=np.where(rest, 1.0 + ripple, samples.friction_N),
    )


@pytest.mark.usefixtures("blank_drawings")
def test_results_stand_beside_the_inputs_whatever_clock_made_the_stamps(tmp_path, demo):
    """Stamps of a simulated clock that loops once, recorded in one go years later."""
    samples, half = demo[:1000], 500
    stamps = np.concatenate([samples.stamp_ns[:half]] * 2)
    log_times = 1_700_000_000 * 10**9 + np.arange(1000) * 2_000_000
    with writing(tmp_path / "bag") as writer:
        for name, kind in (("velocity", "TwistStamped"), ("friction", "WrenchStamped")):
            value = getattr(samples, {"velocity": "velocity_m_s", "friction": "friction_N"}[name])
            writer.add_stream(
                f"/{name}", f"geometry_msgs/msg/{kind}", stamps, value, quantity=name, log_time_ns=log_times
            )
    assert run(tmp_path / "bag", "--out", tmp_path / "out") == 0
    with Source(tmp_path / "out" / "bag") as source:
        names = [topic.name for topic in source.topics]
        messages = list(source.messages(names))
    times = {name: [time for topic, time, _ in messages if topic == name] for name in names}
    assert times["/friction_estimator/residual"] == times["/friction"]
    assert len(times["/friction_estimator/parameters/fir_taps"]) == 63  # every 16 samples, and at the end
    assert set(times["/friction_estimator/parameters/fir_taps"]) < set(times["/friction"])


@pytest.mark.usefixtures("blank_drawings")
def test_the_configuration_written_for_a_joint_suits_the_node(tmp_path, demo):
    with writing(tmp_path / "bag") as writer:
        values = {"velocity": demo.velocity_m_s, "friction": demo.friction_N}
        writer.add_stream("/joint_states", "sensor_msgs/msg/JointState", demo.stamp_ns, values, joint="slide")
    assert run(tmp_path / "bag", "--out", tmp_path / "out") == 0
    config = read_config(tmp_path / "out" / "config.yaml")
    assert (config.input.mode, config.input.joint) == ("joint_state", "slide")
    assert run(tmp_path / "bag", "--config", tmp_path / "out" / "config.yaml") == 0


@pytest.mark.usefixtures("blank_drawings")
def test_learned_values_keep_their_units(tmp_path, capsys):
    """What the first contact chose is learned: the next run takes it over, whatever it sees first."""
    first = replayed(capsys, DEMO, "--out", tmp_path / "out")["parameters"]
    learned = read_config(tmp_path / "out" / "config.yaml").learned
    assert learned.force_unit == first["force_unit_N"]
    assert list(learned.velocity_range) == first["basis"]["velocity_range_m_s"]
    again = replayed(capsys, DEMO, "--config", tmp_path / "out" / "config.yaml", "--freeze-after", 0)["parameters"]
    assert again == first


def test_units_given_are_kept_and_those_chosen_are_said(tmp_path, capsys):
    assert run(DEMO) == 0
    said = [line.split()[1] for line in capsys.readouterr().out.splitlines() if line.startswith("chosen")]
    assert said == ["learned.velocity_range", "learned.force_unit"]
    given = tmp_path / "given.yaml"
    given.write_text("/**:\n  ros__parameters:\n    force_unit: 7.0\n    basis: {velocity_range: [-0.2, 0.2]}\n")
    assert run(DEMO, "--config", given) == 0
    assert "chosen" not in capsys.readouterr().out
    parameters = replayed(capsys, DEMO, "--config", given)["parameters"]
    assert (parameters["force_unit_N"], parameters["basis"]["velocity_range_m_s"]) == (7.0, [-0.2, 0.2])


@pytest.mark.parametrize("law", ["lms", "rls"])
def test_the_curve_is_that_of_the_contract(capsys, law):
    result = replayed(capsys, DEMO, "--law", law)
    curve = result["curve"]
    assert set(curve) == {
        "velocity_m_s", "friction_N", "low_N", "high_N", "pressure_Pa", "temperature_degC", "learned_share",
    }  # fmt: skip
    low, high = result["parameters"]["basis"]["velocity_range_m_s"]
    np.testing.assert_allclose(curve["velocity_m_s"], np.linspace(low, high, 401), atol=1e-12)
    band = np.array([curve["low_N"], curve["friction_N"], curve["high_N"]])
    assert (np.diff(band, axis=0) >= 0.0).all()
    if law == "lms":
        assert curve["learned_share"] is None
    else:
        assert len(curve["learned_share"]) == 401
        assert 0.0 <= min(curve["learned_share"]) <= max(curve["learned_share"]) <= 1.0


def test_json_tells_the_unit_of_the_basis(capsys):
    basis = replayed(capsys, DEMO)["parameters"]["basis"]
    assert basis["velocity_unit_m_s"] > 0.0
    low, high = basis["velocity_range_m_s"]
    assert basis["velocity_unit_m_s"] < high - low


def test_a_recording_that_ends_before_the_first_contact_says_so(tmp_path, demo, capsys):
    """A third of a stroke: replay makes do with it, a live node would still wait."""
    assert run(faulty(tmp_path, demo[:60])) == 0
    assert "before two reversals" in capsys.readouterr().err
    assert run(DEMO) == 0
    assert "before two reversals" not in capsys.readouterr().err


def test_a_retired_parameter_is_passed_over_with_one_warning(tmp_path, capsys):
    path = tmp_path / "former.yaml"
    path.write_text("/**:\n  ros__parameters:\n    rls:\n      relinearise: false\n")
    assert run(DEMO, "--config", path) == 0
    warned = [line for line in capsys.readouterr().err.splitlines() if "retired" in line]
    assert len(warned) == 1
    assert "rls.forgetting_factor" in warned[0]
