"""The least step of a quantised channel, learned sample by sample: the least difference that keeps coming."""

from friction_estimator.compiled import njit

TIES = 16
"""A least difference that has come that often is the step of a lattice."""

LESS, ALIKE = 0.75, 1.25
"""Share of the least difference below which another one is less, and below which it is the same, both as rounding and
noise leave them."""


@njit(cache=True)
def learn_step(state, at, difference):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Learn the least difference, state[at], and how often it came, state[at + 1], from another one above zero."""
    if state[at + 1] == 0.0 or difference < LESS * state[at]:
        state[at], state[at + 1] = difference, 1.0
    elif difference < ALIKE * state[at]:
        state[at + 1] += 1.0
