"""Acceleration from velocity, matched in time: a local cubic about each sample, which waits for those that follow it.

The derivative at a sample is that of the least-squares cubic over the samples up to `half_width` seconds before and
after it, by their stamps (Savitzky and Golay 1964, for uneven steps by Forsythe's orthogonal polynomials). So
acceleration, velocity, position and force belong to one instant: a causal filter of the acceleration alone would lag by
half its length, and a lag D of inertia is a viscous force of -m w^2 D that no model tells from friction. The price is
that a sample is admitted `half_width` later. At a gap, and where a recording ends, the cubic is fitted to the samples
on the one side.

White velocity noise s at a step dt becomes 8.7 s sqrt(dt) / (2 half_width)^1.5 of the acceleration's unit over many
samples: a width in seconds, since noise in a column shrinks its coefficient, and more so the higher the rate. How
noisy an acceleration is, the errors of its own cubic say: `acceleration_variance` goes with it.

Where the acceleration jumps (a triangle, a trapezoid of velocity) a cubic over both sides rounds it. Two lines that
meet at a corner are fitted beside it (two-phase regression: Hinkley, J. Am. Stat. Assoc. 66 (1971) 736), one
pair for each step at which they may, and the derivative is the mean over cubic and pairs, each with its weight of
evidence

    exp(-AICc / 2),   AICc = n log(E / n) + 2 k + 2 k (k + 1) / (n - k - 1)

(E the sum of squared errors over the n samples of the window, k parameters; Hurvich and Tsai 1989, Burnham and Anderson
2002): the mean of what the acceleration may be, and not the likeliest, does not shrink a coefficient
(docs/decisions/0134-corners-of-the-velocity.md).

Where none of these fits as well as one usually does, there are further corners (a ramp shorter than the window), and
the acceleration may be off by far more than its noise. `acceleration_doubt` says by how much, and what is in doubt by
more than it can teach is not learned from (docs/decisions/0150-a-doubtful-acceleration-teaches-nothing.md).
"""

from dataclasses import replace

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.sample import NS_PER_S, Samples, in_sequence

DEGREE = 3
"""Of the polynomial: the acceleration's own curvature is followed."""

RIVALS = (5, 7)
"""Degrees that a corner has to stand up to as well. Their slopes are taken only where the errors of cubic and corners
are larger than they usually are: a motion that is always too fast for the cubic, or noise that is not white, is then no
corner, and stays what the cubic makes of it."""

DEGREES = (*RIVALS, DEGREE)

LEAST = 2
"""Samples on either side that a window has at least, where the rate is low."""

CORNER_ODDS = 0.01
"""That the acceleration jumps within a window, before its samples were seen."""

NEGLIGIBLE = 1e-3
"""Weight of all corners together beside the cubic below which nothing is averaged."""

CORNER = (0.5 / 0.0362) ** 2
"""Of a cubic over a corner in the middle of its window: the square of what its slope is off, over the mean square of
what it leaves over the half width squared. Of a corner elsewhere it is less."""

BY_CHANCE = 3.0
"""Standard deviations by which the logarithm of the errors' power has to lie above the usual one to say anything."""

STRONG = 2.0
"""Times that power, above which it is no noise of whatever colour: the higher polynomials' slopes are taken then."""

MEMORY = 40.0
"""Windows over which the usual one is averaged."""

ROBUST = 0.5
"""Distance beyond which a logarithm pulls no more at its average: corners are few, and far above."""

SLOWLY = 0.1
"""Share at which errors that are not usual change what is: noise may come to be another."""

LOWER_HALF = 2.5
"""Standard deviations of a normal distribution in the mean of its distances below the mean, 0 above."""

MOVES = 9.0
"""Mean square of the velocity in a window over that of the errors, above which the shaft moves: noise at rest may be
another."""

NOISE_LIKE = 9.0
"""Times their variance by noise, up to which slopes that differ say nothing."""

ROUNDING = 1e-13
"""Of the samples' own power: what errors are told apart down to."""


