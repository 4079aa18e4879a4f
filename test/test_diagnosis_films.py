"""A film that lags: what follows it, in which form, and what must not be named in its place."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_records import abba, chosen, names, record

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import BaseProblem
from friction_estimator.diagnosis.candidates import Candidates
from friction_estimator.diagnosis.causes import FORMS_SHARE, LATER_SHARE
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.diagnosis.joint_fit import JointFit
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.diagnosis.record import build_record
from friction_estimator.diagnosis.search import Searcher
from friction_estimator.effects import EFFECTS, parse_effect
from friction_estimator.rig.drive import Segment, segment
from friction_estimator.rig.simulate import Scenario, simulate

SEAL = Config.from_mapping({"theory.kind": "seal"})

TWO_PERIODS = (segment(1.0, 50.0, 16.0), segment(4.0, 50.0, 24.0))

UNLIKE = "direction_asymmetry:asymmetry=0.3"

FOUR_SEGMENTS = tuple(segment(t, psi, s) for psi in (50.0, 200.0) for t, s in ((1.0, 10.0), (5.0, 20.0)))


def candidates(plant: str, *effects: str) -> Candidates:
    return fitting(plant, TWO_PERIODS, 200.0, effects)[0]


def fitting(
    plant: str, segments: tuple[Segment, ...], rate_hz: float, effects: Sequence[str] = ()
) -> tuple[Candidates, float]:
    """Return what fits to a record, and its noise, N^2: of fast strokes, a film's lag is many samples of them."""
    run = simulate(Scenario(segments, plant, rate_hz, 0.01, 3, tuple(parse_effect(e) for e in effects)))
    data = build_record([run.samples], SEAL)
    context = data.context(SEAL, float(np.abs(data.friction_N).max()))
    return Candidates(BaseProblem(data, SEAL), context, EFFECTS, 0), float(np.square(run.noise_N[data.used]).sum())


def test_what_the_theory_does_not_say_follows_the_film_where_it_does() -> None:
    """The rig's film is rougher, and unlike by direction; on film_lag the mismatch is none of the film's."""
    fits = {name: candidates(name) for name in ("rig", "film_lag")}
    asymmetry = Term(EFFECTS["direction_asymmetry"], {"shape": 3.0})
    lag = Term(EFFECTS["frictional_lag"], {"lag": 0.004, "rest": 0.0})
    found = {}
    for name, terms in (("rig", [asymmetry, lag]), ("film_lag", [lag])):
        fit = JointFit(fits[name].problem, fits[name].context)
        found[name] = fit(terms)
        # Held at the velocity, it looks like a mass on the rig: 30 g and more.
        mass = fit([*found[name].terms, Term(EFFECTS["inertia"], {})], found[name]).terms[-1]
        assert abs(mass.weights[0]) < 0.015
    assert found["rig"].terms[-1].params["rest"] > 0.7
    assert found["rig"].terms[-1].params["lag"] == pytest.approx(0.002, rel=0.15)
    assert found["film_lag"].terms[-1].params["rest"] < 0.3
    assert found["film_lag"].terms[-1].params["lag"] == pytest.approx(0.006, rel=0.05)


@pytest.mark.parametrize(("plant", "hidden", "turned"), [("rig", "", True), ("film_lag", UNLIKE, False)])
def test_what_differs_between_directions_turns_with_the_film_where_it_is_the_film_s(plant, hidden, turned) -> None:
    """The rig has another film each way, after a turn still that of the other way; a lip's grip turns at once."""
    segments = (segment(0.5, 50.0, 2.0), segment(1.0, 50.0, 4.0))
    fits, noise_N2 = fitting(plant, segments, 1000.0, [hidden] if hidden else [])
    start = fits(fits.base(), "direction_asymmetry", {"shape": 3.0 if turned else 0.0}).model
    plain = fits(start, "frictional_lag", {"lag": 0.003, "rest": 1.0})
    best = fits.shaped(start, plain)
    assert bool(best.term.params.get("turned")) == turned
    # From the other form a search finds back.
    forms = [dict(v) for v in best.effect.variants(best.term.params)]
    assert {v.get("turned", 0.0) for v in forms} == ({0.0} if turned else {0.0, 1.0})
    if turned:
        assert best.term.params["lag"] == pytest.approx(0.002, rel=0.1)
        assert float(plain.model.loss.sum()) > 2.0 * noise_N2
        assert float(best.model.loss.sum()) < 1.1 * noise_N2


