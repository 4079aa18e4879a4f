"""The search on plants of another hand: order of causes, forms of one cause. More of it: hard/hard_diagnosis.py."""

import pytest
from diagnosis_records import names, record

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.rig.drive import segment

ONE_PRESSURE = (segment(1.0, 50.0, 20.0), segment(5.0, 50.0, 40.0))


@pytest.mark.parametrize(
    ("hidden", "plant", "segments", "found"),
    [
        # What one form of the film leaves is no inertia.
        (["squeeze_film:size=0.04,form=1,speed=0.02"], "stribeck", None, {"squeeze_film"}),
        # A drift and then an asymmetry do nearly what the asymmetry's own shape does alone.
        (["stick_slip:size=0.04"], "tabulated", ONE_PRESSURE, {"direction_asymmetry", "stick_slip"}),
    ],
)
def test_the_set_is_what_is_hidden_and_the_plants_trait(hidden, plant, segments, found) -> None:
    result = diagnose([record(hidden, plant=plant, segments=segments)], Config())
    assert set(names(result)) == found
