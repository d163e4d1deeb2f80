"""The exact dead-time loop: response, root count, poles, crossovers, margins. Knows nothing of slip or rails."""

from .certificate import Certificate, CertificateError
from .deadtime import DeadTimeLoop
from .margins import Margins
from .rational import Rational
from .stability import SpectrumError

__all__ = ["Certificate", "CertificateError", "DeadTimeLoop", "Margins", "Rational", "SpectrumError"]
