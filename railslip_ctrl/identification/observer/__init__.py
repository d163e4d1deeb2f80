"""Adhesion torque observed: the published observer, corrected, and a Kalman filter; on samples, with sensor noise."""

from .filters import FilterObserver, FilterState, Form
from .forms import NoiseGains, SampledForm
from .kalman import KalmanObserver, KalmanState, Vibration
from .responses import AdhesionObserver, ObserverResponses, observer_responses
from .samples import Estimates, adhesion_coefficient
from .sensors import Encoder, TorqueSensor, noise_deviation
from .tradeoff import ObserverErrors, TradeOff, observer_errors, trade_off
from .trial import BrakeCourse, Measurements, Trial, brake_trial, measured

__all__ = [
    "AdhesionObserver",
    "BrakeCourse",
    "Encoder",
    "Estimates",
    "FilterObserver",
    "FilterState",
    "Form",
    "KalmanObserver",
    "KalmanState",
    "Measurements",
    "NoiseGains",
    "ObserverErrors",
    "ObserverResponses",
    "SampledForm",
    "TorqueSensor",
    "TradeOff",
    "Trial",
    "Vibration",
    "adhesion_coefficient",
    "brake_trial",
    "measured",
    "noise_deviation",
    "observer_errors",
    "observer_responses",
    "trade_off",
]
