"""Property tests draw the same examples on every run; HYPOTHESIS_PROFILE=explore draws new ones."""

import os

import pytest
from hypothesis import Phase, settings
from project import script, show

from railslip_ctrl.cli import main

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None)
settings.register_profile("mutants", derandomize=True, deadline=None, phases=(Phase.explicit, Phase.generate))
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

LONGEST = (
    "virtual_rig scripts design_report seeking sliding_verification simulation_engine envelope tuning "
    "verification campaign identification_command docs logs scenarios help sliding_code sampled"
)
"""The files that take longest, first: one that begins last leaves the other workers with nothing to do."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    place = {f"test_{name}": i for i, name in enumerate(LONGEST.split())}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


@pytest.fixture
def railslip(capsys, monkeypatch):
    """Run the command in this process; returns exit status, standard output and standard error."""

    def interrupted(*_):
        raise KeyboardInterrupt

    def run(*arguments):
        if arguments[:1] == ("design",):
            monkeypatch.setattr("webbrowser.open", lambda address: None)
            monkeypatch.setattr("railslip_ctrl.page.server.PageServer.serve_forever", interrupted)
        with pytest.raises(SystemExit) as caught:
            main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return caught.value.code, captured.out, captured.err

    return run


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def write(name, text):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return name

    return write


@pytest.fixture
def ran(tmp_path, capsys, monkeypatch):
    def run(path, **given):
        module = script(path)
        result = module.run(**given)
        show(module, result, tmp_path, monkeypatch)
        return result, capsys.readouterr().out, {picture.name for picture in tmp_path.glob("*.png")}

    return run


@pytest.fixture(scope="module")
def without_lag_search():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("railslip_ctrl.identification.identify.lag_of", lambda *_, **__: None)
        yield


@pytest.fixture(autouse=True, scope="session")
def _figures_without_defects():
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
