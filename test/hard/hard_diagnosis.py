"""Diagnoses on plants whose own trait hides or imitates what is hidden: a minute each."""

from pathlib import Path

import pytest
from diagnosis_records import names, record
from measured_seals import WITHOUT_THEORY, check_measured_seal

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.effects import EFFECTS

RIG = {"direction_asymmetry", "pressure_dependence", "frictional_lag"}


@pytest.mark.parametrize(
    ("hidden", "plant", "found"),
    [
        # The bristles' error hides the spikes from the base model; the last model shows them.
        ("outliers:size=0.04", "maxwell_slip", {"outliers", "presliding"}),
        # A delay is one of the bristles as well.
        ("time_delay:delay=0.003", "maxwell_slip", {"presliding", "time_delay"}),
        # The theory's boundary part is not that of this plant: time and distance tell, not the shape over speed.
        ("wear:size=0.04", "rig", {*RIG, "wear"}),
        ("viscosity_drift:size=0.04", "rig", {*RIG, "viscosity_drift"}),
    ],
)
def test_the_set_is_what_is_hidden_and_the_plants_traits(hidden: str, plant: str, found: set[str]) -> None:
    assert set(names(diagnose([record([hidden], plant=plant)], Config()))) == found


def test_what_is_not_in_the_catalogue_is_not_explained_by_all_the_others() -> None:
    without = {name: cls for name, cls in EFFECTS.items() if name != "squeeze_film"}
    result = diagnose([record(["squeeze_film:size=0.04,speed=0.01"])], Config(), catalogue=without)
    assert result.verdict in ("unexplained", "effects_found")
    assert result.unexplained_percent > 5.0
    assert result.remainder is not None


@pytest.mark.parametrize("given", [{}, WITHOUT_THEORY], ids=["theory", "without"])
@pytest.mark.parametrize("seal", ["O-ring257", "X-ring257"])
def test_measured_seals(shared_data: Path, seal: str, given: dict[str, object]) -> None:
    check_measured_seal(shared_data, seal, given)
