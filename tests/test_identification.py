"""From rows to samples to models: what is observed, fits against known parameters and closed forms, intervals."""

import functools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rig_logs import identified, rig_rows
from scipy.signal import lfilter
from scipy.stats import binomtest
from scipy.stats import t as student

from railslip_ctrl import PARK2008, InputError, Rail, adhesion
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification import fits, log_checks, models, results
from railslip_ctrl.identification.curves import Accumulator, peak_slip
from railslip_ctrl.identification.fits import CONFIDENCE, NORMAL_QUANTILE, Fit, Parameter, clustered_covariance
from railslip_ctrl.identification.logs import Rows
from railslip_ctrl.identification.models import Setting, check_options
from railslip_ctrl.identification.observed import AdhesionStream, Observed, Observer, Recorder
from railslip_ctrl.identification.results import compare, over_initial_speed, peak_of_fit, peak_of_law
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip, law_class, load_law, published_law
from railslip_ctrl.model.adhesion.bristle import published_coefficients
from railslip_ctrl.model.adhesion.curve import curve_force
from railslip_ctrl.model.numeric import adhesion_coefficient
from railslip_ctrl.report.identification import law_toml, polynomials_toml

LOAD = PARK2008.wheel_load
V100 = 100.0 * KMH
TAU = 0.05

LAWS: dict[str, AdhesionLaw] = {
    **{name: published_law(name, Rail.DRY) for name in ("beam", "bristle", "curve")},
    **{"bristle_rest": published_law("bristle", Rail.DRY), "polach": published_law("polach", Rail.WET)},
    # a road tyre's curve of a rail's height, and a LuGre model of some 0.3 falling to 0.17
    "burckhardt": law_class("burckhardt").model_validate({"c1": 0.31, "c2": 24.0, "c3": 0.11}),
    "lugre": law_class("lugre").model_validate({"alpha": 2.2e4, "alpha2": 21.0, "Fs": 1.13e4, "Fc": 6.1e3, "vs": 4.7}),
    "table": law_class("table")(slip=(0.02, 0.06, 0.12, 0.25, 0.5), mu=(0.13, 0.24, 0.28, 0.25, 0.21)),
}
SLIPS = np.linspace(0.006, 0.48, 4000)


def ramp_rows() -> Rows:
    """Slip rising from 0 at 0.02 1/s at constant speed, and the torque that goes with mu = 2 slip."""
    time = np.cumsum(0.005 * np.random.default_rng(0).uniform(0.5, 1.5, 2000))
    slip, wheel = 0.02 * time, PARK2008.wheel
    omega = V100 * (1 - slip) / wheel.radius
    torque = (
        2 * slip * LOAD * wheel.radius + 0.02 * V100 / wheel.radius * wheel.inertia - wheel.viscous_friction * omega
    )
    columns = {"time": time, "train_speed": np.full(2000, V100), "wheel_angular_speed": omega, "brake_torque": torque}
    return Rows(np.arange(2000) + 2, columns)


@pytest.mark.parametrize(("observer", "lag"), [(Observer.CORRECTED, 1.0), (Observer.KALMAN, math.sqrt(2.0))])
@pytest.mark.parametrize("block", [2000, 77])
def test_observed_mu_stands_over_the_slip_it_belongs_to(observer, lag, block):
    """The lag of the observer is in mu and in slip alike: a straight line stays the line it is.

    1/(tau s + 1) is tau late; 1/(tau^2 s^2 + sqrt(2) tau s + 1) is sqrt(2) tau late.
    """
    rows, stream = ramp_rows(), AdhesionStream(PARK2008, observer=observer)
    parts = [stream.add(rows.part(start, start + block)) for start in range(0, 2000, block)]
    time, slip, slip2, mu = (
        np.concatenate([getattr(part, n) for part in parts]) for n in ("time", "slip", "slip2", "mu")
    )
    # the start is not known to the observer: exp(-20) of it is left after 20 time constants, and rounding
    late, tau = time > time[0] + 20 * stream.time_constant, stream.time_constant
    assert (late.sum() > 1500, stream.survey.runs) == (True, 1)
    assert mu[late] == pytest.approx(2 * slip[late], rel=1e-6)
    exact = observer is Observer.CORRECTED  # the gain of the Kalman filter is for one interval, and these are not
    found, behind = (0.02 * time - slip)[late], np.full(late.sum(), 0.02 * lag * tau)
    assert found == pytest.approx(behind, rel=1e-5 if exact else 0.25)
    assert found.mean() == pytest.approx(behind[0], rel=0.05)
    if exact:  # the variance of an exponential window, (rate tau)^2, but for (interval/tau)^2 between samples
        assert (slip2 - slip**2)[late] == pytest.approx(behind**2, rel=1e-2)


