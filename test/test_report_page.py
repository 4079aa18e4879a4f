"""What a page says and holds: the light and its reasons, extremes of long signals, the static page."""

import shlex
import sys
from dataclasses import replace

import numpy as np
import pages
import pytest
from bokeh.models import Span
from hypothesis import given, settings
from hypothesis import strategies as st
from replays import over

from friction_estimator.cli.common import FIGURE_FORMATS
from friction_estimator.cli.main import main
from friction_estimator.core import metrics
from friction_estimator.core.fit.frozen_score import FrozenScore
from friction_estimator.core.online.record_figures import RecordFigures
from friction_estimator.core.online.replay import Replay, replay
from friction_estimator.core.quantities import ROTARY, Quantities
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.advice import on_remainder
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.diagnosis.remainder import NAMES, Remainder
from friction_estimator.effects import EFFECTS
from friction_estimator.report import figures, style
from friction_estimator.report.page import curves, diagnosis_charts, envelope, learning, look
from friction_estimator.report.page.content import CAUTION, GOOD, LEVELS, STOP
from friction_estimator.report.page.diagnosis_page import diagnosis_page
from friction_estimator.report.page.replay_page import replay_page
from friction_estimator.report.page.trust import errors_at_the_end, trust
from friction_estimator.report.page.write import write_page

Q = Quantities()


def record(n=6000, rate=500.0, noise=0.02, seed=0):
    k = np.arange(n)
    velocity = 0.1 * np.sin(2 * np.pi * k / rate / 2.0) * (0.6 + 0.4 * np.sin(2 * np.pi * k / rate / 3.0))
    known = 3.0 * np.tanh(velocity / 0.01) + 1.5 * np.sin(80.0 * velocity)  # no curve of the textbook
    friction = known + noise * np.random.default_rng(seed).standard_normal(n)
    return Samples((k * 1e9 / rate).astype(np.int64) + 1, velocity, friction, k == 0)


@pytest.fixture(scope="module")
def replayed() -> Replay:
    return replay(record(), Config(), freeze_after=0.5)


def judged(result, q=Q, fitted=False):
    scores = [] if result.frozen_score is None else [("the rest", result.frozen_score)]
    return trust(result, scores, q, fitted=fitted, diverged=result.figures()["diverged"])


def wrong(result, error):
    """The replay with this error in its predictions."""
    return replace(result, predicted_N=result.samples.friction_N - error)


def test_a_light_is_green_only_for_what_was_judged_without_learning(replayed):
    light, advice = judged(replayed)
    assert (light.level, advice) == (GOOD, [])
    # The same errors, and nothing held out.
    everything = over(replayed, learned=np.ones(len(replayed.samples), np.bool_))
    light, advice = judged(everything)
    assert light.level == CAUTION
    assert [one.command for one in advice] == ["--test"]


def test_what_loses_is_told_by_its_reason(replayed):
    measured = replayed.samples.friction_N
    spread = float(np.std(measured))
    noise = np.random.default_rng(1).standard_normal(measured.size)
    cases = {
        "diverged": np.where(np.arange(measured.size) > 5000, 1e9, 0.0),
        "no better than always saying the mean": 1.1 * spread * noise,
        "Coulomb and viscous friction": 0.8 * spread * noise,
    }
    for reason, error in cases.items():
        light, advice = judged(wrong(replayed, error))
        assert light.level == STOP
        assert reason in light.reason
        assert advice
    # The last value is closer at a high rate: advice, no verdict on the model elsewhere.
    speed = replayed.samples.velocity_m_s
    smooth = 3.0 * np.tanh(speed / 0.02) + 2.0 * np.sin(80.0 * speed)
    quiet = over(replayed, samples=replace(replayed.samples, friction_N=smooth))
    light, _ = judged(wrong(quiet, 0.6 * noise))
    assert "as it was one sample ago" in light.reason
    assert light.level == CAUTION


