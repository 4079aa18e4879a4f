"""Spoiled samples of the force channel: held values and spikes."""

import numpy as np
import scipy  # its parts are loaded where they are first used: 0.1 s of a start

from friction_estimator.core.intake.kinks import about, at_kinks
from friction_estimator.core.quantities import FORCE, quantity
from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.effects.base import Effect, Key, Words, effect, form_key
from friction_estimator.effects.detection import MASKED, DataView, Fault
from friction_estimator.effects.scatter import MAD, local_scale, moving_share, since_reversal_s
from friction_estimator.effects.trace import Trace

LEAST_SHARE = 0.002
"""Of the error power: less is not worth a name."""

MOVING = 0.5
"""Share of a run in which the shaft must move on."""

LONG_RUN = 5
"""Equal values in a row, one such run is enough among values that never recur."""

FINE_LATTICE = 0.98
"""Share of distinct values below which single repeats are natural."""

SPIKE = 4.8
"""Robust standard deviations of an innovation that count as a spike; white Gaussian noise has one in 600,000."""

SPIKE_CHANCE = 1.7e-6
FEWEST_SPIKES = 4
FAR, FAR_CHANCE = 9.6, 8e-22
"""Robust deviations from which two or three are enough, if they are the only ones: tails heavier than a Gaussian's
would show more of the smaller ones; and the chance of one in white Gaussian noise."""

CROWD = 0.3
"""Share of the hits that fall into one of 25 equally likely places of the cycle by a cause, not by chance."""
ONE_PLACE = 0.02
"""Share of the samples that lie between hits, too few to crowd, of one cause: a scratch, or what comes after a turn."""

AGAIN = 0.5
"""Of a hit, what a cycle later must be off as well for it to have come again."""
MOSTLY = 0.5
"""Of the hits that are seen a cycle apart, the share that must come again for those that are not to do so."""


