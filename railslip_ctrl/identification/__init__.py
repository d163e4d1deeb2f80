"""From a log of a brake rig or a train to an adhesion law: `railslip identify`.

Imports `model` and `core`; `virtual_rig` also `simulation`. Begin with `identify`; a log goes through the modules
below it in this order, of which later ones import earlier ones.

- `identify`: the models of a log compared, the best one chosen; several logs together
- `observer`: encoder and torque sensor; the adhesion torque observed, published and by a Kalman filter
- `logs`: the quantities and units of the header; blocks of `Rows` in SI, lines that are no rows
- `cleaning`: stray time stamps, outliers, offsets and delays of columns
- `observed`: samples of adhesion over slip, and the raw rows under brake
- `log_checks`: what a log shows to be wrong, as a list of `Finding`s
- `curves`: sums by cell of slip and speed: the adhesion curve
- `models`, `fits`, `prediction`: what can be fitted; least squares over the cells; prediction-error fits
- `results`: comparison, regimes, the peak and the slip to hold, parameters over the initial speed
- `words`: the sentences of warnings, doubts and notes, from `words.toml`
- `virtual_rig`: a brake rig and brake trials of known truth, to try all this on
"""