def test_a_gap_restarts_the_observer_and_is_told():
    rows, kept = ramp_rows(), np.ones(2000, dtype=bool)
    rows.columns["wheel_speed"] = rows.columns.pop("wheel_angular_speed") * PARK2008.wheel.radius
    rows.columns["wheel_load"] = np.full(2000, 2 * LOAD)
    kept[800:1000] = False
    stream, time = AdhesionStream(PARK2008), rows.columns["time"]
    observed = stream.add(rows.where(kept))
    assert (stream.survey.gap_count, stream.survey.runs) == (1, 2)
    assert stream.survey.gaps == [(1002, pytest.approx(time[1000] - time[799]))]
    assert stream.survey.wheel_load == pytest.approx(2 * LOAD)
    after = observed.time[observed.time > time[999]]
    assert after[0] >= time[1000] + 5 * stream.time_constant  # what the observer does not know yet is not used
    assert observed.mu == pytest.approx(observed.slip, rel=0.01)


def test_impossible_rows_are_left_out_when_few_and_refused_when_many():
    few, many = ramp_rows(), ramp_rows()
    few.columns["wheel_angular_speed"][[500, 501]] = 5000.0
    many.columns["wheel_angular_speed"] *= 1.8
    taken, refused = AdhesionStream(PARK2008), AdhesionStream(PARK2008)
    taken.add(few)
    taken.check("log")
    assert taken.survey.implausible == 2
    assert taken.survey.first_implausible.startswith("line 502: wheel speed 7740 km/h")
    refused.add(many)
    with pytest.raises(InputError, match=r"log: line \d+: wheel speed .* far above the train speed.*check columns"):
        refused.check("log")


def test_a_record_is_whole_runs_however_its_rows_come():
    used = np.repeat(np.random.default_rng(5).uniform(size=60) < 0.6, 50)
    rows, apart = (
        np.vstack([np.arange(used.size, dtype=float), np.ones((4, used.size))]),
        np.arange(used.size) % 170 == 17,
    )
    whole, parts = Recorder(700), Recorder(700)
    whole.add(rows, used, apart)
    for at in (slice(start, start + 77) for start in range(0, used.size, 77)):
        parts.add(rows[:, at], used[at], apart[at])
    record = whole.record()
    assert 0 < len(record) <= 700
    assert np.array_equal(record.time, parts.record().time)
    follows = used[1:] & used[:-1] & ~apart[1:]  # of row 1 on, whether it goes on with the run of the row before
    for run in np.unique(record.run):
        kept = record.time[record.run == run].astype(int)
        assert follows[kept[:-1]].all()
        assert np.array_equal(kept, np.arange(kept[0], kept[-1] + 1))
        assert not follows[[kept[0] - 1, kept[-1]]].any()


def samples(slip, speed, mu, *, interval=0.01) -> Observed:
    """Samples seen without a filter: the moments are the powers."""
    slip, speed, mu = np.broadcast_arrays(np.asarray(slip, float), np.asarray(speed, float), np.asarray(mu, float))
    time = interval * np.arange(slip.size)
    return Observed(time, slip, slip**2, slip**3, speed, slip * speed, mu, np.full_like(mu, LOAD))


