"""Feedback loops with exact dead time: root count, margins, certificates, time responses.

The package is for any SISO loop, not only for slip control, and imports only `core`. Begin with `deadtime`:
`DeadTimeLoop(system, dead_time)` and its `margins()`. `deadtime` uses `rational` (transfer functions, their exact
polynomials and realisations), `crossings` (frequencies with |L| = 1 or L < 0), `stability` (root count, rightmost
poles), `margins`, `certificate` (enclosures by ball arithmetic) and `responses` (time responses). `batch` computes the
margins of many dead-time loops at once. The margins of two other kinds of loop follow from bounds on ln L (`bounded`):
`sampled` is for discrete controllers, `quasi` for controllers with internal delays, `quasi_batch` for many of the
latter.
"""

from .certificate import Certificate, CertificateError
from .deadtime import DeadTimeLoop
from .margins import Margins
from .rational import Rational
from .stability import SpectrumError

__all__ = ["Certificate", "CertificateError", "DeadTimeLoop", "Margins", "Rational", "SpectrumError"]
