"""The loop with its exact dead time: root count, margins, certificates. Knows nothing of slip.

Imports `core`. Begin with `deadtime`: `DeadTimeLoop(system, dead_time)` and its `margins()`. It stands on `rational`
(transfer functions, their exact polynomials and realisations), `crossings` (where |L| = 1 or L < 0), `stability`
(root count, rightmost poles), `margins`, `certificate` (enclosures by balls) and `responses` (in time). `batch` has
margins of many such loops at once. Other loops: `sampled` (discrete controllers) and `quasi` (controllers with delays
of their own; `quasi_batch`, many at once) compute theirs from bounds on ln L, by `bounded`.
"""

from .certificate import Certificate, CertificateError
from .deadtime import DeadTimeLoop
from .margins import Margins
from .rational import Rational
from .stability import SpectrumError

__all__ = ["Certificate", "CertificateError", "DeadTimeLoop", "Margins", "Rational", "SpectrumError"]
