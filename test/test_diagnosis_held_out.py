"""A gain is told from chance by its scatter over blocks of the record."""

from types import SimpleNamespace

import numpy as np
import pytest

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.held_out import gain_between, gains_beyond_chance
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects import EFFECTS

BLOCKS, EACH = 20, 50


def errors(gains: Floats, seed: int) -> tuple[Floats, Floats, Record]:
    """Return errors without and with an effect whose share of each block's error power is given."""
    n = BLOCKS * EACH
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(n)
    change = rng.standard_normal(n) * np.sqrt(np.repeat(gains, EACH))
    block = np.repeat(np.arange(BLOCKS), EACH)
    record = SimpleNamespace(used=np.ones(n, np.bool_), block=block, blocks=BLOCKS)
    return noise + change, noise, record  # type: ignore[return-value]


@pytest.mark.parametrize("seed", range(5))
def test_a_gain_that_one_block_holds_most_of_is_one_where_the_others_gain_too(seed: int) -> None:
    """One reversal at a change of the drive held 4.8 of 6.6 N^2 of a gap that all 22 blocks gain by."""
    everywhere = np.full(BLOCKS, 0.08)
    everywhere[7] = 6.0
    before, after, record = errors(everywhere, seed)
    counted, gap = np.ones(before.size, np.bool_), EFFECTS["backlash"]
    assert not gains_beyond_chance(before, after, record, counted, gap)
    assert gains_beyond_chance(before, after, record, counted, gap, but_best=True)
    assert gain_between(before, after, record, 1.0, [gap]).low_percent > 0.0
    # Of what acts anywhere that one block may be what the model gets wrong of its drive.
    assert gain_between(before, after, record, 1.0, [EFFECTS["inertia"]]).low_percent <= 0.0


@pytest.mark.parametrize("seed", range(5))
def test_a_gain_of_one_block_alone_is_none(seed: int) -> None:
    alone = np.zeros(BLOCKS)
    alone[7] = 6.0
    before, after, record = errors(alone, seed)
    counted, gap = np.ones(before.size, np.bool_), EFFECTS["backlash"]
    assert not gains_beyond_chance(before, after, record, counted, gap, but_best=True)
    assert gain_between(before, after, record, 1.0, [gap]).low_percent <= 0.0
