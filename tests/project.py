"""The project's folder and its scripts, for the tests that run them."""

import importlib.util
import inspect
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text("utf-8")


def script(path: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(Path(path).stem, ROOT / path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def changed(record: Any, **fields: Any) -> Any:
    return type(record)(**dict(record) | fields)


def recipe(name: str) -> str:
    (text,) = re.findall(rf"^```\w+ file={re.escape(name)}\n(.*?)^```$", CONTRIBUTING, flags=re.M | re.S)
    return text


def show(module: ModuleType, result: object, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "run", lambda *_, **__: result)
    monkeypatch.setattr(sys, "argv", [f"{module.__name__}.py", str(folder)])
    module.main(*([[str(folder)]] if inspect.signature(module.main).parameters else []))


def refused(result: tuple[int, str, str]) -> str:
    """The one line of an error, of what the fixture `railslip` gives: exit status 2, and nothing on standard output."""
    status, out, err = result
    assert (status, out) == (2, "")
    assert err.startswith("railslip: error: ")
    assert err.count("\n") == 1
    return err
