"""Counter-based random numbers, which are the same on a CPU and on a GPU: Philox4x32-10 ([Salmon2011]), Box-Muller."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy


class Counted(NamedTuple):
    """Seed of counter-based random numbers: two keys, integers of 32 bits."""

    key0: int
    key1: int


def normal(key0: Any, key1: Any, counter: Any, stream: Any) -> Any:
    """Return the standard normal number with the index `counter` in the random sequence `stream`.

    The keys, integers of 32 bits, are the seed. Integer arrays as counter and stream give an array of numbers.
    """
    c0, c1, c2, c3, k0, k1 = counter, stream, 0, 0, int(key0), int(key1)
    for _ in range(10):
        low, high = 0xD2511F53 * c0, 0xCD9E8D57 * c2
        c0, c1 = ((high >> 32) & 0xFFFFFFFF) ^ c1 ^ k0, high & 0xFFFFFFFF
        c2, c3 = ((low >> 32) & 0xFFFFFFFF) ^ c3 ^ k1, low & 0xFFFFFFFF
        k0, k1 = (k0 + 0x9E3779B9) & 0xFFFFFFFF, (k1 + 0xBB67AE85) & 0xFFFFFFFF
    first = (c0 * 4294967296.0 + c1 + 0.5) / 18446744073709551616.0
    second = (c2 * 4294967296.0 + c3) / 18446744073709551616.0
    return numpy.sqrt(-2.0 * numpy.log(first)) * numpy.cos(2.0 * numpy.pi * second)
