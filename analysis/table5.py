"""Can the sixteen numbers of the paper's main result be reproduced, and with which assumptions about the units?

The main result is [Park2008] Table 5, four controllers from 100 to 5 km/h. The script prints the means over many noise
seeds beside the published numbers. Each assumption about units, see `railslip_ctrl.paper.reading`, is printed in the
paper, inferred from it, or fitted.

    python analysis/table5.py [SEEDS]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from railslip_ctrl.paper.tables import DEFAULT_SEEDS, Table5, published_facts, table3, table5
from railslip_ctrl.report.reproduction import reproduction_text

LARGEST_RMS = 2.2  # %, largest rms of the sixteen deviations


def run(seeds: int = DEFAULT_SEEDS) -> Table5:
    """Return the comparison; AssertionError if a number is out of tolerance or the rms is above `LARGEST_RMS`."""
    result = table5(seeds)
    outside = [row.item for row in result.rows if not row.within]
    assert not outside, f"out of tolerance: {', '.join(outside)}"
    assert result.rms_deviation_percent <= LARGEST_RMS, f"rms deviation {result.rms_deviation_percent:.2f} %"
    return result


def main(argv: Sequence[str]) -> None:
    """Print the comparison, the assumptions about units, Table 3 and the facts of the runs."""
    seeds = int(argv[0]) if argv else DEFAULT_SEEDS
    print(reproduction_text(run(seeds), table3(), published_facts()), end="")


if __name__ == "__main__":
    main(sys.argv[1:])
