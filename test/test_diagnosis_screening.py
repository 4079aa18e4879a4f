"""Screening: hypotheses streamed piece by piece are those of the whole record, and the record's size costs little."""

import subprocess
import sys

import numpy as np
import pytest
from own_peak import PEAK

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis import tangent as tangent_module
from friction_estimator.diagnosis.base_problem import BaseProblem, Capacity
from friction_estimator.diagnosis.evidence import Evidence, Rule
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.joint_fit import JointFit
from friction_estimator.diagnosis.library import build_library, columns_of
from friction_estimator.diagnosis.odd_curve import SPLINES
from friction_estimator.diagnosis.record import Record, build_record
from friction_estimator.diagnosis.screening import gate, screen, screening
from friction_estimator.diagnosis.tangent import chosen_rows, normal_equations, piece_edges
from friction_estimator.effects import EFFECTS, parse_effect
from friction_estimator.effects.features import Context
from friction_estimator.rig.drive import segment
from friction_estimator.rig.simulate import Scenario, simulate

SEAL = Config.from_mapping({"theory.kind": "seal"})

Fitted = tuple[Record, Context, Joint]


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    segments = tuple(segment(t, psi, 5.0) for psi in (50.0, 200.0) for t in (1.0, 2.5))
    scenario = Scenario(segments, plant="clean", rate_hz=200.0, seed=4, effects=(parse_effect("inertia:size=0.04"),))
    record = build_record([simulate(scenario).samples], Config())
    masked = record.used.copy()
    masked[700:740] = False
    record = record.with_force(record.friction_N, masked)
    context = record.context(Config(), float(np.abs(record.friction_N).max()))
    return record, context, JointFit(BaseProblem(record, SEAL, Capacity(SPLINES, Config().fir.order)), context)()


def test_a_streamed_library_is_the_whole_one(fitted: Fitted, monkeypatch: pytest.MonkeyPatch) -> None:
    record, context, model = fitted
    monkeypatch.setattr(tangent_module, "PIECE", 500)
    evidence = model.evidence(record, 0)
    assert len(list(evidence.pieces())) > 4
    library = build_library(EFFECTS, model.features, model.reference, context, evidence)
    other = evidence.with_residual(np.cos(np.arange(record.used.size)))
    streamed = [xe for (xe,) in library.products_with(other, other.residual[:, None])]
    z = model.tangent[:] * record.used[:, None]
    edges = np.flatnonzero(np.diff(record.block, prepend=-1))
    assert len(library) > 300
    for family, again in zip(library.families, streamed, strict=True):
        for i, params in enumerate(family.points):
            x = columns_of(family.effect, params, model.features, model.reference) * record.used[:, None]
            moments = family[i].moments
            size = float(np.abs(x).max()) * record.used.size * 1e-9 + 1e-12
            for c in range(x.shape[1]):
                zx = np.add.reduceat(z * x[:, c : c + 1], edges, axis=0)
                np.testing.assert_allclose(moments.zx[:, :, c], zx, atol=size)
                xx = np.add.reduceat(x * x[:, c : c + 1], edges, axis=0)
                np.testing.assert_allclose(moments.xx[:, :, c], xx, atol=size * max(float(np.abs(x).max()), 1.0))
            for residual, products in ((evidence.residual, moments.xe), (other.residual, again[:, i])):
                xe = np.add.reduceat(x * residual[:, None], edges, axis=0)
                np.testing.assert_allclose(products, xe, atol=size)


def test_pieces_of_a_tangent_are_the_tangent(fitted: Fitted) -> None:
    record, _, model = fitted
    whole = model.tangent[:]
    assert whole.shape == model.tangent.shape
    np.testing.assert_allclose(np.concatenate([model.tangent[:333], model.tangent[333:]]), whole, atol=1e-12)
    z = whole[record.used]
    np.testing.assert_allclose(chosen_rows(model.tangent, (), record.used), z)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(z), axis=0)), 1.0, rtol=1e-6)
    norm, gram, right = normal_equations(
        model.tangent, [np.ones((record.used.size, 1))], record.friction_N, record.used
    )
    full = np.column_stack([z, np.ones(len(z))])
    np.testing.assert_allclose(gram * np.outer(norm, norm), full.T @ full, atol=1e-6)
    np.testing.assert_allclose(right * norm, full.T @ record.friction_N[record.used], atol=1e-6)