def test_a_cause_takes_another_form_beside_those_that_were_found_after_it() -> None:
    """Alone, a share of the level at each speed explains what a free even part beside it does."""
    segments = tuple(segment(t, psi, 2.0 * t) for psi in (50.0, 200.0) for t in (0.25, 0.5))
    fits, _ = fitting("rig", segments, 2000.0)
    mean = float(fits.problem.record.features.pressure_Pa.mean())
    pressure = {"mean": mean, "viscous": 0.0, "curvature": 0.0, "shape": 2.0}
    lag = {"lag": 0.002, "rest": 1.0, "turned": 1.0}
    model = fits(fits.base(), "direction_asymmetry", {"shape": 2.0}).model
    model = fits(fits(model, "frictional_lag", lag).model, "pressure_dependence", pressure).model
    place, better = fits.reformed(model, 0.5 * float(model.loss.sum()))
    assert place == 0
    assert better.joint.terms[0].params["shape"] == 3.0
    assert [t.name for t in better.joint.terms] == [t.name for t in model.joint.terms]
    assert fits.reformed(model, 0.9 * float(model.loss.sum())) is None


def test_a_film_that_is_late_by_a_delay_leaves_no_mass() -> None:
    samples = record(["frictional_lag:lag=0.00375,form=1"], plant="parallel_memory")
    found = diagnose([samples], Config(), catalogue=chosen("frictional_lag", "inertia", "time_delay", "sensor_lowpass"))
    assert names(found) == ["frictional_lag"]
    assert found.effects[0].parameters["lag"].value == pytest.approx(0.00375, abs=1e-4)
    assert found.unexplained_percent < 3.0


@pytest.mark.parametrize(("size", "seed", "drive"), [(0.04, 4, FOUR_SEGMENTS), (0.02, 3, TWO_PERIODS)])
def test_a_memory_that_takes_back_a_late_velocity_only_smooths(
    size: float, seed: int, drive: tuple[Segment, ...]
) -> None:
    samples = record([f"velocity_noise:size={size}"], plant="film_lag", seed=seed, segments=drive)
    found = diagnose([samples], Config(), catalogue=chosen("frictional_lag", "velocity_delay", "velocity_noise"))
    assert names(found) == ["velocity_noise", "frictional_lag"]


def test_a_late_velocity_that_is_noisy_keeps_its_time() -> None:
    """Smoothed over one window for all it was 10.8 ms late, and certain of it."""
    samples = record(["velocity_delay:delay=0.003", "velocity_noise:size=0.04"])
    found = diagnose([samples], Config(), catalogue=chosen("velocity_delay", "time_delay", "velocity_noise"))
    assert names(found) == ["velocity_noise", "velocity_delay"]
    delay = found.effects[0].parameters["delay"]
    assert delay.low < 0.003 < delay.high
    assert delay.high < 0.01


def test_a_delay_beside_a_lagging_film_is_not_the_films_other_form() -> None:
    """A film that is late by a delay, with all that the theory does not say, makes up for half of a late force."""
    samples = record(["time_delay:delay=0.00104"], plant="film_lag", segments=abba()[:4])
    times = chosen("frictional_lag", "time_delay", "sensor_lowpass", "velocity_delay", "inertia")
    found = diagnose([samples], SEAL, catalogue=times)
    assert names(found) == ["frictional_lag", "time_delay"]
    lag, delay = (effect.parameters for effect in found.effects)
    assert lag["lag"].value == pytest.approx(0.006, rel=0.1)
    assert delay["delay"].value == pytest.approx(0.00104, rel=0.1)
    assert found.unexplained_percent < 3.0


