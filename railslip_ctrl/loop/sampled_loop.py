"""`SampledLoop`: the sampled counterpart of `DeadTimeLoop`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.core.errors import UnstableLoopError

from .sampled_margins import compute_sampled_margins, stabilizing_range
from .sampled_system import SampledSystem

if TYPE_CHECKING:
    from .margins import Margins


class SampledLoop(SampledSystem):
    """A `SampledSystem` with its margins; arguments and errors are those of that."""

    @property
    def stabilizing_gain_range(self) -> tuple[float, float] | None:
        """Interval of factors on the loop gain that stabilises: the one that holds 1 if the loop is stable, else
        the nearest to 1 in ratio; None if there is none."""
        return stabilizing_range(self)

    def margins(self) -> Margins:
        """All margins of the sampled loop, as the record of the continuous one; see `sampled_margins`.

        Raises
        ------
        UnstableLoopError
            The closed loop is not stable: says by how many poles, and which gain factors would stabilise it.
        """
        if self.is_stable():
            return compute_sampled_margins(self)
        usable = self.stabilizing_gain_range
        count = int(np.count_nonzero(np.abs(self.closed_loop_poles) >= 1))
        poles = "1 pole" if count == 1 else f"{count} poles"
        remedy = (
            "no factor on the loop gain alone stabilises it"
            if usable is None
            else f"loop-gain factors between {usable[0]:.6g} and {usable[1]:.6g} stabilise it"
        )
        raise UnstableLoopError(
            f"margins are not defined: the sampled loop (period {self.period:g} s) is unstable with {poles} "
            f"on or outside the unit circle; {remedy}",
            unstable_poles=count,
            stabilizing_gain_range=usable,
        )