def gathered(observed: Observed) -> Accumulator:
    sums = Accumulator(TAU)
    sums.add(observed)
    return sums


def fitted(name: str, sums: Accumulator, **setting: object) -> Fit:
    cells, known = sums.cells(), {"wheel_load": LOAD, "initial_speed": V100, "slip_acceleration": 2.93, **setting}
    peak = peak_slip(cells)
    model = models.fit_model(name, cells, models.shape_of(cells, peak), Setting(**known))
    return fits.fit(model, cells, sums.stretches(), Setting(**known), peak, TAU)


def law_coefficient(name: str, slip: np.ndarray, speed: float) -> np.ndarray:
    if name == "bristle":  # built up along a ramp of 2.93 m/s^2
        law = LAWS[name]
        return np.asarray(curve_force(slip, *law.parameters(), 2.93, V100)) / LOAD
    return np.asarray(adhesion_coefficient(LAWS[name], speed, slip, LOAD))


def test_cells_and_bins_are_sums_over_the_samples_however_they_come():
    generator = np.random.default_rng(2)
    slip, speed = generator.beta(1.5, 6.0, 3000), generator.uniform(5.0, 30.0, 3000)
    observed = samples(slip, speed, 0.3 * slip + generator.standard_normal(3000))
    whole, parts = gathered(observed), Accumulator(TAU)
    for start in range(0, 3000, 700):
        at = (np.arange(3000) >= start) & (np.arange(3000) < start + 700)
        parts.add(observed.where(at))
    cells, bins = whole.cells(), whole.bins()
    for name in ("count", "slip", "speed", "mu", "squares"):  # sums in another order
        assert getattr(parts.cells(), name) == pytest.approx(getattr(cells, name), rel=1e-9, abs=1e-12)
    # the mean of a cubic is exact, but for the rounding of moments of order 1
    total = np.sum(cells.count * np.sum(cells.weights * (2.0 - cells.nodes + 7.0 * cells.nodes**3), axis=0))
    assert total == pytest.approx(np.sum(2.0 - slip + 7.0 * slip**3), rel=1e-12)
    assert cells.count.sum() == slip.size
    for i in range(len(bins.slip)):
        inside = observed.mu[(slip >= bins.low[i]) & (slip < bins.high[i])]
        assert (bins.count[i], bins.least[i], bins.most[i]) == (inside.size, inside.min(), inside.max())
        assert bins.mean[i] == pytest.approx(inside.mean(), rel=1e-12, abs=1e-13)
        if inside.size > 1:
            assert bins.deviation[i] == pytest.approx(inside.std(ddof=1), rel=1e-9)


@pytest.mark.parametrize("name", [name for name in models.MODELS if name != "table"])
def test_clean_data_give_the_parameters_back(name):
    sums = Accumulator(TAU)
    for v in (V100, 12.0) if name in ("beam", "polach", "lugre") else (V100,):  # of two speeds, where it counts
        sums.add(samples(SLIPS, v, law_coefficient(name, SLIPS, v)))
    found = fitted(name, sums)
    for parameter in found.parameters:
        assert parameter.value == pytest.approx(getattr(LAWS[name], parameter.name), rel=1e-6), parameter.name
        assert parameter.status == "fitted"
    # what the two-point rule leaves of the variance in a cell where the curve is steepest
    assert math.sqrt(found.residual_squares / sums.cells().count.sum()) < 2e-5


def test_a_clean_table_gives_its_values_back():
    def cubic(slip):
        return 4.0 * slip - 14.0 * slip**2 + 15.0 * slip**3

    found = fitted("table", gathered(samples(SLIPS, V100, cubic(SLIPS))))
    assert found.values == pytest.approx(cubic(found.model.knots), rel=1e-5)  # the search ends within that
    # the law's monotone cubics between its points
    assert adhesion_coefficient(found.law, V100, SLIPS[9:3990], LOAD) == pytest.approx(cubic(SLIPS[9:3990]), abs=2e-4)


