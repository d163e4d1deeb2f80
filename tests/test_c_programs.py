"""C99 of every controller kind, and the guard: the same in Python and in C, harmless under every fault."""

import ctypes
import math
import re
import runpy
import shutil
import subprocess
from types import SimpleNamespace

import control as ct
import numpy as np
import pytest
from generated_code import COMPILER, WARNINGS, Program, needs_compiler
from sample_laws import ALL_LAWS, sample_law

from railslip_ctrl import PARK2008, PI, ReferenceSlip, simulate, stop
from railslip_ctrl.controllers.assumed import force_of
from railslip_ctrl.controllers.base import Controller, Measurement
from railslip_ctrl.controllers.braking import linear_control
from railslip_ctrl.controllers.c_code import c_program
from railslip_ctrl.controllers.c_function import CFunction, Structures
from railslip_ctrl.controllers.files import load_controller, structure_named
from railslip_ctrl.controllers.guard import ControlUnit, Guard, Status, step_parameters
from railslip_ctrl.controllers.torque_profile import TorqueProfile
from railslip_ctrl.controllers.translate import MEASUREMENT, PARAMETERS, STATE, read_step
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import quantity
from railslip_ctrl.design.catalogue import controller_named
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import Rail, Record
from railslip_ctrl.simulation.embedded import save_c, single_precision_deviation
from railslip_ctrl.sliding.law import NOT_HOLDING

RADIUS = PARK2008.wheel.radius
PERIOD = 0.01
S = ct.tf("s")
KINDS = {
    **{
        name: controller_named(name, PARK2008)
        for name in ("pi", "pi-lead", "scheduled", "slide-protection", "seeking", "predictive")
    },
    "asmc": controller_named("asmc", PARK2008).assuming(published_law("curve", Rail.DRY)),
    "third-order": linear_control(
        300 * (S * S + 0.2 * S + 1) / (S * S + 2 * S + 1) * (1 + 0.1 / S), torque_min=0.0, torque_max=9e3
    ),
    "constant torque": TorqueProfile(times=(0.5,), torques=(500.0,), period=PERIOD),
    "torque-profile": TorqueProfile(times=(0.5, 1.5, 3.0), torques=(500.0, 3000.0, 1000.0), period=PERIOD),
}
KINDS = {name: one.model_copy(update={"period": PERIOD, "name": name}) for name, one in KINDS.items()}


def compiled(control, folder, *flags):
    """The program of a controller."""
    return Program(c_program(control, PARK2008), folder, *flags)


@pytest.fixture(scope="module", params=KINDS)
def kind(request):
    return KINDS[request.param]


@pytest.fixture(scope="module")
def program(kind, tmp_path_factory):
    if COMPILER is None:
        pytest.skip("no C compiler (cc) on this system")
    return compiled(kind, tmp_path_factory.mktemp("c"))


@pytest.fixture(scope="module")
def signals(kind):
    scenario = stop(PARK2008, "dry").with_changes(final_speed=12.0, limits={"torque_min": 0.0, "torque_max": 9e3})
    return simulate(scenario, kind, seed=1).signals


def test_the_guard_and_the_translation_change_no_run_without_a_fault(kind, program, signals):
    unit = ControlUnit(kind, PARK2008, signals.speed[0])
    assert program.init(signals.speed[0]) == 0
    before = 0.0
    rows = zip(signals.measured_speed[:-1], signals.measured_wheel_speed[:-1], signals.command[:-1], strict=True)
    for v, omega, command in rows:
        torque, status = unit.step(v, omega, before)
        assert (torque, status) == (command, Status.OK)
        # the compilers may round products and sums otherwise, and an integral adds it up
        assert program.step(v, omega, before) == (pytest.approx(command, rel=1e-9, abs=1e-6), Status.OK)
        before = command


