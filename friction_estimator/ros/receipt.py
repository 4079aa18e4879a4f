"""Samples from values without stamps."""


class ReceiptPairing:
    """Joins a friction value without stamp to the velocity value received last, or to the next one if that is soon.

    Each velocity is used once. A friction value waits for half a period at the most: waiting longer would, after one
    lost velocity, pair every friction value with the velocity of the sample behind it.

    Attributes
    ----------
    dropped : friction values that found no velocity.

    Examples
    --------
    >>> pairing = ReceiptPairing()
    >>> pairing.velocity(1, 0.1), pairing.friction(2, 3.0)
    (None, (2, 0.1, 3.0))
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._velocity: float | None = None
        self._waiting: tuple[int, float] | None = None
        self._last_ns, self._period_ns = 0, float("inf")

    def velocity(self, now_ns: int, value: float) -> tuple[int, float, float] | None:
        """Take a velocity; return (stamp, velocity, friction) if that completes a sample."""
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            if now_ns - waiting[0] < 0.5 * self._period_ns:
                return waiting[0], value, waiting[1]
            self.dropped += 1
        self._velocity = value
        return None

    def friction(self, now_ns: int, value: float) -> tuple[int, float, float] | None:
        """Take a friction value; return (stamp, velocity, friction) if that completes a sample."""
        if self._last_ns:
            step = float(now_ns - self._last_ns)
            self._period_ns = (
                step if self._period_ns == float("inf") else self._period_ns + 0.1 * (step - self._period_ns)
            )
        self._last_ns = now_ns
        velocity, self._velocity = self._velocity, None
        if velocity is not None:
            return now_ns, velocity, value
        if self._waiting is not None:
            self.dropped += 1
        self._waiting = now_ns, value
        return None