@njit(cache=True)
def _window(stamp_ns, restart, width_ns, i):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the first and the last sample of the window about sample i, which ends at restarts."""
    low = high = i
    while low > 0 and not restart[low] and (i - low < LEAST or stamp_ns[i] - stamp_ns[low - 1] <= width_ns):
        low -= 1
    last = stamp_ns.size - 1
    while high < last and not restart[high + 1] and (high - i < LEAST or stamp_ns[high + 1] - stamp_ns[i] <= width_ns):
        high += 1
    return low, high


@njit(cache=True)
def _polynomials(time, value, count, degree, now, before, told):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill told[d], (3,), for least-squares polynomials of degree d up to `degree`: slope at 0, spread, errors left.

    With orthogonal polynomials p_j over the window of n samples

        p_(j+1) = (t - a_j) p_j - b_j p_(j-1),   v'(0) = sum_j <v, p_j> / <p_j, p_j> p_j'(0)
        var v'(0) = s^2 spread,   spread = sum_j p_j'(0)^2 / <p_j, p_j>,   E = <v, v> - sum_j <v, p_j>^2 / <p_j, p_j>
    """
    for j in range(count):
        now[j] = 1.0
        before[j] = 0.0
    value_now, value_before = 1.0, 0.0  # p_j and p_j' at the sample itself
    slope_now, slope_before = 0.0, 0.0
    power_before = 1.0
    slope, spread, left = 0.0, 0.0, 0.0
    for j in range(count):
        left += value[j] ** 2
    for d in range(degree + 1):
        power, moment, fit = 0.0, 0.0, 0.0
        for j in range(count):
            power += now[j] * now[j]
            moment += time[j] * now[j] * now[j]
            fit += now[j] * value[j]
        slope += fit / power * slope_now
        spread += slope_now * slope_now / power
        left -= fit * fit / power
        told[d, 0], told[d, 1], told[d, 2] = slope, spread, max(left, 0.0)
        a = moment / power
        b = power / power_before if d > 0 else 0.0
        for j in range(count):
            now[j], before[j] = (time[j] - a) * now[j] - b * before[j], now[j]
        slope_now, slope_before = value_now - a * slope_now - b * slope_before, slope_now
        value_now, value_before = -a * value_now - b * value_before, value_now
        power_before = power


@njit(cache=True)
def _corners(time, value, count, here, most, told):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill told[k], (3,), for a corner in each step: slope at sample `here`, spread, errors left. Return how many.

    Those that leave errors of more than `most` are not told.

    On either side of the step stands the line that fits the samples there best. Where the two do not meet within the
    step, they are those that fit best among the lines that meet at its nearer end: with the gap d between the free
    lines there, of variance s^2 D, the errors are d^2 / D more, and the slopes change by -cov(slope, d) d / (s^2 D).
    Velocity does not jump: without this an encoder's stairs would be corners.
    """
    n = t = tt = v = tv = vv = 0.0  # of the samples before the corner
    all_t = all_tt = all_v = all_tv = all_vv = 0.0
    for j in range(count):
        all_t += time[j]
        all_tt += time[j] * time[j]
        all_v += value[j]
        all_tv += time[j] * value[j]
        all_vv += value[j] * value[j]
    found = 0
    for j in range(count - 2):
        n += 1.0
        t += time[j]
        tt += time[j] * time[j]
        v += value[j]
        tv += time[j] * value[j]
        vv += value[j] * value[j]
        if j == 0:
            continue
        after, after_t, after_v = count - n, all_t - t, all_v - v
        power = tt - t * t / n
        after_power = all_tt - tt - after_t * after_t / after
        slope = (tv - t * v / n) / power
        after_slope = (all_tv - tv - after_t * after_v / after) / after_power
        left = vv - v * v / n - slope * slope * power
        left += all_vv - vv - after_v * after_v / after - after_slope * after_slope * after_power
        if left > most:
            continue
        spread, after_spread = 1.0 / power, 1.0 / after_power
        # The gap between the lines at time c is gap + bend c.
        bend = after_slope - slope
        gap = (after_v - after_slope * after_t) / after - (v - slope * t) / n
        if not min(-bend * time[j], -bend * time[j + 1]) <= gap <= max(-bend * time[j], -bend * time[j + 1]):
            ends = gap + bend * time[j], gap + bend * time[j + 1]
            corner = time[j] if abs(ends[0]) < abs(ends[1]) else time[j + 1]
            arm, after_arm = corner - t / n, corner - after_t / after
            apart = gap + bend * corner
            loose = 1.0 / n + arm * arm * spread + 1.0 / after + after_arm * after_arm * after_spread
            left += apart * apart / loose
            if left > most:
                continue
            slope += arm * spread * apart / loose
            after_slope -= after_arm * after_spread * apart / loose
            spread -= (arm * spread) ** 2 / loose
            after_spread -= (after_arm * after_spread) ** 2 / loose
        is_before = here <= j
        told[found, 0] = slope if is_before else after_slope
        told[found, 1] = spread if is_before else after_spread
        told[found, 2] = max(left, 0.0)
        found += 1
    return found


@njit(cache=True)
def _evidence(left, count, coefficients):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return -AICc / 2 but for a constant; the variance of the noise counts as a parameter."""
    k = coefficients + 1.0
    return -0.5 * count * np.log(left) - k - k * (k + 1.0) / (count - k - 1.0)


