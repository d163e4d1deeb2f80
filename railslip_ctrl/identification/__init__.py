"""From a log to an adhesion model: reading, observing, adhesion-slip curves, fits, and the slip to hold."""