def test_a_theory_of_another_machine_and_velocities_never_learned_are_told(replayed, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(RecordFigures, "theory_in", lambda self, part: -5.0 * self.samples.friction_N[part])
        light, advice = judged(over(replayed))
    assert light.level == CAUTION
    assert "not of this machine" in light.reason
    assert "theory.kind none" in advice[0].text
    half = replace(replayed.curve, velocity_m_s=0.3 * replayed.curve.velocity_m_s)
    light, _ = judged(replace(replayed, curve=half))
    assert "Data support only 33 %" in light.reason


def test_one_direction_is_said_to_hide_a_bias(replayed):
    samples = replayed.samples
    for way in (1.0, -1.0):
        light, advice = judged(over(replayed, samples=replace(samples, velocity_m_s=way * abs(samples.velocity_m_s))))
        assert light.level == CAUTION
        assert "one direction only: a bias of the force sensor cannot be told from the Coulomb level" in light.reason
        assert any("both ways" in one.text for one in advice)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.55, 1.0])
def test_where_learning_stops_is_marked_among_the_cycles(replayed, share):
    k = np.arange(6000)
    even = replace(replayed.samples, velocity_m_s=0.1 * np.sin(2.0 * np.pi * k / 600.0))  # the first cycle has no begin
    result = over(replayed, samples=even, learned=k < share * k.size)
    place = figures.learning_stops(result)
    drawn = learning.error_by_cycle(result, Q, fitted=False).build()
    marks = [one.location for one in drawn.select({"type": Span}) if one.dimension == "height"]
    assert marks == ([] if place is None else [place])
    if share in (0.0, 1.0):
        assert place is None
    else:
        assert place == pytest.approx(0.5 + 10.0 * share - 1.0, abs=0.01)


def test_a_simpler_curve_that_is_closer_elsewhere_is_named(replayed):
    def scored(**baselines):
        known = {
            "coulomb_viscous": 0.5,
            "stribeck": 0.5,
            "stribeck_asymmetric": 0.5,
            "persistence": 0.01,
            "theory": None,
        }
        return FrozenScore(1000, 2.0, 0.2, known | baselines)

    levels = {}
    for name, score in {
        "none": scored(), "stribeck": scored(stribeck_asymmetric=0.1), "coulomb": scored(coulomb_viscous=0.1),
        "nothing fitted": scored(coulomb_viscous=None, stribeck=None, stribeck_asymmetric=None),
        "almost": scored(coulomb_viscous=0.199),
    }.items():  # fmt: skip
        light, _ = trust(replayed, [("there", score)], Q, fitted=False, diverged=False)
        levels[name] = light.level
    assert levels == {
        "none": GOOD, "stribeck": CAUTION, "coulomb": STOP, "nothing fitted": GOOD, "almost": GOOD,
    }  # fmt: skip


def score(nrmse, **baselines):
    known = {"coulomb_viscous": 0.5, "stribeck": 0.5, "stribeck_asymmetric": 0.5, "persistence": 0.01, "theory": None}
    return FrozenScore(1000, 2.0, nrmse, known | baselines)


def test_the_green_light_says_no_more_than_was_seen(replayed):
    for baselines, words in (
        ({}, "no simple curve (Coulomb and viscous, Stribeck) is closer, and"),
        ({"stribeck_asymmetric": 0.199}, "is closer by more than 5 %"),
        (dict.fromkeys(("coulomb_viscous", "stribeck", "stribeck_asymmetric")), "no simple curve could be fitted"),
    ):
        light, _ = trust(replayed, [("there", score(0.2, **baselines))], Q, fitted=False, diverged=False)
        assert light.level == GOOD
        assert words in light.reason


def test_speeds_that_were_never_learned_are_told_of_the_rest_of_the_record_too(replayed):
    rest = ~replayed.learned
    speed = replayed.samples.velocity_m_s * np.where(rest, 3.0, 1.0)
    light, _ = judged(over(replayed, samples=replace(replayed.samples, velocity_m_s=speed)))
    assert light.level != GOOD
    assert "of what was not learned from is at velocities never learned" in light.reason


