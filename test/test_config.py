"""Configuration: ranges and units that are given, chosen or open; parameters of earlier versions."""

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.settings.config import PARAMETERS, RETIRED, Config, retired

speeds = st.floats(1e-9, 1e9)


@pytest.mark.parametrize("name", RETIRED)
@pytest.mark.parametrize("value", [True, 0.5, "word", None, [1.0]])
def test_parameters_of_earlier_versions_are_passed_over(name, value):
    assert Config.from_mapping({name: value}) == Config()
    assert Config.from_mapping({name: value, "fir.order": 3}).fir.order == 3


def test_each_retired_parameter_is_named_with_its_successor():
    lines = retired(["fir.order", *RETIRED])
    assert len(lines) == len(RETIRED)
    for line, (name, successor) in zip(lines, RETIRED.items(), strict=True):
        assert name in line
        assert successor in line
        assert successor in PARAMETERS
    assert retired(["fir.order", "nonsense"]) == []
    assert not set(RETIRED) & set(PARAMETERS)


@pytest.mark.parametrize("room", ["basis", "learned"])
@pytest.mark.parametrize("reach", [[0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.0, 0.1]])
def test_what_is_no_range_is_refused_by_name(room, reach):
    with pytest.raises(ConfigError, match=rf"{room}\.velocity_range is .*lowest first"):
        Config.from_mapping({f"{room}.velocity_range": reach})


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "wide"])
def test_ranges_are_finite_numbers(value):
    for name in ("basis.velocity_range", "learned.velocity_range"):
        with pytest.raises(ConfigError, match="velocity_range"):
            Config.from_mapping({name: [-0.1, value]})


def test_nothing_is_met_before_range_and_unit_are_known():
    config = Config()
    assert (config.is_met, config.reach, config.velocity_scale, config.unit_N) == (False, None, 0.0, 0.0)
    assert not config.updated({"basis.velocity_range": [-0.1, 0.2]}).is_met
    assert not config.updated({"force_unit": 3.0}).is_met
    with pytest.raises(ConfigError, match="no first contact"):
        Estimator(config)
    with pytest.raises(ConfigError, match="no first contact"):
        Estimator(config.updated({"force_unit": 3.0}))


@given(speeds, speeds, speeds, speeds)
def test_what_is_given_wins_over_what_was_chosen(low, high, force, scale):
    chosen = {
        "learned.velocity_range": [-0.5, 0.25],
        "learned.velocity_scale": scale,
        "learned.force_unit": 7.0,
    }
    met = Config.from_mapping(chosen)
    assert met.has_units
    assert (met.reach, met.velocity_scale, met.unit_N) == ((-0.5, 0.25), scale, 7.0)
    given_ = met.updated({"basis.velocity_range": [-low, high], "force_unit": force})
    assert given_.has_units
    assert (given_.reach, given_.velocity_scale, given_.unit_N) == ((-low, high), max(low, high), force)


def test_a_parallel_model_is_met_when_its_theory_is_known_too():
    units = Config.from_mapping({"basis.velocity_range": [-1.0, 1.0], "force_unit": 3.0})
    assert not units.is_met
    with pytest.raises(ConfigError, match=r"theory\.kind is auto and no first contact"):
        Estimator(units)
    for known in ({"theory.kind": "seal"}, {"learned.theory": "seal"}, {"model.type": "hammerstein"}):
        assert units.updated(known).is_met
    for kind in ({"theory.kind": "stribeck"}, {"learned.theory": "stribeck"}):
        assert not units.updated(kind).is_met, "the curve is still to be found"
        assert units.updated(kind | {"stribeck.coulomb": [2.0]}).is_met


def test_without_a_theory_parallel_is_hammerstein():
    config = Config.from_mapping({"theory.kind": "none", "basis.velocity_range": [-1.0, 1.0], "force_unit": 3.0})
    assert (config.structure, config.is_met) == ("hammerstein", True)
    assert Estimator(config).parameters.theory_taps.size == 0


def test_files_of_versions_whose_default_was_the_seal_say_no_kind():
    learned = {"learned.velocity_range": [-1.0, 1.0], "learned.force_unit": 1.0, "learned.wavelet_weights": [0.0]}
    assert Config.from_mapping(learned).theory_kind == "seal"


def test_a_learned_range_without_its_scale_is_its_own_scale():
    config = Config.from_mapping({"learned.velocity_range": [-0.5, 0.25], "learned.force_unit": 1.0})
    assert config.velocity_scale == 0.5


def test_a_configuration_reads_back_what_it_wrote():
    config = Config.from_mapping(
        {"learned.velocity_range": [-0.5, 0.25], "learned.velocity_scale": 0.4, "learned.force_unit": 7.0}
    )
    assert Config.from_mapping(config.to_mapping()) == config


EXTENDED = """
model.type: hammerstein
basis.velocity_range: [-0.13, 0.13]
force_unit: 4.5
rls.forgetting_factor: 0.999
rls.initial_variance: 1.0
rls.relinearise: true
extension.terms: ["inertia:part=0"]
learned.extension_weights: [0.8]
"""


def test_a_file_that_an_earlier_diagnosis_wrote_still_loads():
    values = yaml.safe_load(EXTENDED)
    config = Config.from_mapping(values)
    assert config.is_met
    assert (config.reach, config.velocity_scale, config.unit_N) == ((-0.13, 0.13), 0.13, 4.5)
    assert config.extension.terms == ("inertia:part=0",)
    assert [line.split()[0] for line in retired(values)] == ["rls.initial_variance", "rls.relinearise"]
