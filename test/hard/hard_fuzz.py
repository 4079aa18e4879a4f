"""Thousands of mutated files of every kind: one line each, no traceback, no crash, none over 10 s or 1 GB.

FUZZ_INPUTS (20000) is the number of inputs a kind, a tenth of it where each starts an interpreter; FUZZ_SEED (1) is
where they start. One kind:
make hard PYTEST_ARGS="test/hard/hard_fuzz.py -k mcap"
"""

import importlib.util
import os

import pytest
from hard.fuzz_kinds import KINDS, SLOW
from hard.fuzzing import attack, guided

INPUTS, SEED = int(os.environ.get("FUZZ_INPUTS", "20000")), int(os.environ.get("FUZZ_SEED", "1"))


@pytest.mark.parametrize("name", KINDS)
def test_mutated_files_are_read_or_refused_in_one_line(tmp_path, name):
    inputs = INPUTS // 10 if name in SLOW else INPUTS
    tally = attack(SEED, ((name, number) for number in range(inputs)), tmp_path)[name]
    print(f"{name}: {inputs} inputs, {tally}")
    assert not tally.faults, tally.faults[:5]
    assert tally.read + tally.refused == inputs


@pytest.mark.skipif(importlib.util.find_spec("atheris") is None, reason="atheris is not installed: no coverage guides")
@pytest.mark.parametrize("name", KINDS)
def test_files_chosen_by_coverage_are_read_or_refused_in_one_line(tmp_path, name):
    tally = guided(name, SEED, INPUTS, tmp_path)
    print(f"{name}: coverage-guided, {tally}")
    assert not tally.faults, tally.faults[:5]
