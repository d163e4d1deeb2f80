"""The exact dead-time loop: response, root count, poles, crossovers, margins. Knows nothing of slip or rails."""

from .deadtime import DeadTimeLoop
from .margins import Margins
from .rational import Rational
from .spectrum import SpectrumError

__all__ = ["DeadTimeLoop", "Margins", "Rational", "SpectrumError"]
