"""The loop with its exact dead time: root count, margins, certificates. Knows nothing of slip.

Begin with `deadtime`: `DeadTimeLoop(system, dead_time)` and its `margins()`. Imports nothing of the project but `core`.
From the ground up: `rational` (transfer functions, their exact polynomials and realisations), `crossings` (where
|L| = 1 or L < 0, and what is monotone between), `stability` (root count, rightmost poles), `margins`, `certificate`
(enclosures by balls), `responses` (in time), `deadtime`. Beside it: `batch` (margins of many loops at once), and on
`bounded` (margins by bounds on ln L) `sampled` (discrete controllers) and `quasi` (controllers with delays).
"""

from .certificate import Certificate, CertificateError
from .deadtime import DeadTimeLoop
from .margins import Margins
from .rational import Rational
from .stability import SpectrumError

__all__ = ["Certificate", "CertificateError", "DeadTimeLoop", "Margins", "Rational", "SpectrumError"]
