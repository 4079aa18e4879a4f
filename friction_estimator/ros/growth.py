"""By how much counters grew between two looks."""


class Growth:
    """Remembers what counters were.

    Examples
    --------
    >>> growth = Growth()
    >>> growth.of("messages", 5), growth.of("messages", 7), growth.of("messages", 3)
    (5, 2, 3)
    """

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def of(self, key: str, count: int) -> int:
        """Return the growth since the last look; a counter that is less than it was began anew."""
        before = self._counts.get(key, 0)
        self._counts[key] = count
        return count - before if count >= before else count
