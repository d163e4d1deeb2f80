"""Property tests draw the same examples on every run; HYPOTHESIS_PROFILE=explore draws new ones."""

import os
import subprocess
import sys

import pytest
from hypothesis import Phase, settings
from project import SMALL, script, show

from railslip_ctrl.cli import main

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None)
settings.register_profile("mutants", derandomize=True, deadline=None, phases=(Phase.explicit, Phase.generate))
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

LONGEST = (
    *("test_virtual_rig.py", "test_scripts.py", "html report", "test_seeking.py", "test_sliding_verification.py"),
    *("test_simulation_engine.py", "test_envelope.py", "test_tuning.py", "test_verification.py", "test_campaign.py"),
    *("test_identification_command.py", "test_docs.py", "test_logs.py"),
    *("test_controller_files.py", "test_help.py", "test_sliding_code.py", "test_plots.py", "test_sampled.py"),
)
"""The groups that take longest, first: one that begins last leaves the other workers with nothing to do."""

TOGETHER = dict.fromkeys(("test_design_report.py", "test_report_browser.py"), "html report")
"""Files that share a worker, for their fixture `full_report`."""


def group_of(nodeid):
    """A file's tests share a worker, so that what its fixtures work out is worked out once."""
    name = nodeid.partition("::")[0].rpartition("/")[2]
    return TOGETHER.get(name, name)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Whatever --dist says. That of `--dist loadgroup` groups nothing under pytest 9.2: xdist 3.8 sets `_nodeid`."""
    from xdist.scheduler import LoadScopeScheduling

    class ByGroup(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return group_of(nodeid)

    config.option.loadscopereorder = False  # the order is that below
    return ByGroup(config, log)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """The groups that take longest first."""
    order = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(group_of(item.nodeid), len(order)))


@pytest.fixture
def railslip(capsys):
    """Run the command in this process; gives (exit status, standard output, standard error)."""

    def run(*arguments):
        with pytest.raises(SystemExit) as caught:
            main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return caught.value.code, captured.out, captured.err

    return run


@pytest.fixture
def file(tmp_path, monkeypatch):
    """Write a file into the working folder, which is a temporary one; gives its name."""
    monkeypatch.chdir(tmp_path)

    def write(name, text):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return name

    return write


@pytest.fixture
def ran(tmp_path, capsys, monkeypatch):
    """Run a script of the project: what its `run` gives, what it prints of that, and the pictures it then draws."""

    def run(path, **given):
        module = script(path)
        result = module.run(**given)
        show(module, result, tmp_path, monkeypatch)
        return result, capsys.readouterr().out, {picture.name for picture in tmp_path.glob("*.png")}

    return run


@pytest.fixture(scope="module")
def without_lag_search():
    """Identification does not look for a column that is late: it takes most of the time, and has tests of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("railslip_ctrl.identification.identify.lag_of", lambda *_: None)
        yield


@pytest.fixture(autouse=True, scope="session")
def _figures_without_defects():
    """Every PNG that a test or a fixture saves, by a script or a command, is looked at as `figure_checks` does."""
    from figure_checks import defects

    from railslip_ctrl.report.plots import style

    saved = style.figure_bytes

    def looked_at(figure, form):
        content = saved(figure, form)
        assert form != "png" or defects(figure) == []  # an SVG is drawn at another size than the figure keeps
        return content

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "figure_bytes", looked_at)
        yield


@pytest.fixture(scope="session")
def full_report(tmp_path_factory):
    """The folder of `railslip report` run once as a user would, and what it printed: standard output and error.

    Files whose tests take it are in `TOGETHER`, so that it is made once.
    """
    folder = tmp_path_factory.mktemp("report") / "out"
    command = [sys.executable, "-m", "railslip_ctrl", "report", *SMALL, "--out", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=True)
    return folder, done.stdout, done.stderr