def test_long_run_variance_of_filtered_noise_is_its_closed_form():
    """(1 + exp(-h/tau))/(1 - exp(-h/tau)) times the variance, of samples h apart."""
    interval, count, sigma = 0.01, 60_000, 0.01
    slip = 0.25 + 0.23 * np.sin(np.arange(count) * interval / 3.0)
    clean = np.asarray(adhesion_coefficient(LAWS["burckhardt"], V100, slip, LOAD))
    decay = math.exp(-interval / TAU)
    white = np.random.default_rng(4).standard_normal(count)
    noise = sigma * lfilter([math.sqrt(1 - decay**2)], [1.0, -decay], white)  # correlated as exp(-t/TAU)
    found = fitted("burckhardt", gathered(samples(slip, V100, clean + noise, interval=interval)))
    expected = sigma**2 * (1 + decay) / (1 - decay)
    # the largest of the estimates over lengths of stretch, some with few degrees of freedom, so above rather than below
    assert 0.9 * expected < found.long_run_variance < 4.0 * expected


def test_what_a_steady_curve_or_too_little_of_it_does_not_show_is_said():
    slip = np.linspace(0.01, 0.4, 500)
    flat = law_class("lugre").model_validate({"alpha": 2e4, "Fs": 9e3, "Fc": 9e3, "vs": 4.0})
    found = fitted("lugre", gathered(samples(slip, V100, adhesion_coefficient(flat, V100, slip, LOAD))))
    assert "vs" in {p.name for p in found.parameters if p.status == "not identifiable"}
    assert all(math.isnan(p.stderr) for p in found.parameters if p.status != "fitted")
    assert any("not identifiable from this log" in note for note in found.notes)
    few = slip[:300:40]
    found = fitted("beam", gathered(samples(few, V100, law_coefficient("beam", few, V100))))
    assert all(math.isnan(p.stderr) for p in found.parameters)
    assert any("standard errors" in note for note in found.notes)


def test_bounds_hold_and_an_active_one_is_said():
    clean = gathered(samples(SLIPS, V100, law_coefficient("beam", SLIPS, V100)))
    found = fitted("beam", clean, bounds={"mu_max": (0.0, 0.25)})
    mu_max, _, Kx = found.parameters
    assert 0.25 * (1 - 1e-5) < mu_max.value <= 0.25
    assert (mu_max.status, math.isnan(mu_max.stderr), math.isfinite(Kx.stderr)) == ("at upper bound", True, True)
    # a beam that falls short of the data fits the worse the lower it is, so that little below the bound is left
    assert 0.24 < mu_max.interval[0] < mu_max.interval[1] <= 0.25 * (1 + 1e-9)
    assert any(note.startswith("mu_max: rests on its upper bound; at least 0.") for note in found.notes)


