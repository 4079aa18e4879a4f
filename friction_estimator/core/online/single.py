"""Compiled: what comes before the law where samples come singly, in one call (`receive`): from events to an admitted
sample, and from that to what `kernels.run` takes.

The kernels are those of replay; they are handed their arrays by addresses that were taken once (`core.addresses`).
"""

from typing import Any

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.addresses import (
    Addresses,
    Layout,
    bools,
    bytes_of,
    float_blocks,
    float_rows,
    floats,
    int32_rows,
    int_rows,
    ints,
    table_at,
)
from friction_estimator.core.intake.encoder import unwrap
from friction_estimator.core.intake.pairing import AGE, POSITION, PRESSURE, TEMPERATURE, USED, admit, pair
from friction_estimator.core.intake.position import carry
from friction_estimator.core.model.basis import wavelet_rows
from friction_estimator.core.model.theory_seal import SealCurve, seal_loop
from friction_estimator.core.model.theory_stribeck import StribeckCurve, stribeck_loop

VELOCITY, FRICTION, PREDICTED, DEVIATION = range(4)
"""Places in the outcome of a sample; the last two are in force units."""

NO_CURVE, SEAL, STRIBECK = range(3)

REFUSED = -1
"""What `receive` says of a single sample that was not admitted."""

Arrays = tuple[Any, ...]

EVENTS = Layout(
    stream=np.int64,
    stamp=np.int64,
    value=np.float64,
    times_ns=np.int64,
    gap_factor=np.float64,
    queue_stamp=np.int64,
    queue_value=np.float64,
    queue=np.int64,
    held_stamp=np.int64,
    held_value=np.float64,
    held_count=np.int64,
    held_now=np.float64,
    held_at=np.int64,
    dropped=np.int64,
    choice=np.int64,
    velocity_gain=np.float64,
    track_clock=np.int64,
    tracked=np.float64,
    joined_stamp=np.int64,
    velocity=np.float64,
    friction=np.float64,
    held=np.float64,
    clock=np.int64,
    periods=np.float64,
    counts=np.int64,
    status=np.int8,
    restart=np.bool_,
    position=np.float64,
    shift=np.float64,
    turns=np.float64,
    carried=np.float64,
)
"""What `receive` takes: room for events, and what `pair`, `admit`, `unwrap` and `carry` take, scalars in arrays."""

_E = EVENTS.at


def events_table(room: Arrays, pairing: Arrays, admission: Arrays, unwrapping: Arrays, carrying: Arrays) -> Addresses:
    """Return what `receive` takes.

    Parameters
    ----------
    room : for stream, stamp and value of events.
    pairing : what `pair` takes behind them. admission, unwrapping, carrying : what `admit`, `unwrap` and `carry`
        take, for one sample.
    """
    slop_ns, *paired = pairing
    *_, gap_factor, jump_ns, clock, periods, counts, status, restart = admission
    settings = np.array([slop_ns, jump_ns], np.int64), np.array([gap_factor], np.float64)
    admitted = clock, periods, counts, status, restart
    return EVENTS.addresses(
        **dict(zip(_E._fields, [*room, *settings, *paired, *admitted, *unwrapping[-3:], carrying[-1]], strict=True))
    )


SAMPLE = Layout(
    paired_velocity=np.float64,
    paired_friction=np.float64,
    held=np.float64,
    outcome=np.float64,
    unit=np.float64,
    low=np.float64,
    high=np.float64,
    bend=np.float64,
    scale=np.float64,
    amplitude=np.float64,
    first=np.int64,
    kind=np.int64,
    table=np.float64,
    first_cell=np.int64,
    index=np.int32,
    value=np.float64,
    cell=np.int64,
    curve=np.int64,
    parameters=np.float64,
    counts=np.int64,
    settings=np.float64,
    conditions=np.float64,
    theory=np.float64,
    target=np.float64,
    beyond=np.float64,
    learn=np.bool_,
)
"""What `receive` makes a sample of: that as it was paired, what `wavelet_rows` takes, the theoretical curve, settings
(sign of the friction, force unit, scale of the theory, ambient pressure, pressure and temperature where there is none),
and what it fills for `kernels.run`."""

_P = SAMPLE.at


def sample_table(rows: Arrays, curve: SealCurve | StribeckCurve | None, settings: Arrays, **beside: Any) -> Addresses:
    """Return what `receive` makes a sample in; see `SAMPLE`.

    Parameters
    ----------
    rows : what `wavelet_rows` takes for room of one sample. curve : the theoretical one.
    beside : the rest.
    """
    names = _P._fields[_P.unit : _P.curve]
    basis = {name: np.atleast_1d(item) for name, item in zip(names, rows[1:], strict=True)}
    basis |= {name: basis[name].astype(np.float64) for name in ("unit", "low", "high", "bend")}
    which = SEAL if isinstance(curve, SealCurve) else NO_CURVE if curve is None else STRIBECK
    nothing = np.zeros(1)
    *_, parameters, counts, _ = (
        (nothing, np.zeros(1, np.int64), nothing) if curve is None else curve.arguments(*[nothing] * 4)
    )
    return SAMPLE.addresses(
        curve=np.array([which]),
        parameters=parameters,
        counts=counts,
        settings=np.array(settings),
        conditions=np.zeros(2),
        **basis,
        **beside,
    )