def test_a_record_that_ends_at_one_speed_is_not_called_wrong(replayed):
    """Nothing but noise is left about the mean there, for the best of models; nobody knew that mean before."""
    n = len(replayed.samples)
    noise = 0.02 * np.random.default_rng(2).standard_normal(n)
    end = np.arange(n) >= n - n // 5
    speed = np.where(end, 0.08, replayed.samples.velocity_m_s)
    force = np.where(end, 3.5 + noise, replayed.samples.friction_N)
    predicted = np.where(end, 3.5, replayed.predicted_N)
    samples = replace(replayed.samples, velocity_m_s=speed, friction_N=force)
    light, _ = judged(over(replayed, samples=samples, predicted_N=predicted))
    assert light.level != STOP, light.reason
    # Another recording at one speed: its own mean, known afterwards, is as close as the model.
    light, _ = trust(replayed, [("there", replace(score(1.02), spread_N=0.02))], Q, fitted=False, diverged=False)
    assert light.level == CAUTION
    assert "hardly varies on there" in light.reason
    light, _ = trust(replayed, [("there", score(1.02))], Q, fitted=False, diverged=False)
    assert light.level == STOP


def test_a_command_to_run_next_keeps_the_options_and_its_words_whole(replayed):
    everything = over(replayed, learned=np.ones(len(replayed.samples), np.bool_))
    summary = {"law": "rls", "theory": "stribeck", "bags": ["my rig; ls"], **everything.figures()}
    words = ["friction_estimator", "replay", "my rig; ls", "--topic", "velocity=/v"]
    for typed, start in ((words, shlex.join(words)), ((), "friction_estimator replay 'my rig; ls'")):
        page = replay_page(everything, [], summary, Q, [], [], [], words=typed)
        assert page.advice[0].command == f"{start} --test OTHER_RECORDING"


def test_numbers_on_a_page_have_no_exponents_that_nobody_reads(replayed):
    end = np.arange(len(replayed.samples)) >= 4800
    noise = np.random.default_rng(3).standard_normal(end.size)
    off = wrong(replayed, np.where(end, 104.0 * noise / np.std(noise[end]), 0.0))
    page = replay_page(off, [], {"law": "rls", "theory": "stribeck", "bags": ["a"], **off.figures()}, Q, [], [], [])
    assert "±100 N rms" in page.verdict
    assert "e+0" not in f"{page}"


def test_each_level_has_a_sign_and_a_word_of_its_own():
    assert len({sign for sign, _ in LEVELS.values()}) == len({word for _, word in LEVELS.values()}) == len(LEVELS)


def test_errors_are_in_physical_units(replayed):
    errors = errors_at_the_end(replayed)
    part = slice(len(replayed.samples) - len(replayed.samples) // 5, None)
    assert errors.model == pytest.approx(float(np.sqrt(np.mean(np.square(replayed.residual_N[part])))))
    assert errors.share == pytest.approx(errors.model / float(np.std(replayed.samples.friction_N[part])))


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 3000), st.integers(1, 200), st.lists(st.integers(1, 2999), max_size=20), st.integers(0, 99))
def test_extremes_are_kept_and_no_row_reaches_over_a_gap(n, rows, breaks, seed):
    generator = np.random.default_rng(seed)
    values = generator.standard_normal(n)
    values[generator.random(n) < 0.05] = np.nan
    restart = np.isin(np.arange(n), breaks)
    time = np.arange(n) + 10.0 * np.cumsum(restart)
    made = envelope.table(time, {"x": values}, envelope.gaps(time, restart), rows)
    zero, step = made.steps["x"]
    starts = np.searchsorted(time, made.columns["time_s"])
    for row, (a, b) in enumerate(zip(starts, [*starts[1:], n], strict=True)):
        assert not restart[a + 1 : b].any()
        inside = values[a:b][np.isfinite(values[a:b])]
        low, high = (int(made.columns[f"x_{end}"][row]) for end in ("low", "high"))
        if not inside.size:
            assert low == high == envelope.MISSING
            continue
        # Rounded away from each other: the line may be a step too long, never too short.
        assert inside.min() - 1.01 * step <= zero + step * low <= inside.min() + 1e-6 * step + 1e-12
        assert inside.max() - 1e-6 * step - 1e-12 <= zero + step * high <= inside.max() + 1.01 * step
    assert made.samples_per_row * len(made.columns["time_s"]) >= n


def test_a_cycle_with_two_buttons_is_kept_once():
    first, last = slice(0, 10), slice(80, 90)
    assert envelope.pieces_of(100, [first, first, last], 8192) == [first, last]
    assert envelope.pieces_of(100, [first], 4) == [slice(3, 7)]