def test_a_lag_beside_bristles_is_measured_by_the_bristles_and_not_by_a_trait() -> None:
    """Beside an asymmetry of two hundred times its power the lag was refused, and a mass that is like it was named."""
    traits = ("direction_asymmetry", "pressure_dependence", "frictional_lag")
    samples = record(["presliding:size=0.04,form=1,length=1.9e-5"], plant="rig", segments=abba()[:4])
    found = diagnose([samples], Config(), catalogue=chosen(*traits, "presliding", "inertia"))
    assert set(names(found)) == {*traits, "presliding"}


@pytest.mark.parametrize("mass", [0.0, 0.5])
def test_a_cause_that_a_later_one_makes_needless_is_dropped(mass: float) -> None:
    fits = candidates("film_lag", *([f"inertia:mass={mass}"] if mass else []))
    first = fits(fits.base(), "inertia", {})
    assert first is not None
    assert first.gain > LATER_SHARE * first.model.loss.sum()
    both = fits(first.model, "frictional_lag", {"lag": 0.004, "rest": 0.0})
    assert both is not None
    needless, fewer = fits.superfluous(both.model, FORMS_SHARE, LATER_SHARE) or (None, None)
    assert needless == (None if mass else 0)
    if fewer is not None:
        assert [term.name for term in fewer.joint.terms] == ["frictional_lag"]


def test_a_cause_whose_sign_is_known_is_dropped_as_well_where_a_later_one_does_its_work() -> None:
    """A pressure that was taken for what bristles do fits them worse than they alone."""
    drive = [(psi, t) for psi in (50.0, 100.0, 200.0) for t in (1.0, 5.0)]
    data = record([], plant="maxwell_slip", segments=tuple(segment(t, psi, 10.0) for psi, t in drive))
    data = build_record([data], SEAL)
    fits = Candidates(BaseProblem(data, SEAL), data.context(SEAL, float(np.abs(data.friction_N).max())), EFFECTS, 0)
    first = fits(fits.base(), "pressure_dependence", {"mean": 8e5, "viscous": 0.0, "curvature": 1.0, "shape": 2.0})
    assert first is not None
    both = fits(first.model, "presliding", {"length": 4e-5, "spread": 1.0})
    assert both is not None
    found = fits.superfluous(both.model, FORMS_SHARE, LATER_SHARE)
    assert found is not None
    assert found[0] == 0
    assert [term.name for term in found[1].joint.terms] == ["presliding"]


def test_a_lag_is_found_beside_a_squeezed_film() -> None:
    """Alone it gains at reversals only, with half of its time; inertia was named, and 44 % were told as left."""
    hidden = [
        "squeeze_film:amplitude=1.7,speed=0.0155,form=1",
        "periodic_disturbance:amplitude=0.25,frequency=8.7,form=1",
    ]
    some = chosen("periodic_disturbance", "frictional_lag", "squeeze_film", "inertia", "presliding", "velocity_delay")
    data = record(hidden, plant="film_lag", seed=8)
    result = diagnose([data], Config(), catalogue=some)
    assert set(names(result)) == {"periodic_disturbance", "frictional_lag", "squeeze_film"}
    (lag,) = (e.parameters["lag"] for e in result.effects if e.name == "frictional_lag")
    assert lag.low < 0.006 < lag.high
    assert result.unexplained_percent < 2.0


def test_a_velocity_behind_a_filter_is_found_beside_a_lag_where_a_delay_of_many_samples_fits_as_well() -> None:
    """Its filter was begun at the delay's 7 ms, where it is none: 53 % were told as left."""
    segments = (segment(4.0, 100.0, 40.0), segment(1.0, 200.0, 30.0))
    data = record(["velocity_delay:delay=0.0004,form=1"], plant="film_lag", seed=12, segments=segments)
    some = chosen("frictional_lag", "velocity_delay", "time_delay", "sensor_lowpass", "inertia", "squeeze_film")
    result = diagnose([data], Config(), catalogue=some)
    assert names(result) == ["frictional_lag", "velocity_delay"]
    assert result.effects[1].parameters["delay"].value == pytest.approx(0.0004, abs=1e-4)
    assert result.unexplained_percent < 2.0


