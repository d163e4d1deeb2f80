"""SISO feedback loops with exact dead time: stability, margins, certificates and time responses.

Begin with `DeadTimeLoop(system, dead_time)` and its method `margins()`. Loops with a discrete controller are in
`sampled`; loops whose controller contains delays are in `quasi`.
"""

from .certificate import Certificate, CertificateError
from .deadtime import DeadTimeLoop
from .margins import Margins
from .rational import Rational
from .stability import SpectrumError

__all__ = ["Certificate", "CertificateError", "DeadTimeLoop", "Margins", "Rational", "SpectrumError"]