@pytest.mark.parametrize(("noise", "bounded"), [(300.0, True), (1500.0, True), (3000.0, False)])
def test_profiles_along_a_bend_are_fieller_s(noise, bounded):
    """A straight line with a fall of 200 N/(m/s): beta is the inverse of its slope, gamma where it comes to
    nought, as of the bristles' force at rest.

    The interval of both is known in closed form: the inverse of the slope's, and Fieller's for a ratio. Where the
    slope may be nought, neither has an upper end.
    """
    both = np.array([1e-12, 5.0]), np.full(2, np.inf), np.array([5e-3, 50.0])
    falling, s, q = models.Coordinates.of(("beta", "gamma"), *both), np.linspace(0.2, 4.0, 400), NORMAL_QUANTILE
    force = (60.0 - s) / 5e-3 + noise * np.random.default_rng(12).standard_normal(s.size)
    matrix = np.stack([np.ones(s.size), -s], axis=1)
    (level, fall), *_ = np.linalg.lstsq(matrix, force)
    C = noise**2 * np.linalg.inv(matrix.T @ matrix)
    best, half = np.array([1.0 / fall, level / fall]), q * math.sqrt(C[1, 1])
    assert (half < fall) == bounded
    # Fieller: (level - gamma fall)^2 <= q^2 (C00 - 2 gamma C01 + gamma^2 C11); opens downwards where unbounded
    squares = [fall**2 - half**2, -2.0 * (level * fall - q**2 * C[0, 1]), level**2 - q**2 * C[0, 0]]
    of_beta, of_gamma = [1.0 / (fall + half), 1.0 / (fall - half)], sorted(np.roots(squares))
    for index, ends in enumerate((of_beta, of_gamma if bounded else of_gamma[::-1])):
        size = (best[0] ** 2, best[0] * math.hypot(best[1], 1.0))[index]  # some size of the slope; a first guess only
        known = {"stderr": size * half / q, "rise": q**2}
        low, high = fits.profile_interval(lambda x: ((x[1] - s) / x[0] - force) / noise, falling, best, index, **known)
        # ends of the slope's interval are found to a fiftieth of a standard error, half/2.6
        assert low == pytest.approx(ends[0], rel=0.01 * half / (fall + half))
        assert high == (pytest.approx(ends[1], rel=0.01 * half / (fall - half)) if bounded else math.inf)


def flat(name: str = "beam", **setting: object) -> Fit:
    return fitted(name, gathered(samples(np.linspace(0.01, 0.4, 300), V100, 0.2)), **setting)


@pytest.mark.parametrize(("refuse", "message"), [
    (lambda: check_options(("beam",), {}, {"x": (0.0, 1.0)}), "`bounds`: 'x'"),
    (lambda: check_options(("beam",), {"a": 0.5}, {"a": (0.1, 0.3)}), "`fixed` a: 0.5 is outside `bounds` a"),
    (lambda: flat(fixed={"mu_max": 0.3, "a": 0.0, "Kx": 2e5}), "every parameter of 'beam' is fixed"),
    (lambda: flat(bounds={"a": (2.0, 1.0)}), "`bounds` a: 2:1 is not allowed; give the lower bound first"),
    (lambda: flat(bounds={"a": (-2.0, -1.0)}), "`bounds` a: -2 to -1 .* values > "),
    (lambda: flat("bristle", slip_acceleration=None), "ramps of rising slip.*`slip_acceleration`"),
    (lambda: fitted("beam", gathered(samples([0.1, 0.1, 0.2], V100, 0.2))), "2 distinct slips are too few"),
])  # fmt: skip
def test_what_cannot_be_fitted_is_refused(refuse, message):
    check_options(("beam",), {"mu_max": 0.2}, {"mu_max": (0.1, 0.3)})
    with pytest.raises(InputError, match=message):
        refuse()


def noisy_samples(name: str) -> Observed:
    generator = np.random.default_rng(8)
    slip = 0.005 + 0.45 * generator.uniform(size=20_000)
    return samples(slip, V100, law_coefficient(name, slip, V100) + 0.01 * generator.standard_normal(slip.size))


@pytest.mark.parametrize("name", ["curve", pytest.param("beam", marks=pytest.mark.long)])
def test_the_model_that_made_the_data_comes_first_and_errors_are_those_of_the_bins(name):
    observed = noisy_samples(name)
    sums = gathered(observed)
    scores = compare([fitted(each, sums) for each in ("beam", "curve", "burckhardt", "table")], sums.cells())
    assert [s.bic for s in scores] == sorted(s.bic for s in scores)
    assert scores[0].fit.model.name == name
    (score,) = (each for each in scores if each.fit.model.name == "beam")
    assert score.bic - score.aic == pytest.approx(4.0 * (math.log(score.independent) - 2.0))  # and the noise's variance
    deviation = observed.mu - np.asarray(adhesion_coefficient(score.fit.law, V100, observed.slip, LOAD))
    place = (observed.slip * 50).astype(int)
    errors = np.array([abs(deviation[place == i].mean()) for i in range(place.max() + 1)])
    # a cell across the edge of two bins counts in one: some 4 % of a bin, where the errors differ by up to 0.03
    assert score.mean_abs_error == pytest.approx(errors.mean(), abs=6e-4)
    regimes = results.Regimes(0.12, "given").errors(score)  # adhesion: bins with a mean slip below 0.12
    assert regimes == pytest.approx((errors[:6].mean(), errors[6:].mean()), abs=1.2e-3)


