"""Terms of an extended model: the same numbers in one pass, in pieces and sample by sample."""

import numpy as np
import pytest

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.effects import extension_from_config
from friction_estimator.effects.extension import ExtensionTerms
from friction_estimator.effects.features import FeatureMaker
from friction_estimator.effects.term import parse_term
from friction_estimator.rig.drive import segment
from friction_estimator.rig.simulate import Scenario, simulate

TERMS = [
    "inertia:part=0",
    "presliding:length=2e-5,scale=0.5",
    "time_delay:delay=0.004",
    "frictional_lag:lag=0.01",
    "frictional_lag:lag=0.01,rest=0.7",
    "frictional_lag:lag=0.013,delayed=1",
    "position_dependence:wavelength=0.005,part=2",
    "sensor_drift:duration=10,part=1",
    "backlash:gap=1e-5",
]

ON_FILM = [
    *(f"direction_asymmetry:shape=2,part={part}" for part in (0, 3)),
    "direction_asymmetry:shape=0",
    "pressure_dependence:mean=5e5,viscous=0,curvature=0",
    "frictional_lag:lag=0.01,rest=0.7,turned=1",
    "wear:length=1",
]
"""Beside a film that lags."""

CARRIED = [*(f"presliding:length=2e-5,spread=1,part={part}" for part in (0, 3)), "wear:length=1", "backlash:gap=1e-5"]
"""On bristles, whose force those after them are made from, too."""

EARLIER = ["inertia:part=0", "frictional_lag:lag=0.01,rest=0.7", "direction_asymmetry:shape=0", *CARRIED]
"""What acts before a time of the whole force."""

MODELS = [
    TERMS,
    ON_FILM,
    CARRIED,
    [*EARLIER, "time_delay:delay=0.004", "saturation:level=4"],
    [*EARLIER, "sensor_lowpass:time_constant=0.01"],
    [*EARLIER, "velocity_delay:delay=0.004"],
]


def config(terms: list[str]) -> Config:
    return Config.from_mapping(
        {
            "extension.terms": terms,
            "learned.extension_weights": [0.3] * len(terms),
            "learned.fir_taps": [0.9, 0.05, 0.03, 0.01, 0.01],
            "learned.theory_taps": [0.8, 0.1, 0.05, 0.03, 0.02],
            "theory.kind": "seal",
            "basis.velocity_range": [-0.14, 0.14],
            "force_unit": 4.0,
            "fir.order": 4,
        }
    )


@pytest.fixture(scope="module")
def samples() -> Samples:
    return simulate(Scenario((segment(1.0, 50.0, 5.0), segment(2.0, 200.0, 4.0)), rate_hz=200.0)).samples


@pytest.mark.parametrize("terms", MODELS)
def test_pieces_give_what_one_pass_gives(samples: Samples, terms: list[str]) -> None:
    whole = ExtensionTerms(config(terms)).columns(samples, np.zeros(len(samples)))
    extension = ExtensionTerms(config(terms))
    single = np.concatenate([extension.columns(samples[k : k + 1], np.zeros(1)) for k in range(len(samples))])
    np.testing.assert_array_equal(single, whole)
    assert np.all(np.std(whole, axis=0) > 0.0)


@pytest.mark.parametrize("terms", MODELS)
def test_restart_forgets(samples: Samples, terms: list[str]) -> None:
    extension = ExtensionTerms(config(terms))
    first = extension.columns(samples, np.zeros(len(samples)))
    extension.restart()
    np.testing.assert_array_equal(extension.columns(samples, np.zeros(len(samples))), first)


def test_the_acceleration_of_a_parabola_is_exact_whatever_the_steps() -> None:
    stamps = np.cumsum([0, 5, 5, 10, 5, 3, 20, 5, 5]) * 1_000_000
    time = stamps * 1e-9
    samples = Samples(stamps, 3.0 * time - 40.0 * time**2, np.zeros(9), np.arange(9) == 0)
    made = FeatureMaker(101325.0, 0.0, 54.0)(samples).acceleration_m_s2
    np.testing.assert_allclose(made[2:], 3.0 - 80.0 * time[2:], rtol=1e-12)


def test_no_terms_is_no_extension() -> None:
    assert extension_from_config(config([])) is None


def test_the_estimator_learns_a_hidden_mass_online() -> None:
    from friction_estimator.effects import parse_effect

    run = simulate(
        Scenario(
            (segment(1.0, 50.0, 30.0), segment(5.0, 50.0, 20.0)),
            plant="clean",
            rate_hz=200.0,
            effects=(parse_effect("inertia:mass=0.8"),),
        )
    )
    settings = config(["inertia:part=0"]).updated({"learned.extension_weights": ()})
    learned = replay(run.samples, settings, extension=extension_from_config(settings))
    assert learned.parameters.extension_weights == pytest.approx([0.8], rel=0.1)
    plain = replay(run.samples, config([]))
    assert learned.figures()["nrmse_final"] < plain.figures()["nrmse_final"] * 1.02


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("gravitation", "unknown effect"),
        ("quantization:step=1", "has no regressor"),
        ("presliding", "length is missing"),
        ("presliding:length=a", "is not key=number"),
        ("inertia:part=1", "has 1 columns"),
        ("inertia:scale=0", "scale is not 0"),
        *((f"{term}=0", "a length or a time of 0") for term in ("sensor_lowpass:time_constant", "frictional_lag:lag")),
        ("sensor_drift:part=1,duration=0", "a length or a time of 0"),
        ("viscoelastic_relaxation:time_constant=0", "time_constant is below 0.0001"),
        *((f"{term}=0", "length is below") for term in ("presliding:length", "wear:length")),
        ("time_delay:delay=-0.01", "delay is below 0"),
    ],
)
def test_bad_terms_are_refused_in_one_line(text: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_term(text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("words", "change"),
    [
        (r"learned\.wavelet_weights has \d+ values", lambda config: {"learned.wavelet_weights": [1.0, 2.0]}),
        (
            r"learned\.wavelet_weights has \d+ values",
            lambda config: {"learned.wavelet_weights": config.learned.wavelet_weights[:-1]},
        ),
        (r"learned\.extension_weights has 2 values", lambda config: {"learned.extension_weights": [1.0, 2.0]}),
        (r"learned\.fir_taps has 1 values", lambda config: {"learned.fir_taps": [1.0]}),
        ("length is missing", lambda config: {"extension.terms": ["breakaway"]}),
        ("unknown effect 'brakaway'", lambda config: {"extension.terms": ["brakaway:length=1.0"]}),
        ("is not key=number", lambda config: {"extension.terms": ["inertia:part=x"]}),
        ("part counts from 0", lambda config: {"extension.terms": ["inertia:part=7"]}),
    ],
)
def test_an_extended_model_that_does_not_fit_itself_is_refused_in_one_line(words, change):
    """One weight less once ended in an IndexError of the reference curve."""
    base = {
        "theory.kind": "seal",
        "basis.velocity_range": [-0.15, 0.15],
        "force_unit": 5.0,
        "extension.terms": ["inertia"],
    }
    cold = Config.from_mapping(base)
    warm = Estimator(cold, extension_from_config(cold)).learned_config
    config = warm.updated(change(warm))
    with pytest.raises(ConfigError, match=words) as caught:
        Estimator(config, extension_from_config(config))
    assert str(caught.value).isprintable()
