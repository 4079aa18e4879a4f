"""Compiled, causal state machines behind the dynamic effects and their regressors."""

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.effects.reference import substeps

RING = 512
"""Length of a delay line, in samples: 100 ms at 5 kHz."""


@njit(cache=True)
def hysteron(step, previous, velocity, length, state, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Bristle dz = (v - |v| z) / length dt, exact in distance; out = z - sgn(v). state = [z, direction].

    After a reversal from saturation z - sgn(v) = -2 sgn(v) exp(-d_rev / length).
    """
    for k in range(velocity.size):
        v0, v1, dt = previous[k], velocity[k], step[k]
        if v0 * v1 < 0.0:
            part = v0 / (v0 - v1)
            moved = 0.5 * abs(v0) * dt * part
            old = 1.0 if v0 > 0.0 else -1.0
            state[0] = old + (state[0] - old) * np.exp(-moved / length)
            moved = 0.5 * abs(v1) * dt * (1.0 - part)
        else:
            moved = 0.5 * abs(v0 + v1) * dt
        if v1 != 0.0:
            way = 1.0 if v1 > 0.0 else -1.0
        elif v0 != 0.0:
            way = 1.0 if v0 > 0.0 else -1.0
        else:
            way = state[1]
        if state[1] == 0.0:
            state[0] = way
        state[1] = way
        state[0] = way + (state[0] - way) * np.exp(-moved / length)
        out[k] = state[0] - way


@njit(cache=True)
def slip_chain(step, previous, velocity, length, state, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Elastic-slip element z = clip(z + dx / (length / 2), -1, 1); out = z - sgn(v). state = [z, direction]."""
    for k in range(velocity.size):
        v0, v1, dt = previous[k], velocity[k], step[k]
        if state[1] == 0.0 and v1 != 0.0:
            state[0] = 1.0 if v1 > 0.0 else -1.0
        if v1 != 0.0:
            state[1] = 1.0 if v1 > 0.0 else -1.0
        moved = 0.5 * (v0 + v1) * dt
        if v0 * v1 < 0.0:  # forth and back within one sample period
            part = v0 / (v0 - v1)
            state[0] = min(1.0, max(-1.0, state[0] + v0 * dt * part / length))
            moved = 0.5 * v1 * dt * (1.0 - part)
        state[0] = min(1.0, max(-1.0, state[0] + 2.0 * moved / length))
        out[k] = state[0] - state[1]


@njit(cache=True)
def play(step, previous, velocity, gap, state, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Gap between drive and seal: out = 1 where it is open. state = [place in the gap 0..gap, moved yet]."""
    for k in range(velocity.size):
        v0, v1, dt = previous[k], velocity[k], step[k]
        if state[1] == 0.0 and v1 != 0.0:
            state[0] = gap if v1 > 0.0 else 0.0
            state[1] = 1.0
        if v0 * v1 < 0.0:
            part = v0 / (v0 - v1)
            state[0] = min(gap, max(0.0, state[0] + 0.5 * v0 * dt * part))
            state[0] = min(gap, max(0.0, state[0] + 0.5 * v1 * dt * (1.0 - part)))
        else:
            state[0] = min(gap, max(0.0, state[0] + 0.5 * (v0 + v1) * dt))
        open_ = (v1 > 0.0 and state[0] < gap) or (v1 < 0.0 and state[0] > 0.0)
        out[k] = 1.0 if open_ else 0.0


@njit(cache=True)
def rest_spike(step, previous, velocity, length, rest_speed, exponent, state, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """out = sgn(v) dwell^exponent exp(-d_rev / length); dwell: time at |v| < rest_speed before the reversal, s.

    state = [dwell running, dwell of the last reversal, d_rev, direction].
    """
    height = state[1] ** exponent
    for k in range(velocity.size):
        v0, v1, dt = previous[k], velocity[k], step[k]
        reversed_ = v1 != 0.0 and state[3] != 0.0 and (v1 > 0.0) != (state[3] > 0.0)
        slope = abs(v1 - v0)
        if reversed_ and v0 != v1 and v0 * v1 <= 0.0:
            part = v0 / (v0 - v1)  # at rest in the last sample: the step belongs to the way back
            state[0] += min(part * dt, rest_speed / slope * dt)
            moved = 0.5 * abs(v1) * dt * (1.0 - part)
        else:
            moved = 0.5 * abs(v0 + v1) * dt
            if min(abs(v0), abs(v1)) < rest_speed:
                if max(abs(v0), abs(v1)) <= rest_speed:
                    state[0] += dt
                else:
                    state[0] += dt * (rest_speed - min(abs(v0), abs(v1))) / slope
        if reversed_:
            state[1] = state[0]
            height = state[1] ** exponent
            state[0] = 0.0
            state[2] = moved
        else:
            state[2] += moved
        if v1 != 0.0:
            state[3] = 1.0 if v1 > 0.0 else -1.0
        if abs(v1) > rest_speed:
            state[0] = 0.0
        out[k] = 0.0
        if state[1] > 0.0:
            out[k] = state[3] * height * np.exp(-state[2] / length)


@njit(cache=True)
def force_lag(step, previous, velocity, within, tau, twice, bend, state, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """First-order lag of F(v(t), p), or two equal ones in series: out = LP(F) - F.

    F is linear in each part of a step, for which the lag's answer is exact; `within` is F at the end of each part, see
    `Reference.within`. state = [y, F at the last step, started, second y].
    """
    dt, decay = 0.0, 1.0  # kept: samples are evenly spaced, nearly everywhere
    end = 0
    for k in range(velocity.size):
        count = substeps(previous[k], velocity[k], bend)
        begin, end = end, end + count
        now = within[end - 1]
        if step[k] <= 0.0 or state[2] == 0.0:
            state[0] = now
            state[1] = now
            state[2] = 1.0
            state[3] = now
            out[k] = 0.0
            continue
        if step[k] / count != dt:
            dt = step[k] / count
            decay = np.exp(-dt / tau)
        for i in range(begin, end):
            f = within[i]
            slope = (f - state[1]) / dt
            away = state[0] - state[1] + slope * tau
            state[3] = f - 2.0 * slope * tau + (state[3] - state[1] + 2.0 * slope * tau + away * dt / tau) * decay
            state[0] = f - slope * tau + away * decay
            state[1] = f
        out[k] = (state[3] if twice else state[0]) - now


DELAY_LINE = 1 + 2 * RING
"""Length of the state of `earlier`."""


@njit(cache=True, forceinline=True)
def earlier(step, velocity, delay, state):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Take in a velocity and return that of `delay` ago, linear between samples.

    state = [count, ring of steps, ring of velocities]. Before the delay line is filled the oldest velocity holds.
    """
    if step <= 0.0:
        state[0] = 0.0
    count = int(state[0])
    place = count % RING
    state[1 + place] = step
    state[1 + RING + place] = velocity
    state[0] = float(count + 1)
    left = delay
    back = 0
    while back < RING - 1:
        row = (count - back) % RING
        dt = state[1 + row]
        if count - back <= 0 or dt <= 0.0:
            return state[1 + RING + row]
        if left <= dt:
            v0 = state[1 + RING + (row - 1) % RING]
            v1 = state[1 + RING + row]
            return v1 + (v0 - v1) * left / dt
        left -= dt
        back += 1
    return velocity


@njit(cache=True)
def delayed(step, velocity, delay, state, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """v(t - delay), linear between samples; state: see `earlier`."""
    for k in range(velocity.size):
        out[k] = earlier(step[k], velocity[k], delay, state)


LEAST_FILM = 1e-2
"""Share of the smooth sign's speed below which a film's speed is taken as that."""


@njit(cache=True)
def film_speed(step, previous, velocity, tau, sign_velocity, bend, state, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Speed u that has built the film, the first-order lag of |v|, never zero. state = [u, started]."""
    dt, decay = 0.0, 1.0  # kept: samples are evenly spaced, nearly everywhere
    for k in range(velocity.size):
        if step[k] <= 0.0 or state[1] == 0.0:
            state[0] = abs(velocity[k])
            state[1] = 1.0
            out[k] = max(state[0], LEAST_FILM * sign_velocity)
            continue
        count = substeps(previous[k], velocity[k], bend)
        if step[k] / count != dt:
            dt = step[k] / count
            decay = np.exp(-dt / tau)
        last = abs(previous[k])
        for i in range(1, count + 1):
            s = abs(previous[k] + (velocity[k] - previous[k]) * i / count)
            slope = (s - last) / dt
            state[0] = s - slope * tau + (state[0] - last + slope * tau) * decay
            last = s
        out[k] = max(state[0], LEAST_FILM * sign_velocity)


@njit(cache=True)
def film_way(step, previous, velocity, tau, film_speed, state, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Direction in which the film was built, -1 to 1: the lag of v over u, the lag of |v|. state = [w, started]."""
    dt, decay = 0.0, 1.0  # kept: samples are evenly spaced, nearly everywhere
    for k in range(velocity.size):
        if step[k] <= 0.0 or state[1] == 0.0:
            state[0] = velocity[k]
            state[1] = 1.0
        else:
            if step[k] != dt:
                dt = step[k]
                decay = np.exp(-dt / tau)
            slope = (velocity[k] - previous[k]) / dt
            state[0] = velocity[k] - slope * tau + (state[0] - previous[k] + slope * tau) * decay
        out[k] = min(max(state[0] / film_speed[k], -1.0), 1.0)


@njit(cache=True)
def on_film(velocity, film_speed, sign_velocity, theory_sign, rest, there, here, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """S(v) (B(u)/S(u) - B(|v|)/S(|v|)) + v (H(u)/u - H(|v|)/|v|), u the speed that has built the film.

    B and H are the boundary and the shear part of the theory, S its smooth sign: the film's thickness, which sets both,
    is that of u. Of what the force has beside them, a share `rest` follows it as B does, behind a smooth sign of its
    own. `there` and `here` are force, B and H at u and at |v|.
    """
    for k in range(velocity.size):
        speed = max(abs(velocity[k]), LEAST_FILM * sign_velocity)
        b, h, b0, h0 = there[1][k], there[2][k], here[1][k], here[2][k]
        dry = b / np.tanh(film_speed[k] / theory_sign) - b0 / np.tanh(speed / theory_sign)
        wet = h / film_speed[k] - h0 / speed
        out[k] = np.tanh(velocity[k] / theory_sign) * dry + velocity[k] * wet
        if rest != 0.0:
            beside = (there[0][k] - b - h) / np.tanh(film_speed[k] / sign_velocity)
            beside -= (here[0][k] - b0 - h0) / np.tanh(speed / sign_velocity)
            out[k] += rest * np.tanh(velocity[k] / sign_velocity) * beside


@njit(cache=True)
def maxwell(step, previous, velocity, tau, state, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Maxwell element z' = v - z / tau, exact for velocity linear between samples; out = z, m. state = [z]."""
    for k in range(velocity.size):
        dt = step[k]
        if dt > 0.0:
            decay = np.exp(-dt / tau)
            slope = (velocity[k] - previous[k]) / dt
            steady0 = tau * (previous[k] - slope * tau)
            steady1 = tau * (velocity[k] - slope * tau)
            state[0] = steady1 + (state[0] - steady0) * decay
        out[k] = state[0]


@njit(cache=True)
def fir(step, values, taps, state, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Filter the columns of `values` with [1, taps]; a step of 0 fills the delay line. state = [head, ring of rows]."""
    order, width = taps.size, values.shape[1]
    head = int(state[0])
    for k in range(values.shape[0]):
        if step[k] <= 0.0:
            for i in range(order):
                for c in range(width):
                    state[1 + i * width + c] = values[k, c]
        for c in range(width):
            total = values[k, c]
            for i in range(order):
                row = head - i if i <= head else head - i + order
                total += taps[i] * state[1 + row * width + c]
            out[k, c] = total
        head = head + 1 if head + 1 < order else 0
        for c in range(width):
            state[1 + head * width + c] = values[k, c]
    state[0] = float(head)


@njit(cache=True)
def waves(position, direction, wavelength, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """cos and sin of 2 pi x / wavelength, in columns 0, 1 where the shaft moves forward, else in 2, 3."""
    for k in range(position.size):
        turn = position[k] / wavelength
        angle = 2.0 * np.pi * (turn - np.floor(turn))
        place = 0 if direction[k] > 0.0 else 2
        out[k, 0] = out[k, 1] = out[k, 2] = out[k, 3] = 0.0
        out[k, place] = np.cos(angle)
        out[k, place + 1] = np.sin(angle)


@njit(cache=True)
def wave_comb(position, direction, first, step, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """`waves` of the wave numbers first, first + step, ... (waves per metre), four columns each.

    Each follows from the one before it by a rotation, which costs a tenth of a cosine and a sine.
    """
    for k in range(position.size):
        turn, more = position[k] * first, position[k] * step
        angle, by = 2.0 * np.pi * (turn - np.floor(turn)), 2.0 * np.pi * (more - np.floor(more))
        cos, sin, cos_by, sin_by = np.cos(angle), np.sin(angle), np.cos(by), np.sin(by)
        ahead = direction[k] > 0.0
        for j in range(0, out.shape[1], 4):
            out[k, j] = cos if ahead else 0.0
            out[k, j + 1] = sin if ahead else 0.0
            out[k, j + 2] = 0.0 if ahead else cos
            out[k, j + 3] = 0.0 if ahead else sin
            cos, sin = cos * cos_by - sin * sin_by, sin * cos_by + cos * sin_by
