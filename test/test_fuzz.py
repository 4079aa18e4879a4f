"""A short sample of the long attack of hard/hard_fuzz.py, with a fixed seed."""

from hard.fuzz_kinds import KINDS, SLOW
from hard.fuzzing import attack

INPUTS = dict.fromkeys(KINDS, 9) | dict.fromkeys(SLOW, 8)


def test_mutated_files_are_read_or_refused_in_one_line(tmp_path):
    tallies = attack(8, ((name, number) for name in KINDS for number in range(INPUTS[name])), tmp_path)
    assert {name: tally.faults for name, tally in tallies.items() if tally.faults} == {}
    for name, tally in tallies.items():
        assert tally.read + tally.refused == INPUTS[name], name
        assert tally.read >= 1, f"no sound {name} file"
        assert tally.refused >= 2, f"no damaged {name} file"
