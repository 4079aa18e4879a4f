"""Messages of some topics in batches, and what their file says of those behind them."""

from collections.abc import Iterator
from dataclasses import dataclass

from friction_estimator.bag.messages import Messages
from friction_estimator.core.sample import Ints

Batch = tuple[str, Ints, Messages]
"""Topic, time of recording (ns, one a message), payloads of equal or of any lengths."""

Timed = tuple[Batch, int]
"""A batch, and a time of recording (ns) before which nothing comes in the batches behind it, as the file says."""

NOTHING_BEHIND = 2**63 - 1
"""The time that goes with the last batch."""

ANYTHING_BEHIND = -(2**63)
"""The time that goes with a batch where nobody knows what the batches behind it hold."""


class DamagedError(ValueError):
    """The file contradicts itself; says where."""


@dataclass(frozen=True)
class Indexed:
    """The messages of a file by its index: the first time of recording that it declares, ns, and the batches."""

    first_ns: int
    batches: Iterator[Timed]
