"""One sample at a time gives what a pass over the recording gives, bit for bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.live import LiveStep
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.derive import with_live_units


def events(seed, count=400):
    """Return (stream, stamp_ns, value) with the disorder of real topics."""
    rng = np.random.default_rng(seed)
    stamps = 10**18 + np.cumsum(rng.choice([5, 5, 5, 5, 5, 200, 2000], count)) * 10**6
    stamps[count // 2 :] -= 3 * 10**9  # a bag loops
    rows = []
    for k, stamp in enumerate(stamps):
        velocity = 0.2 * np.sin(0.05 * k)  # leaves the range of 0.15 m/s
        values = [velocity, 20.0 * velocity + rng.standard_normal()]
        if rng.random() < 0.05:
            values[rng.integers(2)] = rng.choice([np.nan, np.inf, 1e300])
        pair = [(0, stamp, values[0]), (1, stamp, values[1])]
        if rng.random() < 0.2:
            pair.reverse()
        if rng.random() < 0.1:
            pair.pop()
        if rng.random() < 0.1:
            pair.append(pair[-1])
        if rng.random() < 0.1:
            pair.append((rng.integers(2, 5), stamp, rng.uniform(0.0, 1e6)))
        rows += pair
    for place in rng.integers(0, len(rows) - 1, 40):
        rows[place], rows[place + 1] = rows[place + 1], rows[place]
    stream, stamp, value = zip(*rows, strict=True)
    return np.array(stream, np.int64), np.array(stamp, np.int64), np.array(value)


@pytest.mark.parametrize("model", ["parallel", "hammerstein"])
@pytest.mark.parametrize("law", ["lms", "nlms", "rls"])
@settings(deadline=None, max_examples=8)
@given(
    seed=st.integers(0, 10**6),
    sign=st.sampled_from([1, -1]),
    slop=st.sampled_from([0.0, 0.002]),
    force_unit=st.sampled_from([0.0, 5e3]),  # at 5 kN the theoretical curve is scaled
)
def test_live_equals_offline(model, law, seed, sign, slop, force_unit):
    settings_given = {"input.friction_sign": sign, "sync.slop": slop, "force_unit": force_unit}
    config = with_live_units(Config.from_mapping({"model.type": model, "model.law": law, **settings_given}))
    stream, stamp, value = events(seed)
    intake, estimator = Intake(config), Estimator(config)
    samples = intake.push(stream, stamp, value)
    expected = estimator.run(samples)

    step = LiveStep(Intake(config), Estimator(config))
    rng = np.random.default_rng(seed)
    found, at = [], 0
    while at < stream.size:
        count = min(int(rng.choice([1, 2, 2, 3, 20])), stream.size - at)
        part = slice(at, at + count)
        step.stream[:count], step.stamp_ns[:count], step.value[:count] = stream[part], stamp[part], value[part]
        found += step.run(count, learn=True)
        at += count

    assert [row[0] for row in found] == samples.stamp_ns.tolist()
    assert [row[2] for row in found] == samples.friction_N.tolist()
    np.testing.assert_array_equal([row[3] for row in found], expected)
    assert step.intake.counts == intake.counts
    assert step.estimator.health == estimator.health
    for name, array in estimator.state()["arrays"].items():
        np.testing.assert_array_equal(step.estimator.state()["arrays"][name], array)