def test_what_runs_away_does_not_flatten_the_rest():
    values = np.array([0.1, -0.2, 1e300, np.inf, np.nan])
    assert envelope.readable(values, 1.0)[:3].tolist() == [0.1, -0.2, envelope.SURE]
    assert np.isnan(envelope.readable(values, 1.0)[3:]).all()


@pytest.mark.parametrize("noise", [0.003, 0.03, 0.3])
def test_the_noise_floor_is_found_without_a_model(noise):
    samples = record(20_000, 1000.0, noise)
    assert metrics.white_noise(samples.friction_N, samples.restart) == pytest.approx(noise, rel=0.1)
    assert np.isnan(metrics.white_noise(samples.friction_N[:50], samples.restart[:50]))


def test_ticks_of_a_logarithmic_axis_can_be_read():
    assert look.readable_ticks(0.02, 0.3) == [0.02, 0.05, 0.1, 0.2]
    assert look.readable_ticks(1e-9, 1.0) == [10.0**k for k in range(-9, 1)]


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    place = tmp_path_factory.mktemp("bag") / "bag"
    assert main(["simulate", "--condition", "b", "--cycles", "6", "--rate", "200", "--out", str(place)]) == 0
    return place


def test_without_bokeh_the_page_is_static_and_says_so(bag, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "bokeh", None)  # what Python makes of a library that is not installed
    out = tmp_path / "out"
    assert main(["replay", str(bag), "--out", str(out), "--figures", "svg,png"]) == 0
    page = (out / "report.html").read_text()
    assert "bokeh is not installed" in pages.words(page)
    assert "<script" not in page
    assert page.count("data:image/svg+xml;base64") == 4
    assert "Predicted to ±" in pages.words(page)
    assert {path.suffix for path in (out / "figures").iterdir()} == {".png", ".svg"}
    first = {path.name: path.read_bytes() for path in (out / "figures").glob("*.svg")}
    # One set takes the place of the other, and leaves no figure of it behind; what is drawn again has the same bytes.
    assert main(["replay", str(bag), "--out", str(out), "--figures", "svg"]) == 0
    assert {path.name: path.read_bytes() for path in (out / "figures").iterdir()} == first


def test_a_fit_says_what_is_true_of_a_fit(bag, tmp_path):
    out = tmp_path / "out"
    assert main(["identify", str(bag), "--fit-only", "--out", str(out), "--units", "mm/s,mN"]) == 0
    page = (out / "report.html").read_text()
    said = pages.words(page)
    assert "before its measurement was used" not in said
    assert "Fitted to ±" in said
    assert "All samples were known to the fit" in said
    assert " mN rms" in said
    assert f"sha256 of {next(bag.glob('*.mcap')).name}" in said
    assert "friction_estimator identify" in said
    assert '"velocity (mm/s)"' in page
    assert '"friction (mN)"' in page


def test_formats_of_figures_are_those_that_are_drawn(bag, capsys):
    assert FIGURE_FORMATS == style.FORMATS
    with pytest.raises(SystemExit) as ended:
        main(["replay", str(bag), "--figures", "png,pdf"])
    assert ended.value.code == 2
    assert "'pdf' is no format of figures" in capsys.readouterr().err


def test_units_of_a_rotary_drive_are_on_the_page(replayed):
    light, _ = judged(wrong(replayed, 0.8 * np.std(replayed.samples.friction_N) * np.ones(6000)), Quantities(ROTARY))
    assert " N m rms" in light.reason


def test_a_diagnosis_that_cannot_answer_claims_no_search(tmp_path):
    t = np.arange(2400) / 200.0
    speed = 0.05 + 0.04 * np.sin(2 * np.pi * t / 3.0)
    force = 2.0 + 8.0 * speed + 0.02 * np.random.default_rng(0).standard_normal(t.size)
    np.savez(tmp_path / "one way.npz", t=t, v=speed, f=force)
    bag, out = str(tmp_path / "one way"), tmp_path / "out"
    words = ["import", f"{bag}.npz", "--out", bag, "--time", "t", "--map", "velocity=v,friction=f"]
    assert main(words) == 0
    assert main(["diagnose", bag, "--out", str(out)]) == 1
    said = pages.words((out / "report.html").read_text())
    assert "a bias of the force sensor cannot be told" in said
    assert "{" not in said
    assert "looked for and not found" not in said
    assert "error of the fit" in said
    assert "2400 samples used of 2400; refused: none" in said


