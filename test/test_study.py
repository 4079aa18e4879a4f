"""The study of hidden cases knows what is true of what it hides."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "benchmarks" / "diagnosis"))
from study import make_case
from truth import expected

CASE = {"row": "abba 4 %", "plant": "tabulated", "drive": "1 kHz", "seed": 142, "size": 0.04, "noise": 0.01}
USUAL = {"form": "drawn", "place": None, "coloured": False, "theory": "", "out": False, "gain": False}


@pytest.mark.parametrize(
    ("name", "quantity"), [("viscosity_drift", "drop"), ("presliding", "amplitude"), ("inertia", "mass")]
)
def test_the_truth_of_a_quantity_is_what_was_hidden(name, quantity):
    made = make_case(CASE | USUAL | {"truth": [name]})
    (effect,) = made.effects
    assert expected(effect, made, 0, "tabulated")[quantity] == pytest.approx(effect.values[quantity], rel=0.3)
