"""The contract of the command line: the exit status of every command, and which numbers of its JSON are null."""

import json
import re
import shlex
from unittest.mock import MagicMock

import pytest
from project import refused
from rig_logs import BEAM, rig_rows, write_log
from test_cli import leaves

from railslip_ctrl.cli import reproduce, verify
from railslip_ctrl.cli.program import _COMMANDS

FILES = {
    "short.toml": 'extends = "park2008"\nlongest_time = 1.0\n',
    "two.toml": 'scenario = "short.toml"\nruns = 2\ncontroller = [{controller = "pi"}]\n',
    "slow.toml": "mass = 3517\nactuator = {dead_time = 1.5, lag = 2.0}\n",
}
POINT = "--adhesion bristle --rail dry --speed 100"
OVER = f"--envelope default --nominal {POINT}"
NO_CROSSOVER = "margins --rail dry --adhesion curve --slip 0.02 --kp 1 --ki 0 --certify"  # of a plant that is stable

GAINS, PHASES = ["gain_increase", "gain_decrease"], ["phase_margin_deg", "delay_margin_s"]
EVERY = [*GAINS, *PHASES, "ms", "mt", "disk_margin"]
LIMITS = [f"{pi}_{bound}" for pi in ("pi", "pi_lead") for bound in ("phase_margin_upper_bound_deg", "ms_lower_bound")]
RUN = "braking_time_s braking_distance_m brake_energy_j mean_abs_slip_error mean_abs_slip_error_published first_lock_s"
NOT_GIVEN = "limits/torque_max limits/rate limits/dump_lag events/distance events/adhesion_factor events/happened_at_s"
SPEEDS = ["usable_from_kmh", "robust_from_kmh", "hand_over_kmh"]


def keys(*places, names=EVERY):
    return {f"{place}/{name}" for place in places for name in names}


def unbounded(*names):
    lost = keys("/cases", "/cases/pade", "/cases/certificate", names=names) | keys("/cases/limits", names=LIMITS)
    return lost | {f"/cases/frequencies_rad_s/{name.removesuffix('_deg').removesuffix('_s')}" for name in names}


UNSTABLE = keys("/cases", "/cases/pade") | {"/cases/frequencies_rad_s"}
OUTCOMES = [  # words, exit status, keys that are null where it is told, and no others
    ("linearize --rail dry", 0, set()),  # whatever it finds: the plant has an unstable pole
    ("margins --rail dry --kp 190 --ki 5 --certify", 0, set()),
    ("margins --rail dry --certify", 1, UNSTABLE | keys("/cases/certificate") - {"/cases/certificate/disk_margin"}),
    (f"margins {POINT} --rail wet --kp 700 --ki 5", 1, None),  # stable on wet rail alone
    (NO_CROSSOVER, 0, unbounded("gain_decrease", *PHASES)),
    (f"{NO_CROSSOVER} --dead-time 0 --lag 0", 0, unbounded(*GAINS, *PHASES) | {
        "/cases/stabilizing_gain_range", "/cases/frequencies_rad_s/ms", "/cases/frequencies_rad_s/disk_margin"}),
    (f"margins {OVER} --kp 190 --ki 5", 0, {"/robust_from_kmh", "/hand_over_kmh"}),  # fragile
    (f"margins {OVER}", 1, UNSTABLE | keys("", names=SPEEDS) | keys("/cases/sampled") | keys(
        "/worst", "/worst_with_tolerances", names=["ms", "sampled/ms", *PHASES])),
    (f"tune {POINT} --ms-max 2 --structure pi-lead", 0, set()),
    (f"tune {POINT} --ms-max 2", 1, keys("/cases") | {"/kp_si", "/ki_si", "/worst"}),
    (f"tune {OVER} --ms-max 2 --structure pi-lead", 0, None),
    pytest.param(f"tune {OVER} --ms-max 1.5", 1, None, marks=pytest.mark.long),
    ("simulate --scenario short.toml", 1, keys("", names=[*RUN.split(), *NOT_GIVEN.split()])),
    ("simulate --scenario stop --controller pi-lead", 0, None),
    ("campaign two.toml --out out --workers 1", 0, None),  # though no run stops
    ("identify log.csv --model beam", 0, None),
    (f"design --no-browser {POINT}", 0, set()),
    pytest.param("derive", 0, {"/adhesion"}, marks=pytest.mark.long),  # though errata disagree
    pytest.param(f"report --no-html --nominal --vehicle slow.toml --out out {POINT}", 0, None, marks=pytest.mark.long),
]  # fmt: skip


@pytest.mark.parametrize(("words", "expected", "null"), OUTCOMES)
@pytest.mark.usefixtures("without_lag_search")
def test_exit_status_and_nulls(railslip, file, tmp_path, words, expected, null):
    for name, text in FILES.items():
        file(name, text)
    if "log.csv" in words:
        write_log(tmp_path / "log.csv", rig_rows(BEAM, seed=3))
    status, out, err = railslip(*shlex.split(words), "--json")
    found = leaves(json.loads(out, parse_constant=pytest.fail)).items()
    assert status == expected, err
    assert null is None or {re.sub(r"/\d+", "", path) for path, value in found if value is None} == null


@pytest.mark.parametrize("holds", [True, False])
def test_the_exit_status_of_what_takes_long_is_that_of_its_record(railslip, monkeypatch, holds):
    result = {"return_value.all_hold": holds, "table5.return_value.within": holds}
    monkeypatch.setattr(verify, "verify", MagicMock(**result))
    monkeypatch.setattr(reproduce, "tables", MagicMock(MOST_SEEDS=999, **result))
    for module, name in ((verify, "show"), *((reproduce, f"reproduction_{form}") for form in ("json", "text"))):
        monkeypatch.setattr(module, name, MagicMock(return_value={}))
    for command in ("verify", "reproduce"):
        assert railslip(command, "--json")[0] == (0 if holds else 1)


def test_every_command_is_above_and_refuses_an_option_that_is_not_one(railslip):
    words = [getattr(one, "values", one)[0] for one in OUTCOMES]
    assert {one.split()[0] for one in words} | {"verify", "reproduce"} == set(_COMMANDS)
    assert all("--nonsense" in refused(railslip(command, "--nonsense")) for command in _COMMANDS)