def test_a_gap_that_only_the_slow_drive_shows_is_one_beside_a_lagging_film() -> None:
    """The fast drive is beyond it at the first sample; bristles of 0.6 um were told.

    So is the slow one, beyond either of these gaps: they make the same record, and both are in the interval.
    """
    gaps = (8e-7, 1.5e-6)
    data, other = (record([f"backlash:gap={gap}"], plant="film_lag", noise=0.02, seed=7) for gap in gaps)
    np.testing.assert_allclose(data.friction_N, other.friction_N, atol=1e-9)
    some = chosen("frictional_lag", "backlash", "presliding", "breakaway", "inertia", "time_delay")
    result = diagnose([data], Config(), catalogue=some)
    assert names(result) == ["frictional_lag", "backlash"]
    told = result.effects[1].parameters["gap"]
    assert told.low <= gaps[0] < gaps[1] <= told.high


@pytest.mark.parametrize("profile", ["speed_steps", "sine"])
def test_of_a_film_that_is_squeezed_at_every_speed_alike_the_speed_is_not_told(profile) -> None:
    """A spring in series with a damper that relaxes within a sample does nearly the same, and was told."""
    periods = (8.0, 8.0) if profile == "speed_steps" else (1.0, 5.0)
    drive = tuple(segment(t, psi, 16.0, profile) for psi in (60.0, 200.0) for t in periods)
    hidden = (parse_effect("squeeze_film:size=0.04,speed=0.5"),)
    run = simulate(Scenario(drive, "clean", 200.0, 0.01, 13, hidden))
    assert np.abs(run.samples.velocity_m_s).max() < 0.25 * 0.55
    result = diagnose([run.samples], Config())
    assert names(result) == ["squeeze_film"]
    told = result.effects[0].parameters
    assert told.keys() == {"amplitude"}
    assert told["amplitude"].low < run.effects[0]["amplitude"] < told["amplitude"].high
    assert told["amplitude"].value == pytest.approx(run.effects[0]["amplitude"], rel=0.05)
    assert result.unexplained_percent < 2.0


@pytest.mark.parametrize(("gap", "told"), [("", []), ("backlash:gap=1.1e-5", ["backlash"])])
def test_a_gap_shorter_than_a_noisy_velocity_moves_in_a_sample_is_not_told(gap: str, told: list[str]) -> None:
    """A gap of 0.14 um was, where the noise alone moves 1.2 um in a sample; one of 11 um is."""
    hidden = ["velocity_noise:size=0.04,form=1", *([gap] if gap else [])]
    segments = tuple(segment(t, psi, s) for psi in (50.0, 200.0) for t, s in ((1.0, 12.0), (5.0, 20.0)))
    data = record(hidden, plant="tabulated", segments=segments, seed=21)
    some = chosen("velocity_noise", "backlash", "presliding", "breakaway", "direction_asymmetry")
    found = names(diagnose([data], SEAL, catalogue=some))
    assert sorted(found) == sorted(["velocity_noise", "direction_asymmetry", *told])


def test_what_is_too_short_to_be_told_is_fitted_all_the_same() -> None:
    """It may make up for a part of what is left: without it bristles of 2.5 times the noise's way were lost."""
    data = build_record([record(["backlash:gap=1.1e-5"], segments=abba()[:4])], SEAL)
    context = data.context(SEAL, float(np.abs(data.friction_N).max()))
    for blurred_m, named in ((1e-6, ["backlash"]), (1e-4, [])):
        search = Searcher(data, SEAL, replace(context, blurred_m=blurred_m), chosen("backlash", "inertia"), 0)
        assert search.fits(search.fits.base(), "backlash", {"gap": 1.1e-5}) is not None
        assert [cause.name for cause in search(lambda _stage, _part: None).causes] == named
