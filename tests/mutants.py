"""Do the tests notice? Faults are put into a copy of the package, one at a time, and the tests of its room are run.

    python tests/mutants.py adhesion/ --sample 40 --seed 1

names the faults that no test noticed. Not a test itself: a fault takes some seconds. POSIX alone, as it forks.
"""

from __future__ import annotations

import argparse
import ast
import copy
import hashlib
import importlib.util
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

# in every fork already
import control  # noqa: F401
import matplotlib.pyplot  # noqa: F401
import numba  # noqa: F401
import pytest
import scipy.optimize  # noqa: F401
import sympy  # noqa: F401
from platformdirs import user_cache_path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "railslip_ctrl"
ENOUGH = 0.9  # of the faults: some change nothing that could be noticed

ROOMS = {
    "": "input_errors",
    "cli/": "cli help input_errors",
    "core/": "input_errors units vehicle numeric",
    "core/errors": "api",
    "core/folders": "interruption",
    "core/processes": "interruption",
    "core/templates": "sliding_code",
    "core/user_files": "vehicle laws",
    "model/": "vehicle input_errors",
    "model/adhesion/": "laws numeric",
    "model/kernels": "numeric simulation_engine",
    "controllers/": "simulation_controllers scenarios",
    "controllers/files": "scenarios step_objects",
    "controllers/predictive_sampled": "predictive_sampled",
    "controllers/sampled": "sampled simulation_controllers",
    "controllers/scheduled": "simulation_controllers tuning scenarios",
    "controllers/seeking": "seeking simulation_controllers",
    "controllers/step_calls": "step_objects",
    "controllers/systems": "sampled tuning",
    "controllers/user_step": "step_objects",
    "design/": "tuning limits",
    "design/catalogue": "simulation_controllers scenarios",
    "design/compensators": "limits",
    "design/decomposition": "stabilizing",
    "design/envelope": "envelope",
    "design/envelope_tuning": "envelope seeking",
    "design/judging": "envelope seeking",
    "design/limits": "limits",
    "design/schedule": "tuning simulation_controllers",
    "design/stabilizing": "stabilizing",
    "model/linearization": "numeric",
    "loop/": "loop_oracles",
    "loop/batch": "loop_batch",
    "loop/certificate": "loop_oracles limits",
    "loop/bounded": "sampled limits",
    "loop/crossings": "loop_oracles systems",
    "loop/quasi": "limits seeking",
    "loop/responses": "systems",
    "loop/rational": "systems loop_oracles",
    "loop/sampled": "sampled systems",
    "model/numeric": "numeric laws",
    "model/plant": "numeric",
    "identification/": "logs identification identification_command",
    "identification/cleaning": "logs",
    "identification/logs": "logs",
    "identification/observed": "identification logs",
    "identification/observer": "observer",
    "identification/prediction": "identification logs virtual_rig",
    "identification/results": "identification identification_command",
    "identification/virtual_rig": "virtual_rig observer",
    "paper/": "reproduction",
    "paper/errata": "sliding_code",
    "paper/printed": "sliding_code",
    "sliding/": "sliding_code",
    "sliding/derivation": "sliding_code verification",
    "sliding/predictive": "predictive_derivation",
    "verification/": "verification",
    "verification/actuator_effects": "sliding_verification",
    "verification/fixed_step": "verification sliding_verification",
    "verification/joint_verification": "sliding_verification verification",
    "verification/boxes": "predictive_verification",
    "verification/no_lock": "predictive_verification",
    "verification/predictive": "predictive_verification",
    "verification/relay_loop": "sliding_verification",
    "simulation/": "scenarios simulation_engine",
    "simulation/campaign/": "campaign",
    "simulation/bound": "simulation_engine seeking",
    "simulation/kernel": "simulation_engine",
    "simulation/population": "population",
    "simulation/run": "simulation_engine step_objects",
}
"""Tests of a module, of the longest key that its path begins with; those that notice most come first."""

LEFT_OUT = "committed or no_pi_beats"
"""Tests that are not run: any change of a statement makes the first fail, the last takes long."""