@effect
class Dropout(Effect):
    """Samples that are lost, while the last value is held.

    Formula::

        f[k] = F[j],    j the last sample before the dropout

    A share `fraction` of the samples lies in dropouts of `length` samples.
    """

    name = "dropout"
    family = "transport"
    stage = "sensor"
    detects_at = "force"
    figure = "time"
    keys = (
        Key("fraction", "", 0.02, 0.0, 0.9, "share of samples that repeat the last good one"),
        Key("length", "samples", 5.0, 1.0, 1e4, "length of a dropout"),
        form_key("lengths geometrically distributed about the mean instead of fixed"),
    )
    size_key = "fraction"
    linear = False
    words = Words(
        "samples were lost and the last value was held",
        "runs of exactly equal {force} values while the velocity moves on",
        {"quantization": "count how long values repeat"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Hold the value before each dropout."""
        n, length = trace.time_s.size, self["length"]
        # Uniform positions drawn first: a larger fraction then only adds dropouts.
        draws = rng.random(n)
        sizes = rng.geometric(1.0 / length, n) if self["form"] >= 0.5 else np.full(n, round(length))
        force = trace.friction_N.copy()
        for start in np.flatnonzero(draws < self["fraction"] / length):
            if start > 0:
                force[start : start + sizes[start]] = force[start - 1]
        return trace.with_friction(force)

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Find runs of one repeated force value while the shaft moves on.

        On a lattice repeats are natural: there a run must be far longer than the lattice's own runs, and the force
        that the model expects must have moved by two steps in it.
        """
        force, step, n = view.force_N, view.lattice_N, view.force_N.size
        same = np.zeros(n, np.bool_)
        same[1:] = (force[1:] == force[:-1]) & ~view.restart[1:]
        same &= view.used
        if not same.any():
            return None
        start = np.flatnonzero(same & ~np.concatenate([[False], same[:-1]]))
        stop = np.flatnonzero(same & ~np.concatenate([same[1:], [False]])) + 1
        on = moving_share(view, start, stop) >= MOVING
        start, stop = start[on], stop[on]
        if not start.size:
            return None
        length = stop - start
        fewest = 1 if int(length.max()) >= LONG_RUN else 2
        if step > 0.0:
            natural = min(max(float(same.mean()), 1e-9), 0.999)
            keep = length > max(float(np.log(1e-4 / n) / np.log(natural)), 3.0)
            if view.residual_N is not None:
                expected = force - view.residual_N
                keep &= np.array([np.ptp(expected[a - 1 : b]) > 2.0 * step for a, b in zip(start, stop, strict=True)])
        else:
            # One repeat at the very top is rather a clipped sensor.
            keep = ~((np.abs(force[start]) >= np.abs(force).max()) & (length < 3))
            if np.unique(force).size < FINE_LATTICE * (n - int(same.sum())):
                keep &= length >= 3
                fewest = 8
        start, stop = start[keep], stop[keep]
        lost = int((stop - start).sum())
        # The longest run at the clipping level is no dropout.
        if start.size < fewest or lost < max(6, 1e-4 * n) or np.unique(force[start]).size < 0.5 * start.size:
            return None
        held = np.zeros(n, np.bool_)
        for a, b in zip(start, stop, strict=True):
            held[a:b] = True
        share = float(held.mean())
        reach = 2.0 * float(np.sqrt(np.square(stop - start).sum())) / n
        return Fault(
            cls.name,
            f"{start.size} runs of exactly equal {{force}} values while the shaft moves, {lost} samples in all",
            {
                "fraction": (share, "", max(0.0, share - reach), share + reach),
                "length": (lost / start.size, "samples", *_mean_interval(stop - start)),
            },
            MASKED,
            used=view.used & ~held,
        )


@effect
class Outliers(Effect):
    """Spikes of single samples.

    Formula::

        f[k] = F[k] + amplitude (+1 or -1)    at a share `fraction` of the samples
    """

    name = "outliers"
    family = "spikes"
    stage = "sensor"
    scatters = True
    detects_at = "residual"
    figure = "time"
    keys = (
        Key("amplitude", "N", 5.0, 0.0, 1e9, "height of a spike"),
        Key("fraction", "", 0.0005, 0.0, 0.5, "share of samples hit"),
        form_key("one-sided, of exponentially distributed height"),
    )
    size_key = "amplitude"
    reveals = "time_s"
    words = Words(
        "single samples are far off (electrical interference)",
        "spikes in the residual: heavy tails",
        {"stick_slip": "spikes last one sample and fall anywhere; stick-slip follows the reversals"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Add the spikes."""
        n = trace.time_s.size
        count = max(1, round(self["fraction"] * n))
        place = rng.choice(n, count, replace=False)
        height = np.where(rng.random(count) < 0.5, -1.0, 1.0)
        if self["form"] >= 0.5:
            height = 0.5 + 0.5 * rng.exponential(1.0, count)
        force = trace.friction_N.copy()
        force[place] += self["amplitude"] * height
        return trace.with_friction(force)

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Find isolated spikes among the innovations of an autoregression of order two, against the local scale.

        Steps of a coarse lattice scatter by a twelfth of their square, however seldom the residual shows it. And a
        spike is more than the model's own force changes by from one sample to the next: an error of time, a sample
        long, makes as much. Nor is what comes again at kinks of the velocity a spike. Samples that are not used are
        passed over; after them, and after a gap, a spike must stand out from those that follow it as well: where a
        value was held, the error comes back as another one, and stays.
        """
        residual, used = view.residual_N, view.used
        if residual is None or any(fault.conceals for fault in view.found):
            return None
        usual = MAD * float(np.median(np.abs(residual[used]))) + 1e-300
        # Clipped neighbours: a spike must not make the sample after it look like one.
        calm = np.clip(residual[used], -2.5 * usual, 2.5 * usual)
        weights = np.asarray(np.linalg.lstsq(_two_before(calm)[2:], calm[2:], rcond=None)[0], np.float64)
        innovation, turned = np.zeros(residual.size), np.zeros(residual.size)
        innovation[used] = residual[used] - _two_before(calm) @ weights
        turned[used] = residual[used] - _two_before(calm[::-1])[::-1] @ weights
        scale = np.maximum(local_scale(view.features, used, innovation), view.lattice_N / np.sqrt(12.0))
        size = np.abs(innovation) / scale
        change = np.abs(np.diff(view.force_N - residual))
        hit = (size > SPIKE) & used & (_continued(view) | (np.abs(turned) > SPIKE * scale))
        hit[1:] &= np.abs(innovation[1:]) > change
        hit[:-1] &= np.abs(innovation[:-1]) > change
        neighbours = np.zeros(hit.size)
        for shift in (1, 2, 3):
            neighbours[shift:] += size[:-shift] > np.maximum(3.5, 0.5 * size[shift:])
            neighbours[:-shift] += size[shift:] > np.maximum(3.5, 0.5 * size[:-shift])
        hit &= neighbours == 0
        hit &= ~_gathered(view, hit)
        hit &= ~_repeated(view, hit, innovation)
        count = int(hit.sum())
        power = float(np.square(innovation[hit]).sum()) / max(int(used.sum()), 1)
        total = float(np.mean(np.square(residual[used])))
        few = count < FEWEST_SPIKES
        p_value = float(scipy.special.bdtrc(count - 1, residual.size, FAR_CHANCE if few else SPIKE_CHANCE))
        if few and (count < 2 or size[hit].min() < FAR or _at_one_place(view, hit)):
            return None
        if p_value > 1e-4 or power < LEAST_SHARE * total:
            return None
        height = float(np.sqrt(np.mean(np.square(innovation[hit]))))
        reach = height * (0.02 + 2.0 * usual / height / np.sqrt(count)) + 0.5 * float(np.std(np.abs(innovation[hit])))
        share = count / residual.size
        spread = 2.0 * float(np.sqrt(count)) / residual.size
        return Fault(
            cls.name,
            f"{count} isolated spikes of about {quantity(height, FORCE, '.3g')}",
            {
                "amplitude": (height, "N", height - reach, height + reach),
                "fraction": (share, "", max(0.0, share - spread), share + spread),
            },
            MASKED,
            p_value=p_value,
            used=used & ~hit,
            power_N2=power,
        )


def _mean_interval(values: Ints) -> tuple[float, float]:
    mean = float(np.mean(values))
    reach = 2.0 * float(np.std(values)) / float(np.sqrt(len(values))) + 0.5
    return mean - reach, mean + reach


def _two_before(values: Floats) -> Floats:
    """Return the two values before each one, the nearer first, (n, 2); zeros before the first two."""
    out = np.zeros((values.size, 2))
    out[2:] = np.column_stack([values[1:-1], values[:-2]])
    return out


def _continued(view: DataView) -> Bools:
    """Return which samples follow two usable ones without a gap, (n,)."""
    out = np.zeros(view.used.size, np.bool_)
    whole = view.used[:-1] & ~view.restart[1:]
    out[2:] = whole[1:] & whole[:-1]
    return out


def _gathered(view: DataView, hit: Bools) -> Bools:
    """Return which hits gather at one place of the cycle, (n,): they have a cause there and are no interference."""
    out = np.zeros(hit.size, np.bool_)
    for values in _places(view):
        edges = np.quantile(values, np.linspace(0.0, 1.0, 26)[1:-1])
        cell = np.searchsorted(edges, values)
        crowd = np.bincount(cell[hit], minlength=25)
        out |= (crowd > max(3.0, CROWD * float(hit.sum())))[cell]
    return out & hit


def _repeated(view: DataView, hit: Bools, innovation: Floats) -> Bools:
    """Return which hits come again with the drive at kinks of its velocity, (n,): steps of its speed may make them.

    A hit comes again where its partner, or a neighbour of that, is off the same way by half as much. Where most of
    those that have a partner do, so do the others, whose partners were not recorded. Interference may have a period
    that fits the drive's, but does not keep to kinks.
    """
    out, known = np.zeros(hit.size, np.bool_), np.zeros(hit.size, np.bool_)
    if view.pairs is None:
        return out
    hit = hit & about(at_kinks(view.features.velocity_m_s, view.restart))
    padded = np.pad(innovation, 1)
    for one, other in (view.pairs, view.pairs[::-1]):
        here, there = one[hit[one]], other[hit[one]]
        near = np.column_stack([padded[there], padded[there + 1], padded[there + 2]])
        way = np.sign(innovation[here])
        again = (near * way[:, None]).max(axis=1, initial=0.0) > AGAIN * np.abs(innovation[here])
        known[here] = True
        out[here[again]] = True
    return out | hit & ~known if out.sum() > MOSTLY * known.sum() else out


def _at_one_place(view: DataView, hit: Bools) -> bool:
    """Return whether all hits share a place of the cycle, by one of its variables."""
    for values in _places(view):
        between = np.searchsorted(np.sort(values), values[hit])
        if np.ptp(between) < ONE_PLACE * values.size:
            return True
    return False


def _places(view: DataView) -> tuple[Floats, ...]:
    """Return what says where in the cycle each sample is, (n,) each."""
    f = view.features
    return since_reversal_s(f), f.velocity_m_s, f.position_m