def test_gains_of_a_stack_are_those_of_its_hypotheses(fitted: Fitted) -> None:
    record, context, model = fitted
    evidence = model.evidence(record, 0)
    library = build_library(EFFECTS, model.features, model.reference, context, evidence)
    rows = evidence.folds != 2
    for family in library.families:
        one = [evidence.fit(family[i].moments, family.rule, rows).gain for i in range(len(family.points))]
        np.testing.assert_allclose(
            evidence.gains(family.stack, family.rule, rows), one, rtol=1e-6, atol=1e-9 * evidence.ee.sum()
        )
        for i, (left, pull) in enumerate(evidence.projections(family.stack)):
            known, pulled = evidence.projected(family[i].moments)
            np.testing.assert_allclose(left, known, atol=1e-8 * float(np.abs(family[i].moments.xx).sum()))
            np.testing.assert_allclose(pull, pulled, atol=1e-8 * float(np.abs(family[i].moments.xx).sum()))


def test_the_gate_lets_the_hidden_effect_through_and_no_chance(fitted: Fitted) -> None:
    record, context, model = fitted
    evidence = model.evidence(record, 0)
    library = build_library(EFFECTS, model.features, model.reference, context, evidence)
    screened = screen(evidence, library)
    assert screened[0].name == "inertia"
    (null, wide), rounding = gate(record, model, library, screened, 0.0, 0)
    assert screened[0].gain > 10.0 * max(null.max(), wide.max())
    assert set(rounding.values()) == {0.0}


def test_what_rounding_makes_must_be_exceeded_and_what_exceeds_it_is_not_hidden(fitted: Fitted) -> None:
    record, context, joint = fitted
    step = 3.0 * float(np.std(joint.residual_N))
    rounded = record.with_force(step * np.round(record.friction_N / step), record.used)
    problem = BaseProblem(rounded, SEAL, Capacity(SPLINES, Config().fir.order))
    model = JointFit(problem, context)()
    evidence = model.evidence(rounded, 0)
    library = build_library(EFFECTS, model.features, model.reference, context, evidence)
    view = screening(rounded, model, evidence, library, 0.0, step, 0)
    makes = view.rounding.values()
    assert 0.0 < max(makes) < 0.5 * step**2 / 12.0 * evidence.samples
    assert all(view.needed[name] >= 3.0 * made for name, made in view.rounding.items())
    passing = [s.name for s in view.screened if s.gain > view.needed[s.name]]
    assert passing[0] == "inertia"
    # What the whole lattice makes is more than the effect does: it is no measure of what a cause must bring.
    assert view.screened[0].gain < 2.0 * step**2 / 12.0 * evidence.samples


def test_pieces_hold_whole_blocks() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        edges = np.concatenate([[0], np.cumsum(rng.integers(1, 40_000, rng.integers(1, 30)))])
        found = piece_edges(edges)
        assert [a for a, _ in found] == [0, *(b for _, b in found[:-1])]
        assert found[-1][1] == edges.size - 1
        assert all(b == a + 1 or edges[b] - edges[a] <= tangent_module.PIECE for a, b in found)


def test_one_column_keeps_its_rule() -> None:
    rng = np.random.default_rng(1)
    z, x = rng.standard_normal((400, 2)), rng.standard_normal((400, 1))
    block = np.repeat(np.arange(4), 100)
    evidence = Evidence(z, np.zeros(2), -3.0 * x[:, 0], np.ones(400, np.bool_), block, 0)
    assert evidence.fit(evidence.moments(x), Rule((1,))).gain == 0.0
    assert evidence.fit(evidence.moments(x), Rule((0,))).weights[0] == pytest.approx(-3.0)


MEMORY = """
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.effects import parse_effect
from friction_estimator.rig.drive import segment
from friction_estimator.rig.simulate import Scenario, simulate

def made(seconds):
    segments = tuple(segment(t, psi, seconds) for psi in (50.0, 200.0, 200.0, 50.0) for t in (1.0, 5.0))
    hidden = (parse_effect("inertia:size=0.04"),)
    return simulate(Scenario(segments, plant="clean", rate_hz=250.0, seed=3, effects=hidden)).samples

large = made(30.0)
diagnose([made(15.0)], Config())
before = peak()
result = diagnose([large], Config())
assert [e.name for e in result.effects][:1] == ["inertia"]
print((peak() - before) / (len(large) - 30_000))
"""


def test_a_sample_takes_at_most_two_kilobytes() -> None:
    """The growth of the peak from 30,000 samples to 60,000, in a process of its own: the fits kept are there before."""
    done = subprocess.run([sys.executable, "-c", PEAK + MEMORY], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 2000.0
