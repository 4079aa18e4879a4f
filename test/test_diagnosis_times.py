"""One time of the whole force: it moves the base model and every effect that acts before it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from diagnosis_records import abba, chosen, names
from diagnosis_records import record as recording

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import BaseProblem, Capacity
from friction_estimator.diagnosis.candidate import Candidate
from friction_estimator.diagnosis.candidates import Candidates
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.diagnosis.joint_fit import JointFit
from friction_estimator.diagnosis.odd_curve import SPLINES
from friction_estimator.diagnosis.own_columns import OwnColumns, Term, before
from friction_estimator.diagnosis.record import build_record
from friction_estimator.diagnosis.seek import best_time
from friction_estimator.effects import EFFECTS, parse_effect
from friction_estimator.effects.timing import lagged_force
from friction_estimator.effects.whole import shifted, unfiltered
from friction_estimator.rig.drive import segment
from friction_estimator.rig.simulate import Scenario, simulate

SEAL = Config.from_mapping({"theory.kind": "seal"})

SHORT = (segment(1.0, 50.0, 8.0), segment(4.0, 50.0, 16.0))

SEGMENTS = (segment(1.0, 50.0, 16.0), segment(4.0, 50.0, 24.0))


def test_a_slow_column_is_moved_by_the_time() -> None:
    samples = simulate(Scenario((segment(1.0, 50.0, 4.0),), plant="clean", rate_hz=200.0, seed=1)).samples
    record = build_record([samples], Config())
    f = record.features
    omega, late = 2.0 * np.pi, 0.008
    scale = f.velocity_m_s.max()
    inside = slice(20, -20)
    for sign in (1.0, -1.0):
        moved = record.features_at(Config(), lambda _, values, s=sign: shifted(values, f, s * late)).velocity_m_s
        turned = f.velocity_m_s * np.cos(omega * late) - sign * f.acceleration_m_s2 / omega * np.sin(omega * late)
        np.testing.assert_allclose(moved[inside], turned[inside], atol=5e-3 * scale)
    wave = np.column_stack([np.sin(f.time_s), np.cos(f.time_s)])
    lagged = EFFECTS["sensor_lowpass"].smoother({"time_constant": late})([wave], f.step_s)
    expected = np.column_stack([np.sin(f.time_s - late), np.cos(f.time_s - late)])
    np.testing.assert_allclose(lagged[inside], expected[inside], atol=1e-4)


@pytest.mark.parametrize("poles", [1.0, 2.0])
def test_what_has_decayed_is_nothing_and_no_denormal_number(poles: float) -> None:
    """Products of these are ten times slower, and a spline that is zero nearly everywhere would decay to them."""
    pulse, step_s = np.zeros((4000, 1)), np.full(4000, 1e-3)
    pulse[100:110] = 1.0
    smooth = EFFECTS["sensor_lowpass"].smoother({"time_constant": 2e-3, "poles": poles})
    decayed = np.abs(smooth([pulse], step_s)[110:, 0])
    tiny = np.finfo(np.float64).tiny
    assert not np.any((decayed > 0.0) & (decayed < tiny))
    assert 0.0 < decayed[300] < 1e-60
    assert decayed[-1] == 0.0


def test_a_long_delay_beside_other_forms_is_more_than_they_although_its_own_force_is_not() -> None:
    """Of 20 ms the base's memory has taken up a part: what is beside it then does nothing, what the fit takes off does.

    Without the delay 55 % of the error of the rig's plant is left, the lagging film not found either.
    """
    some = chosen("direction_asymmetry", "pressure_dependence", "frictional_lag", "time_delay")
    result = diagnose([recording(["time_delay:delay=0.02"], plant="rig")], Config(), catalogue=some)
    assert set(names(result)) == set(some)
    delay = next(one for one in result.effects if one.name == "time_delay").parameters["delay"]
    assert delay.low < 0.02 < delay.high
    assert result.unexplained_percent < 10.0


def test_a_late_velocity_leaves_the_other_channels_where_they_are() -> None:
    samples = simulate(Scenario((segment(1.0, 50.0, 3.0),), plant="clean", rate_hz=200.0, seed=1)).samples
    record = build_record([samples], Config())
    context = record.context(Config(), float(np.abs(record.friction_N).max()))
    columns = OwnColumns(BaseProblem(record, SEAL), context)
    late, first = ({"delay": 0.02}, {"delay": 0.02, "filtered": 1.0})
    for params in (late, first):
        there = columns.at(Term(EFFECTS["velocity_delay"], params), record.features)
        np.testing.assert_array_equal(there.position_m, record.features.position_m)
        assert np.abs(there.velocity_m_s - record.features.velocity_m_s).max() > 0.01
    behind = columns.at(Term(EFFECTS["time_delay"], late), record.features)
    assert np.abs(behind.position_m - record.features.position_m).max() > 1e-4


def test_only_what_acts_before_the_time_is_moved() -> None:
    assert before(EFFECTS["direction_asymmetry"], EFFECTS["time_delay"])
    assert not before(EFFECTS["sensor_bias"], EFFECTS["time_delay"])


def test_a_delay_behind_bristles_is_found() -> None:
    """Without moving what the bristles take away, a delay of 3 ms made the fit worse than none."""
    hidden = (parse_effect("time_delay:delay=0.003"),)
    samples = simulate(Scenario(SEGMENTS, plant="maxwell_slip", rate_hz=200.0, seed=4, effects=hidden)).samples
    record = build_record([samples], Config())
    context = record.context(SEAL, float(np.abs(record.friction_N).max()))
    fit = JointFit(BaseProblem(record, SEAL, Capacity(SPLINES, Config().fir.order)), context)
    bristles = Term(EFFECTS["presliding"], {"length": 3e-5, "spread": 1.0})
    without = fit([bristles])
    found = fit([*without.terms, Term(EFFECTS["time_delay"], {"delay": 1e-3})], without)
    assert found.terms[-1].params["delay"] == pytest.approx(0.003, abs=1e-4)
    assert found.coefficients.cost < 0.8 * without.coefficients.cost


@pytest.mark.parametrize(("name", "delay"), [("velocity_delay", 0.003), ("time_delay", 0.004)])
def test_a_time_is_sought_again_beside_what_was_found_after_it(name: str, delay: float) -> None:
    """Without the bristles the time is put far off, and it stayed there when they were known."""
    hidden = (parse_effect(f"{name}:delay={delay}"),)
    samples = simulate(Scenario(SHORT, plant="maxwell_slip", rate_hz=200.0, seed=5, effects=hidden)).samples
    record = build_record([samples], SEAL)
    context = record.context(SEAL, float(np.abs(record.friction_N).max()))
    fits = Candidates(BaseProblem(record, SEAL), context, EFFECTS, 0)
    first = fits(fits.base(), name, {"delay": 0.002})
    assert first is not None
    both = fits(first.model, "presliding", {"length": 3e-5, "spread": 1.0})
    assert both is not None
    assert abs(both.model.joint.terms[0].params["delay"] - delay) > 0.002
    settled = fits.resettled(first.model, both)
    assert [term.name for term in settled.model.joint.terms] == [name, "presliding"]
    assert settled.model.joint.terms[0].params["delay"] == pytest.approx(delay, abs=5e-4)  # a tenth of a sample
    assert settled.gain > both.gain


def test_a_time_is_sought_anew_only_where_a_search_ends_elsewhere() -> None:
    samples = simulate(Scenario(SHORT, plant="film_lag", rate_hz=200.0, seed=7)).samples
    record = build_record([samples], SEAL)
    context = record.context(SEAL, float(np.abs(record.friction_N).max()))
    fit = JointFit(BaseProblem(record, SEAL), context)
    lag = Term(EFFECTS["frictional_lag"], {"lag": 0.004, "rest": 0.0})
    settled = fit([Term(EFFECTS["sensor_bias"], {}), lag])
    *others, last = settled.terms
    assert not fit.elsewhere(settled.terms, settled)
    moved = replace(last, params=last.params | {"lag": 1.5 * last.params["lag"]})
    assert fit.elsewhere([*others, moved], settled)
    assert not fit.elsewhere([lag, *others], settled)  # a bias has nothing to be sought


def test_a_filter_slower_than_what_is_scanned_is_begun_where_it_is() -> None:
    """Behind a curve that is not the true one the scan's longest time looked best, and a search led away from it."""
    step, true = 0.01, 0.12

    def fitted(time: float) -> SimpleNamespace:
        return SimpleNamespace(cost=1.0 + min(abs(np.log(time / true)), 0.5) - 1e-3 * time, late=0.0)

    assert best_time(fitted, fitted(1e-3), lambda fit: fit.late, step) == pytest.approx(0.04)
    found = best_time(fitted, fitted(1e-3), lambda fit: fit.late, step, hint_s=0.115)
    assert found == pytest.approx(true, rel=0.02)