@functools.cache
def burckhardt_fit() -> Fit:
    return fitted("burckhardt", gathered(noisy_samples("burckhardt")))


def test_peak_its_error_and_its_reference_in_closed_form():
    """Burckhardt: slip log(c1 c2/c3)/c2, whose gradient is known, against differences of a search."""
    found = burckhardt_fit()
    c1, c2, c3 = found.values
    slip = math.log(c1 * c2 / c3) / c2
    gradient = np.array([1 / (c1 * c2), (1 - math.log(c1 * c2 / c3)) / c2**2, -1 / (c2 * c3)])
    peak = peak_of_fit(found, V100, LOAD, Rail.DRY)
    assert peak.slip == pytest.approx(slip, rel=1e-6)  # a flat maximum is found to the root of rounding
    # differences of the search over a tenth of a standard error
    assert peak.slip_stderr == pytest.approx(math.sqrt(gradient @ found.covariance @ gradient), rel=5e-3)
    # a peak well known is not held: a quarter more slip, as an envelope tolerates, is just the peak
    assert NORMAL_QUANTILE * peak.slip_stderr < 0.2 * slip
    assert 1.25 * peak.reference == pytest.approx(slip, rel=1e-6)
    held = law_coefficient("burckhardt", np.array([peak.reference]), V100)
    assert peak.reference_coefficient == pytest.approx(held[0], rel=1e-2)  # the fit is that good
    # of a vague one the allowed loss is given away
    covariance = 1e5 * found.estimate.coordinate_covariance
    vague = replace(found, estimate=replace(found.estimate, coordinate_covariance=covariance))
    peak = peak_of_fit(vague, V100, LOAD, Rail.DRY)
    assert NORMAL_QUANTILE * peak.slip_stderr > peak.slip > peak.reference
    assert peak.reference_coefficient == pytest.approx((1 - results.LARGEST_LOSS) * peak.coefficient, rel=1e-9)
    none = peak_of_law(LAWS["bristle_rest"], V100, LOAD)
    assert np.isnan([none.slip, none.reference]).all()
    assert none.coefficient == pytest.approx(LAWS["bristle_rest"].gamma / LAWS["bristle_rest"].beta / LOAD, rel=1e-4)


def test_polynomials_of_v0_are_the_published_ones():
    """[Park2008] (30)-(32) out of fits to clean curves at the four speeds of the rig."""
    speeds, fits = KMH * np.array([30.0, 60.0, 100.0, 140.0]), []
    for v0 in speeds:
        law = published_law("curve", Rail.DRY, v0 / KMH)
        sums = gathered(samples(SLIPS, v0, adhesion_coefficient(law, v0, SLIPS, LOAD)))
        fits.append(fitted("curve", sums, initial_speed=v0, slip_acceleration=None))
    found = {p.name: p for p in over_initial_speed(speeds, fits)}
    # SI: beta and gamma are printed in km/h; parameters good to 1e-6, and the powers cancel by some 10
    assert found["alpha"].coefficients == pytest.approx([5.455e4, -3.641e2, 3.798e-1], rel=1e-3)
    assert found["beta"].coefficients * 3.6 == pytest.approx([1.873e-2, -6.059e-5, 5.500e-8], rel=1e-3)
    assert found["gamma"].coefficients * 3.6 == pytest.approx([2.345e2, -8.620e-1, 1.053e-4], rel=1e-2)
    for name, expected in zip(("alpha", "beta", "gamma"), published_coefficients(80.0, LOAD), strict=True):
        assert found[name].at(80.0) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("kink", "told"), [(0.0, False), (0.05, True)])
