"""Identify an adhesion law from a log of a brake rig or a train: `railslip identify`.

This package imports `model` and `core`; `virtual_rig` also imports `simulation`. Begin with `identify`. The other
modules are in the order in which a log passes through them.

- `identify`: fits models to one or several logs, compares the models and chooses one
- `observer`: models of encoder and torque sensor; the published observer of the adhesion torque, and a Kalman filter
- `logs`: reads a log into blocks of `Rows` in SI, and reports lines that cannot be read
- `cleaning`: removes stray time stamps and outliers, corrects offsets and delays of columns
- `observed`: computes samples of adhesion over slip, and records the unfiltered rows under brake
- `log_checks`: checks the plausibility of a log and reports each fault as a `Finding`
- `curves`: reduces the samples to the adhesion curve, by cells of slip and speed
- `models`, `fits`, `prediction`: the models, least-squares fits to the cells, prediction-error fits
- `results`: compares fits; computes regimes, peak and reference slip, and parameters over the initial speed
- `messages`: texts of warnings and notes, from `messages.toml`
- `virtual_rig`: a simulated brake rig whose true adhesion law is known
"""