def test_a_time_far_shorter_than_screening_saw_it_is_found() -> None:
    """Of a filter of a sixtieth of a sample the memory that the base had taken up made a fifth of one: the fit began
    there, and ended at the end of its bracket, worse than without it.
    """
    step, true = 0.01, 1.5e-4

    def fitted(time: float) -> SimpleNamespace:
        return SimpleNamespace(cost=1.0 + abs(np.log(time / true)), late=0.0)

    found = best_time(fitted, fitted(1e-3), lambda fit: fit.late, step, hint_s=7.7e-4)
    assert found == pytest.approx(true, rel=0.4)
    # Shorter than a hundredth of a sample none is told: there is nothing to look for.
    assert best_time(lambda time: SimpleNamespace(cost=time, late=0.0), fitted(1e-3), lambda _: 0.0, step) >= 1e-4


def test_a_lag_of_the_film_settles_in_a_few_rounds() -> None:
    """Beside the base, with coefficient one, it took tens of rounds: the column followed the gain of the last one."""
    samples = simulate(Scenario(SHORT, plant="film_lag", rate_hz=200.0, seed=7)).samples
    record = build_record([samples], SEAL)
    context = record.context(SEAL, float(np.abs(record.friction_N).max()))
    problem = BaseProblem(record, SEAL)
    settled = JointFit(problem, context)([Term(EFFECTS["frictional_lag"], {"lag": 0.004, "rest": 0.0})])
    soon = JointFit(problem, context)([Term(EFFECTS["frictional_lag"], {"lag": 0.004, "rest": 0.0})], rounds=4)
    assert soon.terms[0].params["lag"] == pytest.approx(settled.terms[0].params["lag"], rel=1e-3)
    assert soon.coefficients.cost < 1.002 * settled.coefficients.cost
    whole = settled.base.fitted_N
    without = problem.products.fitted(settled.coefficients.weights, settled.coefficients.taps, settled.coefficients.own)
    np.testing.assert_allclose(settled.parts_N[0], whole - without, atol=1e-12)