def test_a_weighted_polynomial_is_numpys_and_says_where_it_misses_the_logs(kink, told):
    speeds, stderrs = np.array([30.0, 60.0, 90.0, 120.0, 150.0]), 0.005 * np.array([2.0, 1.0, 1.0, 0.5, 1.5])
    noise = 0.005 * np.array([0.5, -1.0, 0.3, 0.3, -0.4])
    values = 0.4 - 1e-3 * speeds + noise + kink * (speeds == 90.0)
    found = burckhardt_fit()
    c1s = (Parameter("c1", *each, "fitted") for each in zip(values, stderrs, strict=True))
    fits = [replace(found, parameters=(c1, *found.parameters[1:])) for c1 in c1s]
    c1 = over_initial_speed(speeds * KMH, fits)[0]
    expected, covariance = np.polyfit(speeds, values, 2, w=1.0 / stderrs, cov="unscaled")
    assert c1.coefficients == pytest.approx(expected[::-1], rel=1e-9)
    assert c1.covariance == pytest.approx(covariance[::-1, ::-1], rel=1e-9)
    assert (c1.misfit_probability < 0.01, bool(c1.misses)) == (told, told)
    residual = (values - np.polyval(expected, speeds)) / stderrs
    # of two degrees of freedom chi-squared has the tail exp(-x/2)
    assert c1.misfit_probability == pytest.approx(math.exp(-float(residual @ residual) / 2.0), rel=1e-6)
    assert math.isnan(over_initial_speed([10.0, 20.0], [burckhardt_fit()] * 2)[0].misfit_probability)  # through both


def test_the_covariance_is_that_of_refits_without_each_test():
    """By definition: (G - 1)/G times the scatter of the estimates that leave out one test, here by solving anew."""
    generator, test = np.random.default_rng(1), np.repeat(np.arange(7), 40)
    design = np.stack([np.ones(280), generator.uniform(0.0, 1.0, 280)], axis=1)
    level = 2.0 * generator.standard_normal((7, 2))  # and slope, of each test its own
    y = np.sum(level[test] * design, axis=1) + generator.standard_normal(280)
    covariance, freedom = clustered_covariance(design, design @ np.linalg.lstsq(design, y)[0] - y, test)
    without = np.array([np.linalg.lstsq(design[test != i], y[test != i])[0] for i in range(7)])
    scatter = without - without.mean(axis=0)
    assert covariance == pytest.approx(6.0 / 7.0 * scatter.T @ scatter, rel=1e-9)  # rounding of a linear problem
    assert freedom == 6


def test_intervals_hold_the_truth_as_often_as_they_say():
    """A straight line through 5 points: an interval too narrow by a one-sided quantile holds it in 98 % of 2500 logs.
    Nor is a log without fault told to have one more often than is said."""
    generator, at, held = np.random.default_rng(2), np.linspace(0.0, 1.0, 5), 0
    matrix, free = np.stack([np.ones(5), at], axis=1), np.full(2, np.inf)
    line = models.Coordinates.of(("a", "b"), -free, free, np.ones(2))
    for y in matrix @ [1.0, 2.0] + generator.standard_normal((2500, 5)):
        best = np.linalg.lstsq(matrix, y)[0]
        problem = SimpleNamespace(coordinates=line, residuals=lambda x, y=y: matrix @ x - y)
        noise = float(np.sum((matrix @ best - y) ** 2)) / 3.0
        found = fits.estimate(problem, best, matrix, noise, 3, profiles=False)
        low, high = Parameter("a", best[0], math.sqrt(found.covariance[0, 0]), "fitted").interval
        held += low <= 1.0 <= high
    assert binomtest(held, 2500, CONFIDENCE).pvalue > 0.01
    beyond = np.abs(generator.standard_t(4.0, 200_000)) > log_checks.Rolling(*np.zeros(8), 4.0).critical_value
    assert binomtest(int(beyond.sum()), beyond.size, log_checks._FALSE_ALARM).pvalue > 0.01


