"""Every file that broke something once, given to the verbs that read its kind; `hard_hostile.py` bounds them."""

import pytest
from hostile_files import CASES

from friction_estimator.cli.main import main


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.id)
def test_it_ends_as_promised(shared_hostile, tmp_path, capfd, case):
    out = tmp_path / "out"
    try:
        code = main(case.words(shared_hostile, out))
    except SystemExit as ended:
        code = ended.code
    assert case.faults(code, *capfd.readouterr(), out.exists()) == []
