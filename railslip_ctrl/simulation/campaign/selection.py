"""Order statistics of data that is read again and again in place of being held: exact, in memory that does not grow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Keys = NDArray[np.uint64]

K = TypeVar("K")

_DIGIT = 13  # bits decided in a pass: five passes for 64 bits, and 64 kB of counts a rank
_SIGN = np.uint64(1 << 63)


def order_statistics(
    batches: Callable[[], Iterable[Mapping[K, Floats]]], ranks: Mapping[K, Sequence[int]]
) -> dict[K, Floats]:
    """The values of some ranks (0 the smallest) in each of several series.

    Parameters
    ----------
    batches : callable
        Gives the data from the beginning, part by part: finite values by series. It is read five times.
    ranks : mapping
        By series, ranks below its number of values.

    Notes
    -----
    Radix selection: a double's bits, taken as an integer, are in the order of the doubles. Each pass counts the next
    digit of the values that share a rank's digits so far, which decides the rank's next one.
    """
    searches = {series: _Search(wanted) for series, wanted in ranks.items()}
    for shift in range(64 - 64 % _DIGIT, -1, -_DIGIT):
        for batch in batches():
            for series, values in batch.items():
                if series in searches:
                    searches[series].count(_keys(values), shift)
        for search in searches.values():
            search.decide()
    return {series: search.values() for series, search in searches.items()}


class _Search:
    """The ranks looked for in one series, and the leading digits found of each."""

    def __init__(self, ranks: Sequence[int]) -> None:
        self._left = np.array(ranks, dtype=np.int64)
        self._found = np.zeros(len(ranks), dtype=np.uint64)
        self._begin()

    def _begin(self) -> None:
        self._heads = np.unique(self._found)
        self._counts = np.zeros((self._heads.size, 1 << _DIGIT), dtype=np.int64)

    def count(self, keys: Keys, shift: int) -> None:
        """Count a digit of the values whose leading digits are those of a rank."""
        # numpy leaves a shift by 64 bits undefined: the first digit has nothing before it
        upper = shift + _DIGIT
        heads = np.zeros_like(keys) if upper >= 64 else keys >> np.uint64(upper)
        place = np.minimum(np.searchsorted(self._heads, heads), self._heads.size - 1)
        mine = self._heads[place] == heads
        digits = (keys[mine] >> np.uint64(shift)) & np.uint64((1 << _DIGIT) - 1)
        flat = place[mine] * (1 << _DIGIT) + digits.astype(np.int64)
        self._counts += np.bincount(flat, minlength=self._counts.size).reshape(self._counts.shape)

    def decide(self) -> None:
        """The next digit of each rank."""
        for k, head in enumerate(self._found):
            upto = np.cumsum(self._counts[np.searchsorted(self._heads, head)])
            digit = int(np.searchsorted(upto, self._left[k], side="right"))
            self._left[k] -= upto[digit - 1] if digit else 0
            self._found[k] = (int(head) << _DIGIT) | digit
        self._begin()

    def values(self) -> Floats:
        """The values found."""
        bits = np.where(self._found & _SIGN, self._found ^ _SIGN, ~self._found)
        return bits.view(np.float64)


def _keys(values: Floats) -> Keys:
    bits = np.ascontiguousarray(values, dtype=np.float64).view(np.uint64)
    return np.where(bits & _SIGN, ~bits, bits | _SIGN)