def test_pieces_of_a_test_are_one():
    """Runs of 2 s: 0.3 s apart they are one test that was interrupted, 30 s apart two tests."""
    end = np.concatenate([begin + 0.1 * np.arange(1, 21) for begin in (0.0, 2.3, 34.3, 66.3)])
    found = fits.whole_tests(end, np.full(80, 0.1), np.repeat(np.arange(4), 20))
    assert found.tolist() == np.repeat([0, 0, 1, 2], 20).tolist()


@pytest.mark.long
def test_scatter_from_test_to_test_widens_what_it_shifts():
    """Six tests scattered by 3 % by their wheel loads: of mu_max that is an error, five times that of the noise."""
    law, widths = LAWS["beam"], []
    factor = np.exp(0.03 * np.random.default_rng(8).standard_normal(6))
    for loads in (factor, np.ones(6)):
        rows = rig_rows(law, seed=4, loads=tuple(loads))
        rows.columns.pop("wheel_load", None)  # nobody knows it
        rows.columns["time"] = rows.columns["time"] + 30.0 * (np.arange(len(rows)) // (len(rows) // 6))
        found = identified(rows, initial_speed=V100).chosen.fit.parameters
        assert all(p.interval[0] <= getattr(law, p.name) <= p.interval[1] for p in found)
        widths.append([np.ptp(p.interval) / getattr(law, p.name) for p in found])
    scattered, alike = widths  # of mu_max, a and Kx
    # of a mean of six, with 5 degrees of freedom; the noise within the tests is a quarter of that
    expected = 2.0 * student.ppf(0.995, 5) * np.std(factor, ddof=1) / math.sqrt(6)
    assert scattered[0] == pytest.approx(expected, rel=0.3)
    assert (scattered[0] > 3.0 * alike[0], scattered[1] < 3.0 * alike[1]) == (True, True)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_a_written_law_is_the_law_that_is_read(file, law):
    law, more = law.on(Rail.WET), {"wheel_load": LOAD, "speeds_kmh": (30.0, 31.5), "comments": ["two\nlines", "é"]}
    path = file("law.toml", law_toml(law, reference=law.reference, **more))
    assert (load_law(path), adhesion.wheel_load_in(path)) == (law, LOAD)
    assert adhesion.initial_speeds_in(path) == (30.0, 31.5)


def test_a_file_of_polynomials_is_the_law_at_its_initial_speed(file):
    coefficients = {"mu_max": [0.42, -2e-3, 5e-6], "a": [0.005], "Kx": [2.7e5, 10.0]}
    held = {100.0: ReferenceSlip(dry=0.13, wet=0.09), 30.0: ReferenceSlip(dry=0.27, wet=0.19)}
    more = {"references": held, "wheel_load": LOAD, "comments": ["over v0"]}
    path = file("over.toml", polynomials_toml(LAWS["beam"], coefficients, (30.0, 140.0), **more))
    law = load_law(path, initial_speed_kmh=80.0)
    assert (law.mu_max, law.a, law.Kx) == pytest.approx((0.42 - 0.16 + 0.032, 0.005, 270_800.0), rel=1e-12)
    # straight between the speeds: 5/7 of the way from 30 to 100 km/h
    assert (law.reference.dry, law.reference.wet) == pytest.approx((0.17, 0.19 - 5 / 70 * 10 * 0.1), rel=1e-12)
    assert load_law(path, initial_speed_kmh=130.0).reference == held[100.0]
    with pytest.raises(InputError, match=r"polynomials depend on the initial speed"):
        load_law(path)