@njit(cache=True, forceinline=True)
def _prepare(table, learns):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill what `kernels.run` takes for one sample, and its velocity and friction in the outcome."""
    outcome, settings, theory = floats(table, _P.outcome), floats(table, _P.settings), floats(table, _P.theory)
    sign, force_unit, theory_scale = settings[0], settings[1], settings[2]
    low, high = floats(table, _P.low)[0], floats(table, _P.high)[0]
    velocity = floats(table, _P.paired_velocity)[0]
    own = outcome[:1]
    own[0] = velocity
    outcome[FRICTION] = sign * floats(table, _P.paired_friction)[0]
    wavelet_rows(
        own,
        floats(table, _P.unit)[0],
        low,
        high,
        floats(table, _P.bend)[0],
        floats(table, _P.scale),
        floats(table, _P.amplitude),
        ints(table, _P.first),
        ints(table, _P.kind),
        float_blocks(table, _P.table),
        ints(table, _P.first_cell)[0],
        int32_rows(table, _P.index),
        float_rows(table, _P.value),
        ints(table, _P.cell),
    )
    curve, parameters, counts = ints(table, _P.curve)[0], floats(table, _P.parameters), ints(table, _P.counts)
    if curve != NO_CURVE:
        held, conditions = float_rows(table, _P.held), floats(table, _P.conditions)
        pressure, temperature = held[0, 0], held[0, TEMPERATURE - PRESSURE]
        conditions[0] = pressure - settings[3] if np.isfinite(pressure) else settings[4]
        conditions[1] = temperature if np.isfinite(temperature) else settings[5]
        if curve == SEAL:
            seal_loop(own, conditions[:1], conditions[1:], parameters, counts, theory)
        else:
            stribeck_loop(own, parameters, counts, theory)
        theory[0] = theory_scale * theory[0] / force_unit
    floats(table, _P.target)[0] = outcome[FRICTION] / force_unit
    outside = max(low - velocity, velocity - high)
    floats(table, _P.beyond)[0] = max(outside, 0.0) / max(abs(low), abs(high))
    bools(table, _P.learn)[0] = learns


@njit(cache=True)
def receive(events, sample, count, alone, learns):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Pair the first `count` events; return the number of samples that they complete.

    Where it is one, and to be taken `alone`, it is admitted too, its position unwrapped, and what `kernels.run` takes
    filled; `REFUSED` where it was not admitted. `events` and `sample` are addresses of the tables.
    """
    table = table_at(events, len(_E))
    stream, stamp, value = ints(table, _E.stream), ints(table, _E.stamp), floats(table, _E.value)
    slop_ns, jump_ns = ints(table, _E.times_ns)[0], ints(table, _E.times_ns)[1]
    joined_stamp, held = ints(table, _E.joined_stamp), float_rows(table, _E.held)
    velocity, friction = floats(table, _E.velocity), floats(table, _E.friction)
    joined = pair(
        stream[:count],
        stamp[:count],
        value[:count],
        slop_ns,
        int_rows(table, _E.queue_stamp),
        float_rows(table, _E.queue_value),
        ints(table, _E.queue),
        int_rows(table, _E.held_stamp),
        float_rows(table, _E.held_value),
        ints(table, _E.held_count),
        floats(table, _E.held_now),
        ints(table, _E.held_at),
        ints(table, _E.dropped),
        ints(table, _E.choice),
        floats(table, _E.velocity_gain),
        ints(table, _E.track_clock),
        floats(table, _E.tracked),
        joined_stamp,
        velocity,
        friction,
        held,
    )
    if joined == 1 and alone:
        own, speed, restart = joined_stamp[:1], velocity[:1], bools(table, _E.restart)
        status = bytes_of(table, _E.status)
        admit(
            own,
            speed,
            friction[:1],
            floats(table, _E.gap_factor)[0],
            jump_ns,
            ints(table, _E.clock),
            floats(table, _E.periods),
            ints(table, _E.counts),
            status,
            restart,
        )
        position = floats(table, _E.position)
        position[0] = held[0, POSITION - PRESSURE]
        if status[0] == USED and np.isfinite(position[0]):
            # Nothing here depends on it, but turns and way are counted from sample to sample.
            unwrap(own, speed, restart, position, floats(table, _E.shift), floats(table, _E.turns))
            carry(own, speed, restart, position, held[0, AGE : AGE + 1], floats(table, _E.carried))
        if status[0] != USED:
            return REFUSED
        _prepare(table_at(sample, len(_P)), learns)
    return joined
