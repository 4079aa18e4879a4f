"""`reproduce` as a user runs it: minutes of fits, with as few seeds and seconds as it takes."""

import json

from friction_estimator.cli.main import main


def test_the_verb_writes_claims_figures_and_one_page(capsys, tmp_path):
    out = tmp_path / "out"
    assert main(["reproduce", "--out", str(out), "--seeds", "2", "--seconds", "30"]) == 0
    printed = capsys.readouterr().out
    document = json.loads((out / "claims.json").read_text())
    assert document["schema"] == "friction_estimator/claims/1"
    assert len(document["claims"]) == 8
    for claim in document["claims"]:
        assert f"{claim['verdict']:<10} {claim['id']}" in printed
    unique = next(c for c in document["claims"] if c["id"] == "quadratic_cost_with_unique_minimum")
    assert unique["verdict"] == "refuted"
    assert len(list(out.glob("figure_*.svg"))) == len(list(out.glob("figure_*.png"))) == 5
    assert not list(out.glob(".*"))
    assert (out / "index.html").stat().st_size < 5_000_000