@njit(cache=True)
def slopes(stamp_ns, velocity, restart, width_ns, corners, usual, first, stop, out, variance, doubt):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill out[k] for samples first + k below `stop` with the derivative of the velocity, its variance and its doubt.

    Windows end at restarts and at the ends of the arrays. `corners` says whether the acceleration may jump; `usual`,
    (3,), is what `_is_usual` remembers. The variance is that of white velocity noise of the power of the errors,
    E / (n - 4), 0 where no sample is left over to tell it; the doubt is 0 where that power is the usual one.
    """
    size = velocity.size
    time, value, now, before = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    smooth, pairs, told = np.empty((RIVALS[-1] + 1, 3)), np.empty((size, 3)), np.empty(4)
    for i in range(first, stop):
        out[i - first] = variance[i - first] = doubt[i - first] = 0.0
        low, high = _window(stamp_ns, restart, width_ns, i)
        count = high - low + 1
        span = (stamp_ns[high] - stamp_ns[low]) / NS_PER_S
        if count < 2 or not span > 0.0:
            continue
        power = motion = 0.0
        for j in range(count):
            time[j] = (stamp_ns[low + j] - stamp_ns[i]) / NS_PER_S / span
            value[j] = velocity[low + j] - velocity[i]
            power += value[j] * value[j]
            motion += velocity[low + j] * velocity[low + j]
        degree = min(DEGREE, count - 1)
        _polynomials(time, value, count, degree, now, before, smooth)
        slope, spread, left = smooth[degree]
        free = count - degree - 1
        errors = left / free if free > 0 else 0.0
        told[:] = slope, errors * spread, errors, 0.0
        # Two lines have as many coefficients as the cubic; AICc is finite where three samples are left over.
        if corners and free >= DEGREE and power > 0.0:
            floor = ROUNDING * power
            # Beyond this all corners together weigh less than `NEGLIGIBLE` beside the cubic.
            most = (left + floor) * (CORNER_ODDS / NEGLIGIBLE) ** (2.0 / count)
            found = pairs[: _corners(time, value, count, i - low, most, pairs)]
            highest = min(RIVALS[-1], count - 4)  # whose AICc is finite
            if found.shape[0] > 0:
                _polynomials(time, value, count, highest, now, before, smooth)
                _average(smooth, found, count, highest, floor, False, told)
            moves = motion / count > MOVES * told[ERRORS]
            if moves and not _is_usual(usual, told[ERRORS], count):
                if told[ERRORS] > STRONG * _most_usual(usual, count):
                    if found.shape[0] == 0:
                        _polynomials(time, value, count, highest, now, before, smooth)
                    _average(smooth, found, count, highest, floor, True, told)
                # What is left may be a further corner; the half width is half of the span.
                doubt[i - first] = 4.0 * CORNER * max(0.0, told[ERRORS] - np.exp(usual[0]))
            doubt[i - first] += told[APART]
        out[i - first] = told[SLOPE] / span
        variance[i - first] = told[NOISE] / (span * span)
        doubt[i - first] /= span * span


SLOPE, NOISE, ERRORS, APART = range(4)
"""What is told of a window: the slope, its variance by noise, the errors' power, and by how much slopes differ."""


@njit(cache=True)
def _average(smooth, corners, count, highest, floor, exceptional, told):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill `told`, (4,), with means over the polynomials up to a degree and the corners, each by its evidence.

    The higher polynomials have a slope of their own in an `exceptional` window only, and the cubic's in others (see
    `RIVALS`). The last of `told` is by how much the slopes differ beyond noise: their variance about the mean, less
    `NOISE_LIKE` times their own mean variance, 0 at the least.
    """
    prior = np.log(CORNER_ODDS / count)
    cubic, best = smooth[DEGREE, 0], -np.inf
    for degree in DEGREES:
        if degree <= highest:
            best = max(best, _evidence(smooth[degree, 2] + floor, count, degree + 1))
    for k in range(corners.shape[0]):
        best = max(best, prior + _evidence(corners[k, 2] + floor, count, DEGREE + 1))
    told[:] = 0.0
    total, square = 0.0, 0.0
    for degree in DEGREES:
        if degree <= highest:
            weight = np.exp(_evidence(smooth[degree, 2] + floor, count, degree + 1) - best)
            taken = degree if exceptional else DEGREE
            total += weight
            square += _weighed(told, weight, smooth[taken], count - taken - 1, cubic)
    for k in range(corners.shape[0]):
        weight = np.exp(prior + _evidence(corners[k, 2] + floor, count, DEGREE + 1) - best)
        total += weight
        square += _weighed(told, weight, corners[k], count - DEGREE - 1, cubic)
    told /= total
    apart = square / total - (told[SLOPE] - cubic) ** 2
    told[APART] = max(0.0, apart - NOISE_LIKE * told[NOISE])


@njit(cache=True, forceinline=True)
def _weighed(told, weight, fit, freedom, cubic):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Add a fit of slope, spread and errors left to `told`; return the weighed square of its distance to the cubic."""
    errors = fit[2] / freedom
    told[SLOPE] += weight * fit[0]
    told[NOISE] += weight * errors * fit[1]
    told[ERRORS] += weight * errors
    return weight * (fit[0] - cubic) ** 2