SWAPPED: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    **{ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,), ast.Pow: (ast.Mult,)},
    **{ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.Lt), ast.GtE: (ast.Gt, ast.Lt)},
    **{ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,)},
    **{ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.And: (ast.Or,), ast.Or: (ast.And,)},
    **{ast.FloorDiv: (ast.Mult,), ast.Mod: (ast.Mult,), ast.USub: (ast.UAdd,)},
}
DELETED = (ast.Expr, ast.AugAssign, ast.Raise, ast.Continue, ast.Break)
WORDS = ("__repr__", "__str__", "__all__")


@dataclass(frozen=True)
class Mutant:
    path: str
    line: int
    start: int
    end: int
    text: str

    def put_into(self, content: bytes) -> bytes:
        """The module with the fault."""
        return content[: self.start] + self.text.encode() + content[self.end :]

    def lines(self, content: bytes) -> tuple[str, str]:
        first, last = content.rfind(b"\n", 0, self.start) + 1, content.find(b"\n", self.end)
        after = content[first : self.start] + self.text.encode() + content[self.end : last]
        return content[first:last].decode().strip(), after.decode().strip()


def mutants(path: str, content: bytes) -> list[Mutant]:
    begins = [0]
    for line in content.splitlines(keepends=True):
        begins.append(begins[-1] + len(line))
    return [
        Mutant(path, node.lineno, begins[node.lineno - 1] + node.col_offset,
               begins[node.end_lineno - 1] + node.end_col_offset,
               ast.unparse(wrong) if isinstance(wrong, ast.stmt) else f"({ast.unparse(wrong)})")
        for node, wrong in faults(ast.parse(content))
    ]  # fmt: skip


