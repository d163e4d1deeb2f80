"""Identify an adhesion law from a log of a brake rig or a train: `railslip identify`.

This package imports `model` and `core`; `virtual_rig` also imports `simulation`. Begin with `identify`. A log passes
through the other modules in this order. Later modules import earlier ones.

- `identify`: compares the models of a log and chooses one; handles several logs
- `observer`: encoder and torque sensor; observers of the adhesion torque, the published one and a Kalman filter
- `logs`: reads a log into blocks of `Rows` in SI, and notes lines that cannot be read
- `cleaning`: removes stray time stamps and outliers, corrects offsets and delays of columns
- `observed`: computes samples of adhesion over slip, and records the raw rows under brake
- `log_checks`: checks the plausibility of a log; each fault is a `Finding`
- `curves`: reduces the samples to the adhesion curve, by cells of slip and speed
- `models`, `fits`, `prediction`: the models, least squares over the cells, prediction-error fits
- `results`: comparison, regimes, peak and reference slip, parameters over the initial speed
- `messages`: texts of warnings and notes, from `messages.toml`
- `virtual_rig`: a simulated brake rig whose true adhesion law is known
"""