@njit(cache=True)
def _is_usual(usual, errors, count):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return whether errors of this power, of a window of `count` samples, are as most are, and remember them.

    `usual`, (3,), are the robust mean of the logarithm, its mean distance below that, and how many there were. Corners
    make errors larger and none smaller, so the lower half says how much the power varies where there are none: by more
    than white noise's where a drive has filtered its velocity.
    """
    if not errors > 0.0:
        return True
    size = np.log(errors)
    if usual[2] == 0.0:
        usual[:] = size, _of_white_noise(count) / LOWER_HALF, 1.0
    is_usual = errors <= _most_usual(usual, count)
    usual[2] = min(usual[2] + 1.0, MEMORY * count)
    rate = 1.0 / usual[2] if is_usual else SLOWLY / usual[2]
    usual[0] += rate * min(max(size - usual[0], -ROBUST), ROBUST)
    usual[1] += rate * (min(max(usual[0] - size, 0.0), 1.0) - usual[1])
    return is_usual


@njit(cache=True, forceinline=True)
def _most_usual(usual, count):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the largest power of errors that chance explains."""
    return np.exp(usual[0] + BY_CHANCE * max(_of_white_noise(count), LOWER_HALF * usual[1]))


@njit(cache=True, forceinline=True)
def _of_white_noise(count):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the standard deviation of the logarithm of the power of errors that a cubic leaves of white noise."""
    return np.sqrt(2.0 / (count - DEGREE - 1.0))


class AccelerationFilter:
    """Give samples their acceleration, `half_width` later.

    Parameters
    ----------
    half_width_s : time on either side, s.

    Examples
    --------
    >>> k = np.arange(40)
    >>> samples = Samples(k * 1_000_000, 0.5e-3 * k**2, np.zeros(40), k == 0)
    >>> filtered = AccelerationFilter(0.005).push(samples)
    >>> len(filtered), bool(np.allclose(filtered.acceleration_m_s2, k[:35]))
    (35, True)
    """

    def __init__(self, half_width_s: float) -> None:
        self._width_ns = round(half_width_s * NS_PER_S)
        self._usual = np.zeros(3)
        self._kept: list[Samples] = []
        self._past = 0

    @property
    def waiting(self) -> int:
        """Samples that wait for those that follow."""
        return sum(len(part) for part in self._kept) - self._past

    def push(self, samples: Samples) -> Samples:
        """Take samples; return those whose acceleration is known now, in order."""
        whole = in_sequence([*self._kept, samples])
        if not len(whole):
            return whole
        # A restart ends the windows before it: nothing that follows can change them.
        ends = np.flatnonzero(whole.restart)
        piece = int(ends[-1]) if ends.size else 0
        stamps = whole.stamp_ns[piece:]
        reached = int(np.searchsorted(stamps, stamps[-1] - self._width_ns, side="right"))
        return self._take(whole, max(piece + min(reached, stamps.size - LEAST), piece, self._past))

    def drain(self) -> Samples:
        """Return what waits, fitted to what there is: no sample follows."""
        whole = in_sequence(self._kept)
        return self._take(whole, len(whole))

    def _take(self, whole: Samples, done: int) -> Samples:
        out, variance, doubt = np.empty((3, done - self._past))
        given = whole.stamp_ns, whole.velocity_m_s, whole.restart, self._width_ns, True, self._usual
        slopes(*given, self._past, done, out, variance, doubt)
        ready = replace(
            whole[self._past : done], acceleration_m_s2=out, acceleration_variance=variance, acceleration_doubt=doubt
        )
        next_ = min(done, len(whole) - 1)
        near = np.flatnonzero(np.abs(whole.stamp_ns - whole.stamp_ns[next_ : next_ + 1]) <= self._width_ns)
        # Further back than the window of the next reaches, or than its least number of samples.
        kept = max(0, min(int(near[0]) if near.size else 0, done - LEAST) - 1)
        self._kept, self._past = [whole[kept:]] if len(whole) else [], done - kept
        return ready
