"""How many examples a property test draws."""

from __future__ import annotations

import os

_EXPLORING = 5


def examples(count: int) -> int:
    """`count` in the suite, whose examples are the same on every run; more where HYPOTHESIS_PROFILE=explore draws new
    ones."""
    return count * (_EXPLORING if os.environ.get("HYPOTHESIS_PROFILE") == "explore" else 1)