def test_a_mean_is_not_drawn_over_what_nobody_measured():
    x = np.concatenate([np.linspace(0.0, 1.0, 2000), np.linspace(3.0, 4.0, 2000)])
    bins = curves.binned(curves.Points(x, np.where(x < 2.0, 1.0, -1.0)))
    assert (np.diff(bins.at) >= 0.0).all()
    gap = np.flatnonzero(np.isnan(bins.mean))
    assert gap.size == 2
    assert bins.at[gap[1]] - bins.at[gap[0]] > 1.8
    assert (bins.low[gap] == bins.high[gap]).all()
    assert np.isfinite(curves.binned(curves.Points(np.linspace(0.0, 1.0, 4000), np.ones(4000))).mean).all()


def test_a_page_of_many_causes_stays_small(tmp_path):
    """The same cause eight times over, since charts are what counts: five causes of 105,000 samples took 6.1 MB.

    The page takes 2.5 MB, and 3.4 MB where each chart has as many rows as that of one cause alone.
    """
    k = np.arange(12_000)
    phase = 2 * np.pi * k / 400.0 / np.where(k < 6000, 2.0, 1.0)
    speed = 0.1 * np.sin(phase)
    force = 3.0 * np.tanh(speed / 0.01) + 10.0 * speed + 2.0 * np.gradient(speed, 1 / 400.0)
    force += 0.02 * np.random.default_rng(0).standard_normal(k.size)
    samples = Samples((k * 2_500_000 + 1).astype(np.int64), speed, force, k == 0)
    found = diagnose([samples], Config(), catalogue={"inertia": EFFECTS["inertia"]})
    assert len(found.effects) == 1
    assert len(samples) > diagnosis_charts.ROWS
    page = diagnosis_page(replace(found, effects=found.effects * 8), ["a"], Q, {}, [], [])
    write_page(tmp_path / "report.html", page)
    assert (tmp_path / "report.html").stat().st_size < 3_000_000


@pytest.fixture(scope="module")
def nameless():
    """What depends on the position, and a catalogue that knows a mass only; a sweeping pump repeats nowhere."""
    samples = record(6000)
    position = np.cumsum(samples.velocity_m_s) / 500.0
    time = samples.stamp_ns * 1e-9
    hidden = 2e3 * np.square(position - position.mean()) + 0.2 * np.sin(2.0 * np.pi * (9.0 + 0.3 * time) * time)
    samples = replace(samples, friction_N=samples.friction_N + hidden, position_m=position)
    return diagnose([samples], Config(), catalogue={"inertia": EFFECTS["inertia"]})


def test_an_unexplained_diagnosis_says_what_to_do(nameless, tmp_path):
    assert nameless.verdict == "unexplained"
    told = diagnosis_page(nameless, ["a"], Q, {}, [], [])
    said = [one.text for one in told.advice]
    assert any(text.startswith("It follows the ") for text in said)
    assert any("Record pressure and temperature, too" in text for text in said)
    assert sum("no named cause explains" in text for text in said) == 0  # a finding is no advice
    (left,) = [card for section in told.sections if section.title == "What is left" for card in section.cards]
    assert left.facts[0][0] == "Where to look"
    # Little of what does not repeat is noise.
    (white,) = [value for name, value, _ in told.facts if name == "white noise"]
    assert float(white.split()[0]) == pytest.approx(0.02, rel=0.1)
    assert any("follows nothing that was recorded" in text for text in said)
    assert "what does not repeat is" in told.verdict
    assert "noise" not in told.verdict  # a pump is none


@pytest.mark.parametrize("kind", ["mean", "variance"])
def test_every_remainder_has_a_place_to_look(kind):
    for variable in NAMES:
        text = on_remainder(Remainder(variable, 0.5, kind, "words"))
        assert len(Q.worded(text)) > 40
        assert "{" not in Q.worded(text)