def test_a_velocity_that_is_late_is_found_behind_bristles() -> None:
    """The bristles' length takes up a force that is ahead: screening alone shows little, and squeeze_film was named."""
    hidden = (parse_effect("velocity_delay:delay=0.003"),)
    samples = simulate(Scenario(SHORT, plant="maxwell_slip", rate_hz=200.0, seed=6, effects=hidden)).samples
    names = ("presliding", "squeeze_film", "velocity_delay", "inertia")
    found = diagnose([samples], SEAL, catalogue=chosen(*names))
    assert [effect.name for effect in found.effects] == ["presliding", "velocity_delay"]
    assert found.effects[1].parameters["delay"].value == pytest.approx(0.003, abs=3e-4)


def test_a_velocity_late_by_many_samples_is_found() -> None:
    """No memory takes up a force that is ahead: longer times are tried as long as they fit better."""
    step, true = 0.005, 0.0351

    def fitted(time: float) -> SimpleNamespace:
        return SimpleNamespace(cost=1.0 + min(abs(time - true), 0.02) / true - 1e-3 * time, late=max(0.0, time - true))

    found = best_time(fitted, fitted(0.0), lambda fit: fit.late / step, step, ahead=True, longest_s=0.25)
    assert found == pytest.approx(true, abs=0.05 * step)
    bounded = best_time(fitted, fitted(0.0), lambda fit: fit.late / step, step, ahead=True, longest_s=0.024)
    assert bounded < 0.024


def test_a_late_velocity_is_begun_where_screening_saw_it() -> None:
    """Far from the true time nothing gets better by a few samples: 40 ms at 5 kHz were not found."""
    step, true = 2e-4, 0.0406

    def fitted(time: float) -> SimpleNamespace:
        return SimpleNamespace(cost=1.0 + min(abs(time - true), 0.018) + 1e-4 * time, late=0.0)

    found = best_time(fitted, fitted(0.0), lambda fit: fit.late, step, ahead=True, longest_s=0.0625, hint_s=0.0519)
    assert found == pytest.approx(true, abs=step)
    assert best_time(fitted, fitted(0.0), lambda fit: fit.late, step, ahead=True, longest_s=0.0625) < 0.001


