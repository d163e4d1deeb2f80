"""The loop with its exact dead time: root count, margins, certificates. Knows nothing of slip."""

from .certificate import Certificate, CertificateError
from .deadtime import DeadTimeLoop
from .margins import Margins
from .rational import Rational
from .stability import SpectrumError

__all__ = ["Certificate", "CertificateError", "DeadTimeLoop", "Margins", "Rational", "SpectrumError"]