GUARD = Guard(period=PERIOD, radius=RADIUS, torque_max=9e3)
RELEASED = GUARD.hold_time + GUARD.release_time
# what is measured instead of (v, omega), and the time after which the brake must be released, s; None: it need not be
FAULTS = {
    **{
        f"train speed {x}": (lambda v, omega, x=x: (x, omega), RELEASED) for x in (math.nan, math.inf, -math.inf, 1e308)
    },
    **{f"wheel speed {x}": (lambda v, omega, x=x: (v, x), RELEASED) for x in (math.nan, math.inf, -math.inf, 1e308)},
    "train speed with other sign": (lambda v, omega: (-v, omega), RELEASED),
    "wheel speed with other sign": (lambda v, omega: (v, -omega), RELEASED),
    **{f"train speed stuck at {x}": (lambda v, omega, x=x: (x, omega), RELEASED) for x in (0.0, 5e-324, 10.0)},
    "wheel speed stuck at 580": (lambda v, omega: (v, 580.0), RELEASED),
    "wheel speed stuck": (lambda v, omega: (v, 52.0), GUARD.stuck_time + RELEASED),
    "wheel speed stuck at 0": (lambda v, omega: (v, 0.0), GUARD.lock_time),
    **{f"locked at {x} m/s": (lambda v, omega, x=x: (x, 0.0), GUARD.lock_time) for x in (2.0, 5.0, 10.0, 20.0)},
    "applied torque": (lambda v, omega: (v, omega), None),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_releases_the_brake_in_both_languages_within_its_time(kind, program, fault):
    """2 s without, 3 s with the fault, 1 s without: the same commands, within the limits, no brake for ever."""
    measured, released_after = FAULTS[fault]
    unit, v = ControlUnit(kind, PARK2008, 27.0), 27.0
    program.init(27.0)
    before, released = [0.0, 0.0], math.nan
    for k in range(600):
        v -= 0.02
        omega, faulty = v * (1 - 0.02 - 0.01 * math.sin(0.7 * k)) / RADIUS, 200 <= k < 500
        given = measured(v, omega) if faulty else (v, omega)
        if faulty and fault == "applied torque":
            before = [math.nan, math.nan]
        (torque, status), (in_c, status_in_c) = unit.step(*given, before[0]), program.step(*given, before[1])
        assert 0.0 <= torque <= unit.guard.torque_max
        assert (in_c, status_in_c) == (pytest.approx(torque, rel=1e-9, abs=1e-6), status), k
        before = [torque, in_c]
        if faulty and torque == 0.0 and math.isnan(released):
            released = (k - 200 + 1) * PERIOD
        if faulty and released_after is not None and (k - 200) * PERIOD > released_after + PERIOD:
            # a law that releases the brake by itself hides that the sensor is stuck
            seen = status in (Status.FAULT, Status.LOCKED) or fault == "wheel speed stuck"
            assert (torque, seen) == (0.0, True)
    assert released_after is None or not released > released_after + 2 * PERIOD
    assert status is Status.OK  # it goes on when the fault is over


@needs_compiler
def test_parameters_that_are_refused_keep_the_brake_released(kind, program):
    size = ctypes.sizeof(program.default) // ctypes.sizeof(program.number)
    numbers = list((program.number * size).from_buffer_copy(bytes(program.default)))
    count = 1 + sum(len(re.findall(r"^    railslip_\w+_real \w+", part, re.M)) for part in _structures(program))
    for place in [None, *range(0, size, max(size // 100, 1))]:  # a table of an adhesion law has thousands
        given = (program.number * size)(*([0.0] * size if place is None else numbers))
        if place is not None:
            given[place] = math.nan
        assert 0 < program.init(20.0, given) <= count, place
        assert program.step(20.0, 40.0, 0.0) == (0.0, Status.FAULT)
    assert program.init(math.nan) > 0
    assert program.init(20.0) == 0


def _structures(program):
    return re.findall(r"typedef struct \{(.*?)\} \w+_(?:parameters_law|limits);", program.program.header, re.S)


@needs_compiler
def test_it_is_c_plus_plus_too_and_single_precision(kind, program, signals, tmp_path):
    single = compiled(kind, tmp_path, f"-D{program.program.prefix.upper()}_FLOAT32")
    source = tmp_path / f"{program.program.prefix.removeprefix('railslip_')}.c"
    compiler = shutil.which("c++")
    if compiler is not None:
        done = subprocess.run(
            [compiler, "-x", "c++", *WARNINGS, "-c", source, "-o", tmp_path / "a.o"], capture_output=True
        )
        assert (done.returncode, done.stderr) == (0, b"")
    assert single.init(signals.speed[0]) == 0
    largest, before = 0.0, 0.0
    rows = zip(signals.measured_speed[:-1], signals.measured_wheel_speed[:-1], signals.command[:-1], strict=True)
    for v, omega, command in rows:
        torque, _ = single.step(v, omega, before)
        largest, before = max(largest, abs(torque - command)), command
    # what the header prints is of whole stops; exp and sums are rounded in another order there
    assert largest <= 3.0 * single_precision_deviation(kind, PARK2008) + 1.0


DRIVER = """
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include "STEM.h"

static uint64_t seed = 88172645463325252u;

static double uniform(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (double)(seed >> 11) / 9007199254740992.0;
}

static double any(double usual)
{
    const double odd[] = {0.0, -0.0, 5e-324, 1e-300, -1.0, 1e12, -1e13, 1e200, 1.7e308, -1.7e308, NAN, INFINITY};
    return uniform() < 0.03 ? odd[(int)(uniform() * 12.0)] : usual;
}

int main(void)
{
    PREFIX_state state;
    double torque = 0.0, v = 30.0;
    long bad = 0;
    PREFIX_init(&state, &PREFIX_default, v);
    for (long k = 0; k < STEPS; k++) {
        v = v < 0.1 ? 40.0 : v - 0.03 * uniform();
        if (uniform() < 1e-4) {
            PREFIX_init(&state, &PREFIX_default, any(v));
        }
        const double omega = any(v / 0.43 * (1.02 - 1.1 * uniform() * uniform()));
        PREFIX_step(&state, &PREFIX_default, any(v), omega, any(torque), &torque);
        bad += !(torque >= 0.0 && torque <= PREFIX_default.limits.torque_max);
    }
    printf("%ld", bad);
    return bad != 0;
}
"""


@needs_compiler
@pytest.mark.long
def test_ten_million_steps_of_anything_break_nothing(kind, tmp_path):
    """Random and hostile numbers under the address and undefined-behaviour sanitizers; a share for each kind."""
    made = compiled(kind, tmp_path)
    prefix = made.program.prefix
    main = DRIVER.replace("PREFIX", prefix).replace("STEM", prefix.removeprefix("railslip_"))
    (tmp_path / "main.c").write_text(main.replace("STEPS", str(10_000_000 // len(KINDS))))
    source = tmp_path / f"{prefix.removeprefix('railslip_')}.c"
    flags = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    command = [COMPILER, "-std=c99", "-O1", *flags, source, tmp_path / "main.c", "-o", tmp_path / "run", "-lm"]
    if subprocess.run(command, capture_output=True).returncode:
        pytest.skip("the compiler has no sanitizers")
    done = subprocess.run([tmp_path / "run"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "0", "")


@needs_compiler
@pytest.mark.parametrize("sign", ["<", "<=", ">", ">=", "==", "!="])
def test_a_comparison_is_the_same_in_c_and_in_python_at_exactly_its_threshold(sign, tmp_path):
    (tmp_path / "compared.py").write_text(
        f"def compared(state, measurement, parameters):\n    return 1.0 if measurement.time {sign} 0.7 else 0.0\n"
    )
    compared = runpy.run_path(str(tmp_path / "compared.py"))["compared"]
    types = {STATE: "none", MEASUREMENT: "measurement", PARAMETERS: "none"}
    text = CFunction(read_step(compared), Structures(types)).text.replace("static ", "")
    head = "typedef double real; typedef struct { real time; } measurement; typedef struct { real x; } none;\n"
    (tmp_path / "a.c").write_text(f"{head}#define REAL(x) ((real)(x))\n{text}")
    subprocess.run([COMPILER, "-shared", "-fPIC", "-o", tmp_path / "a.so", tmp_path / "a.c"], check=True)
    function = ctypes.CDLL(str(tmp_path / "a.so")).compared
    function.restype = ctypes.c_double
    for time in (0.5, 0.7, 0.9):
        measured = (ctypes.c_double * 1)(time)
        assert function(None, measured, None) == compared(None, SimpleNamespace(time=time), None), time


@pytest.mark.parametrize("name", ALL_LAWS)
def test_the_assumed_adhesion_law_is_the_run_s_in_python_and_in_c(name, tmp_path):
    """At random speeds the force is that of the law's generated functions, and the C program commands what Python does.

    A table is good to 1e-9 of a curve's peak of 1e4 N."""
    law = sample_law(name)
    control = KINDS["asmc"].model_copy(update={"adhesion": law, "layer": 0.3, "name": "asmc"})
    unit, program = ControlUnit(control, PARK2008, 30.0), compiled(control, tmp_path)
    assert program.init(30.0) == 0
    functions, p = numeric_plant(type(law)), plant_parameters(law, PARK2008)
    numbers = SimpleNamespace(**step_parameters(unit.control, Rail.DRY, PERIOD))
    generator = np.random.default_rng(5)
    for _ in range(100):
        v, slip = generator.uniform(5.0, 30.0), generator.uniform(-0.3, 0.8)
        sigma = slip * v
        z = functions.rest_state(v, sigma, 0.0, 0.0, 0.0, 0.0, p)
        force = float(functions.force(v, sigma, z, 0.0, 0.0, 0.0, p))
        assert force_of(type(law))(v, sigma, numbers) == pytest.approx(force, rel=1e-9, abs=1e-5)
        torque, status = unit.step(v, (v - sigma) / RADIUS, 0.0)
        assert program.step(v, (v - sigma) / RADIUS, 0.0) == (pytest.approx(torque, rel=1e-9, abs=1e-6), status)


def test_the_guard_releases_a_brake_whose_controller_has_a_least_torque():
    control = PI(kp=400.0, ki=100.0, torque_min=50.0, torque_max=5000.0)
    unit = ControlUnit(control, PARK2008, 20.0)
    assert unit.step(20.0, 18.0 / RADIUS, 0.0).torque >= 50.0
    for _ in range(round(0.5 / PERIOD)):  # hold_time and release_time take 0.3 s
        torque, status = unit.step(math.nan, 18.0 / RADIUS, 50.0)
    assert (torque, status) == (0.0, Status.FAULT)


def test_a_bad_sample_leaves_no_trace_in_slide_protection_without_its_guard():
    control = KINDS["slide-protection"].believing(PARK2008)
    state = SimpleNamespace(**dict(control.start(20.0, PERIOD)))
    numbers = SimpleNamespace(**step_parameters(control, Rail.DRY, PERIOD))
    torques = [
        control.step(state, Measurement(0.0, 20.0, omega, 0.0), numbers) for omega in (46.0, math.nan, math.inf, 46.0)
    ]
    fill = control.fill_rate * PERIOD
    assert torques == pytest.approx([fill, fill, fill, 2 * fill])
    assert state.filtered_rim_speed == pytest.approx(46.0 * RADIUS)


def test_without_an_adhesion_law_or_with_a_step_alone_there_is_no_program():
    with pytest.raises(InputError, match=r"controller asmc: the adhesion law .* is missing"):
        c_program(controller_named("asmc", PARK2008), PARK2008)
    with pytest.raises(InputError, match="Python object or function"):
        save_c(lambda t, v, omega: 0.0, "x.c")


def test_a_state_that_depends_on_the_speed_has_no_program():
    class Halved(Own):
        def start(self, speed, period):
            return self.State(torque=0.5 * speed)

    with pytest.raises(InputError, match=r"state: .*torque .*the train speed"):
        c_program(Halved(reference=ReferenceSlip(dry=0.1, wet=0.06)), PARK2008)


@needs_compiler
def test_any_name_gives_a_program_and_a_file(tmp_path):
    for name in ("a */ b", "Größe \N{GRINNING FACE}", "\\", "\x7f\n"):
        control = KINDS["pi"].model_copy(update={"name": name})
        assert compiled(control, tmp_path).init(20.0) == 0
        control.save(tmp_path / "named.toml")
        assert load_controller(tmp_path / "named.toml") == control


@needs_compiler
def test_a_saved_program_assumes_the_law_of_a_stop_and_says_what_does_not_hold(tmp_path):
    source, header = save_c(controller_named("asmc", PARK2008), tmp_path / "My-Law.c")
    told = header.read_text()
    assert "adhesion law 'curve', on dry rail" in told
    assert all(f" * - {name}" in told for name in NOT_HOLDING)
    command = [COMPILER, "-std=c99", *WARNINGS, "-c", source, "-o", tmp_path / "a.o"]
    assert subprocess.run(command, capture_output=True).returncode == 0


# --- a kind of one's own ----------------------------------------------------------------------------------------------


def rate_limited(torque: float, before: float, most: float) -> float:
    return min(max(torque, before - most), before + most)


class Own(Controller):
    """A gain on the slip error whose torque moves at a limited rate."""

    kind = "own"
    title = "gain with a limit on the rate"
    source = "a test"

    gain: float = quantity("N*m/(m/s)", "gain", gt=0, default=2000.0)
    rate: float = quantity("N*m/s", "largest rate of the torque", gt=0, default=4000.0)
    radius: float | None = quantity("m", "wheel radius", gt=0, default=None)

    class State(Record):
        torque: float = quantity("N*m", "the last torque", default=0.0)

    @staticmethod
    def step(state, measurement, parameters):
        slip_velocity = measurement.train_speed - parameters.radius * measurement.wheel_speed
        error = parameters.reference_slip * measurement.train_speed - slip_velocity
        wanted = max(parameters.gain * error, 0.0)
        state.torque = rate_limited(wanted, state.torque, parameters.rate * parameters.period)
        return state.torque


LANGUAGE = '''
import math

LIMIT = math.inf


def square(x):
    """Not the program's own: x */ x."""
    return x * x * x


def place(parameters, v):
    i = 0
    while i < len(parameters.levels) - 1 and v > parameters.speeds[i]:
        i += 1
    return i


def first(parameters, level):
    k = 0
    while k < len(parameters.levels):
        if parameters.levels[k] > level:
            return 1.0 * k
        k += 1
    return -1.0


def over(v, limit):
    return v > limit


def both(v):
    if v > 20.0:
        return v, True
    return 0.5 * v, 2.0


def step(state, measurement, parameters):
    v, double, unused, returned = measurement.train_speed, parameters.count or 2.5, 1.0, 3
    near, far = both(v)
    for i in range(1, parameters.count):
        state.last[(i - 4) % 3] += parameters.levels[parameters.count - 2] * i
        if state.last[0] > 1e4:
            return returned + near
    chosen = over(v, 20.0) and parameters.zero or 0.5
    x = 1 if v > 15.0 else 2.5
    x **= 2
    k = int(v) + 2
    k %= 3
    stiff = v > 10.0
    stiff = stiff and far < 2.0
    total = square(0.1 * v) + parameters.levels[place(parameters, v)] + first(parameters, 100.0 * v) + double * chosen
    return min(total + x + k + stiff + math.hypot(near, far), LIMIT)
'''


@needs_compiler
def test_the_languages_agree_on_what_differs_between_python_and_c(tmp_path):
    (tmp_path / "language.py").write_text(LANGUAGE)
    body = runpy.run_path(str(tmp_path / "language.py"))["step"]

    class Spoken(Own):
        kind = "spoken"
        count: int = 3
        zero: float = 0.0
        cap: float | None = None
        speeds: tuple[float, ...] = (5.0, 12.0, 25.0)
        levels: tuple[float, ...] = (100.0, 700.0, 1500.0)
        step = staticmethod(body)

        class State(Record):
            last: tuple[float, ...] = quantity("1", "sums", default=(0.0, 1.0, 2.0))

    own = Spoken(period=PERIOD, reference=ReferenceSlip(dry=0.1, wet=0.06)).believing(PARK2008)
    made, unit = compiled(own, tmp_path), ControlUnit(own, PARK2008, 27.0)
    scenario = stop(PARK2008, "dry", speed_kmh=60).with_changes(limits={"torque_min": 0.0, "torque_max": 9e3})
    signals = simulate(scenario, own, seed=2).signals
    assert made.init(27.0) == 0
    commands, before = [], 0.0
    rows = zip(signals.measured_speed, signals.measured_wheel_speed, signals.command, strict=True)
    for v, omega, command in list(rows)[:-1]:
        torque, _ = unit.step(v, omega, before)
        assert (torque, made.step(v, omega, before)[0]) == pytest.approx((command, command), rel=1e-12)
        commands, before = [*commands, command], command
    assert len(set(commands)) > 10


@needs_compiler
def test_a_kind_of_ones_own_runs_and_is_written_as_c(tmp_path):
    own = Own(period=PERIOD, reference=ReferenceSlip(dry=0.1, wet=0.06))
    signals = simulate(stop(PARK2008, "dry"), own, seed=2).signals
    made = compiled(own, tmp_path)
    assert made.init(signals.speed[0]) == 0
    before = 0.0
    for v, omega, command in zip(
        signals.measured_speed, signals.measured_wheel_speed, signals.command[:-1], strict=False
    ):
        before, status = made.step(v, omega, before)
        assert (before, status) == (pytest.approx(command, rel=1e-12), Status.OK)
    assert np.diff(signals.command[:-1]).max() <= 40.0 * (1 + 1e-9)
    source, header = save_c(own, tmp_path / "mine.c")
    assert '#include "mine.h"' in source.read_text()
    assert "railslip_mine_step(" in header.read_text()


@needs_compiler
def test_a_division_by_zero_holds_the_command_in_both_languages(tmp_path):
    class Dividing(Own):
        step = staticmethod(dividing)

    own = Dividing(period=PERIOD, reference=ReferenceSlip(dry=0.1, wet=0.06))
    made, unit = compiled(own, tmp_path), ControlUnit(own, PARK2008, 22.0)
    assert made.init(22.0) == 0
    found = [(unit.step(v, 40.0 + 0.1 * v, 0.0), made.step(v, 40.0 + 0.1 * v, 0.0)) for v in (22.0, 20.0, 19.5)]
    assert [one for one, _ in found] == [(500.0, Status.OK), (500.0, Status.HOLDING), (0.0, Status.OK)]
    assert all(one == other for one, other in found)


def dividing(state, measurement, parameters):
    return 1000.0 / (measurement.train_speed - 20.0)


def unsuitable(body):
    class Broken(Own):
        step = staticmethod(body)

    return Broken(reference=ReferenceSlip(dry=0.1, wet=0.06))


def with_list(state, measurement, parameters):
    return [1.0][0]


def with_numpy(state, measurement, parameters):
    return np.exp(1.0)


def with_unknown_field(state, measurement, parameters):
    return parameters.gian


def with_negative_index(state, measurement, parameters):
    return parameters.rates[-1]


def with_loop_variable(state, measurement, parameters):
    for i in range(3):
        state.torque += i
    return 1.0 * i


def with_recursion(state, measurement, parameters):
    return with_recursion(state, measurement, parameters)


def with_open_end(state, measurement, parameters):
    if state.torque > 3.0:
        return 1.0


def with_written_parameter(state, measurement, parameters):
    parameters.gain = 1.0
    return 1.0


def with_alias(state, measurement, parameters):
    p = parameters
    return p.gain


def with_other_math(state, measurement, parameters):
    return math.log(measurement.time, 2)


def with_mixed_types(state, measurement, parameters):
    value = measurement.time
    if state.torque > 3.0:
        value = twice(1.0)
    return 2.0 * value


def twice(x):
    return x, x


def with_default(state, measurement, parameters):
    return halved(2.0)


def halved(x, by=2.0):
    return x / by


@pytest.mark.parametrize(("body", "words"), [
    (with_negative_index, r"rates\[-1\] .*len"), (with_loop_variable, "i is used outside its loop"),
    (with_recursion, "with_recursion calls itself"), (with_open_end, "may end without a return"),
    (with_written_parameter, "gain is written; .*the state"), (with_alias, r"write \w+\.NAME"),
    (with_other_math, r"math.log\(measurement.time, 2\) cannot be translated; .*: exp, "),
    (with_mixed_types, "controller own: Numba cannot compile its step: "),
    (with_default, r"line \d+: halved takes 2 arguments"),
    (with_list, r"test_c_programs.py, line \d+: List cannot be translated"), (with_numpy, "'np' is "),
    (with_unknown_field, "parameters has no 'gian'; it has"),
])  # fmt: skip
def test_a_step_that_cannot_be_translated_is_refused_with_its_place(body, words):
    with pytest.raises(InputError, match=words):
        simulate(stop(PARK2008, "dry"), unsuitable(body))


KIND = """
from railslip_ctrl.controllers.base import Controller


class Own(Controller):
    kind = "own"
    title = "a constant torque"
    source = "a test"

    @staticmethod
    def step(state, measurement, parameters):
        return 1500.0


CONTROLLER = Own
"""


def test_a_kind_that_remembers_nothing_is_its_step_alone(tmp_path):
    (tmp_path / "own.py").write_text(KIND)
    own = load_controller(tmp_path / "own.py")
    run = simulate(stop(PARK2008, "dry", speed_kmh=30), own(), seed=None)
    assert (run.stopped, run.controller.label, set(run.signals.command)) == (True, "own", {1500.0})
    save_c(own, tmp_path / "own.c")


@pytest.mark.parametrize(("old", "new", "words"), [
    ('    kind = "own"\n', "", "own.py: CONTROLLER: class Own has no attribute kind; .*title and source"),
    ('    source = "a test"\n', "", "Own has no attribute source"),
    ("    @staticmethod\n", "", "write @staticmethod above it"),
    ("def step(", "def stepp(", "Own has no method step; .* step\\(state, measurement, parameters\\)"),
])  # fmt: skip
def test_a_class_that_is_no_kind_is_told_what_it_lacks(old, new, words, tmp_path):
    (tmp_path / "own.py").write_text(KIND.replace(old, new))
    with pytest.raises(InputError, match=words):
        load_controller(tmp_path / "own.py")


@pytest.mark.parametrize(("text", "words"), [
    (KIND, "structure: own cannot be tuned: it is not linear"),
    (KIND + "CONTROLLER = Own()\n", r"structure: CONTROLLER in own\.py is not a class"),
])  # fmt: skip
def test_what_cannot_be_tuned_is_refused_by_its_structure(text, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(text)
    with pytest.raises(InputError, match=words):
        structure_named("own.py")