def test_what_a_filter_of_first_order_has_made_is_taken_back() -> None:
    samples = simulate(Scenario((segment(1.0, 50.0, 3.0),), plant="clean", rate_hz=200.0, seed=1)).samples
    f = build_record([samples], Config()).features
    tau = 0.03
    filtered = lagged_force(f.velocity_m_s, 0.005, tau)
    back = unfiltered(filtered, f, tau)
    np.testing.assert_allclose(back[2:-2], f.velocity_m_s[2:-2], atol=2e-3 * f.velocity_m_s.max())
    restarts = replace(f, step_s=np.where(np.arange(f.size) % 2 == 0, 0.0, f.step_s))
    pair = unfiltered(filtered, restarts, tau)  # pieces of two samples have the slope of the line through them
    np.testing.assert_allclose(pair[1::2] - pair[::2][: pair[1::2].size], np.diff(filtered)[::2])


def beside_a_lagging_film(hidden: str, seed: int) -> tuple[Candidates, Candidate]:
    """Return the fits of a record in which an effect is hidden, and the film's lag as the first of them."""
    scenario = Scenario(SHORT, plant="film_lag", rate_hz=200.0, seed=seed, effects=(parse_effect(hidden),))
    record = build_record([simulate(scenario).samples], SEAL)
    context = record.context(SEAL, float(np.abs(record.friction_N).max()))
    fits = Candidates(BaseProblem(record, SEAL), context, EFFECTS, 0)
    lag = fits(fits.base(), "frictional_lag", {"lag": 0.006, "rest": 0.0}, search=False)
    assert lag is not None
    return fits, lag


def test_a_velocity_behind_a_filter_has_its_time_beside_a_lagging_film() -> None:
    """A delay fitted it with a sample and a half of memory: 10.6 ms were told for 3."""
    fits, lag = beside_a_lagging_film("velocity_delay:delay=0.0035,form=1", seed=6)
    late = fits(lag.model, "velocity_delay", {"delay": 0.003})
    assert late is not None
    best = fits.shaped(lag.model, late)
    assert best.term.params["delay"] == pytest.approx(0.0035, abs=2e-4)
    assert best.model.joint.coefficients.power < 0.8 * late.model.joint.coefficients.power


def test_what_the_memory_delays_belongs_to_the_time() -> None:
    """With the film's lag known a delay stayed a sample short, and a sample of memory made up for it."""
    fits, lag = beside_a_lagging_film("time_delay:delay=0.0328", seed=7)
    short = fits(lag.model, "time_delay", {"delay": 0.0278}, search=False)
    assert short is not None
    assert abs(short.term.params["delay"] - 0.0328) > 0.004
    settled = fits.resettled(lag.model, short)
    assert settled.term.params["delay"] == pytest.approx(0.0328, abs=5e-4)
    assert settled.model.joint.coefficients.cost < short.model.joint.coefficients.cost


def test_forms_of_a_filter_are_compared_where_a_delay_comes_first() -> None:
    """The base's memory takes up nearly all of a filter with two poles: one pole is far behind a delay there."""
    hidden = (parse_effect("sensor_lowpass:time_constant=0.0083,form=1"),)
    samples = simulate(Scenario(abba(), plant="clean", rate_hz=200.0, seed=3, effects=hidden)).samples
    found = diagnose([samples], SEAL, catalogue=chosen("sensor_lowpass", "time_delay"))
    assert found.effects[0].name == "sensor_lowpass"
    value = found.effects[0].parameters["time_constant"]
    assert value.low < 0.0083 < value.high


def test_a_narrow_well_behind_a_wide_one_is_looked_into() -> None:
    """On a drive without noise in the velocity the true time's well is a tenth of a sample wide; a filter was named."""
    step, true = 5e-3, 1.198

    def fitted(time: float) -> SimpleNamespace:
        place = time / step
        wide = 27.4 + 25.0 * (place - 0.86) ** 2 + 900.0 * max(0.0, place - 0.95) ** 1.2
        well = 26.2 + 4000.0 * (place - true) ** 2
        return SimpleNamespace(cost=min(wide, well), late=max(0.0, 1.5 - place))

    found = best_time(fitted, fitted(0.0), lambda fit: fit.late, step)
    assert found == pytest.approx(true * step, abs=0.01 * step)


def test_a_time_that_explains_all_that_is_left_is_named_although_other_forms_explain_most_of_it() -> None:
    segments = (segment(2.0, 50.0, 30.0), segment(5.0, 200.0, 30.0))
    late = parse_effect("velocity_delay:delay=0.007")
    samples = simulate(Scenario(segments, "maxwell_slip", 100.0, 0.01, 3, (late,))).samples
    result = diagnose([samples], Config())
    assert [e.name for e in result.effects] == ["presliding", "velocity_delay"]
    assert result.unexplained_percent == pytest.approx(0.0, abs=3.0)
    assert result.effects[1].parameters["delay"].value == pytest.approx(0.007, rel=0.05)