def faults(node: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    if _words(node):
        return
    yield from _of_its_own(node)
    if isinstance(node, ast.Raise):
        return
    for name, value in ast.iter_fields(node):
        if name not in ("annotation", "returns", "decorator_list"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from faults(child)


def _words(node: ast.AST) -> bool:
    match node:
        case ast.JoinedStr() | ast.Assert() | ast.Expr(ast.Constant()) | ast.keyword("strict"):
            return True
        case ast.Expr():
            return "logger." in ast.unparse(node)
        case ast.If(test):
            return "TYPE_CHECKING" in ast.unparse(test)
        case ast.Assign([ast.Name(name)]) | ast.FunctionDef(name):
            return name in WORDS
    return False


def _of_its_own(node: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    if isinstance(node, DELETED) or (
        isinstance(node, ast.Assign) and not isinstance(node.targets[0], ast.Name | ast.Tuple)
    ):
        yield node, ast.Pass()
    if isinstance(node, ast.Compare):
        for place, operator in enumerate(node.ops):
            for other in SWAPPED[type(operator)]:
                yield node, _with(node, ops=[*node.ops[:place], other(), *node.ops[place + 1 :]])
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield node, _with(node, value=_another(node.value))
    for other in SWAPPED.get(type(getattr(node, "op", None)), ()):
        yield node, _with(node, op=other())
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield node, node.operand
    conditions = [node.test] if isinstance(node, ast.If | ast.IfExp | ast.While) else getattr(node, "ifs", [])
    for test in conditions:
        if isinstance(test, ast.Name | ast.Call | ast.Attribute):
            yield test, ast.UnaryOp(ast.Not(), test)


def _another(value: float) -> float:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1 if value < 10 else value // 2
    return value + 1.0 if value < 1.0 else 2.0 * value


def _with(node: ast.AST, **changed: object) -> ast.AST:
    other = copy.copy(node)
    for name, value in changed.items():
        setattr(other, name, value)
    return other


def prepare(folder: Path) -> None:
    mine = folder / str(os.getpid())
    kernels = user_cache_path(PACKAGE) / "kernels"  # those of the package as it is need not be compiled again
    if kernels.is_dir():
        shutil.copytree(kernels, folder / "kernels", dirs_exist_ok=True)
    shutil.copytree(ROOT, mine, ignore=shutil.ignore_patterns(".*", "__pycache__", "_build"))
    os.chdir(mine)
    os.environ.update(PYTHONPATH=str(mine), RAILSLIP_CACHE=str(folder), HYPOTHESIS_PROFILE="mutants")
    sys.path[:0] = [str(mine)]
    sys.dont_write_bytecode = False


def survives(mutant: Mutant, tests: tuple[str, ...], limit: int) -> bool:
    module = Path(PACKAGE) / mutant.path
    content = module.read_bytes()
    _write(module, mutant.put_into(content))
    try:
        return run(tests, limit)[0]
    finally:
        _write(module, content)


def _write(module: Path, content: bytes) -> None:
    Path(importlib.util.cache_from_source(module)).unlink(missing_ok=True)  # else taken if of equal size and second
    module.write_bytes(content)


def run(tests: tuple[str, ...], limit: int = 3600) -> tuple[bool, float]:
    child = os.fork()
    if not child:
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
            resource.setrlimit(resource.RLIMIT_DATA, (4 << 30, 4 << 30))  # a fault may ask for all the memory there is
            signal.alarm(20 * limit)
            for stream in (1, 2):
                os.dup2(os.open("output", os.O_WRONLY | os.O_CREAT | os.O_APPEND), stream)
            options = ["-xq", "-n0", "-pno:cacheprovider", f"-knot ({LEFT_OUT})"]
            failed = any(pytest.main([*options, test]) not in (0, 5) for test in tests)  # 5: no test
            sys.stdout.flush()
            os._exit(failed)
        finally:
            os._exit(1)
    _, status, used = os.wait4(child, 0)
    return status == 0, used.ru_utime + used.ru_stime


def limit_of(tests: tuple[str, ...]) -> int:
    passed, seconds = run(tests)
    if not passed:
        raise RuntimeError(Path("output").read_text())
    return 10 + round(3.0 * seconds)


def tests_of(path: str) -> tuple[str, ...]:
    """The test files of a module, most telling first."""
    room = max((room for room in ROOMS if path.startswith(room)), key=len)
    return tuple(f"tests/test_{name}.py" for name in ROOMS[room].split())


def sample(rooms: list[str], size: int, seed: int) -> list[Mutant]:
    found: dict[str, Mutant] = {}
    for module in sorted((ROOT / PACKAGE).rglob("*.py")):
        path, content = module.relative_to(ROOT / PACKAGE).as_posix(), module.read_bytes()
        if path.startswith(tuple(rooms)) and "_generated" not in path:
            for mutant in mutants(path, content):
                key = f"{seed} {path} {mutant.lines(content)}"
                found[hashlib.sha256(key.encode()).hexdigest()] = mutant
    return [found[key] for key in sorted(found)[:size]]


def main() -> None:
    """Print each survivor, and how many were noticed; exit status 1 if these are not enough."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", nargs="+", help="what the modules' paths below the package begin with: plant, design/")
    parser.add_argument("--sample", type=int, default=40, help="faults at most")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    chosen = sample(arguments.rooms, arguments.sample, arguments.seed)
    of_each, survivors = [tests_of(mutant.path) for mutant in chosen], 0
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(arguments.jobs, multiprocessing.get_context("fork"), prepare, (Path(folder),)) as pool,
    ):
        suites = sorted(set(of_each))
        limits = dict(zip(suites, pool.map(limit_of, suites), strict=True))
        for mutant, survived in zip(chosen, pool.map(survives, chosen, of_each, map(limits.get, of_each)), strict=True):
            if survived:
                survivors += 1
                before, after = mutant.lines((ROOT / PACKAGE / mutant.path).read_bytes())
                print(f"{mutant.path}:{mutant.line}\n  - {before}\n  + {after}", flush=True)
    print(f"{' '.join(arguments.rooms)}: {len(chosen) - survivors} of {len(chosen)} noticed")
    sys.exit(survivors > (1.0 - ENOUGH) * len(chosen))


if __name__ == "__main__":
    main()
