"""The package as it is installed: a wheel, and the command out of it."""

import subprocess
import sys
import sysconfig
import venv
import zipfile

import pytest
from project import ROOT


@pytest.mark.long
def test_command_works_from_an_installed_wheel(tmp_path):
    built = tmp_path / "wheel"
    make = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", built, ROOT]
    subprocess.run(make, check=True, capture_output=True)
    (wheel,) = built.glob("railslip_ctrl-*.whl")
    files = set(zipfile.ZipFile(wheel).namelist())
    data = ("py.typed", "report/templates/report.html", "model/_generated/curve.py", "simulation/steps.py")
    assert {f"railslip_ctrl/{name}" for name in data} <= files
    environment = tmp_path / "environment"
    venv.create(environment, with_pip=False)
    scripts = environment / ("Scripts" if sys.platform == "win32" else "bin")
    (site,) = environment.glob("lib/python*/site-packages")
    # the dependencies of this environment, but not the project's own source tree
    (site / "dependencies.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    install = [sys.executable, "-m", "pip", f"--python={scripts / 'python'}", "install", "--quiet", "--no-deps"]
    install.append("--no-compile")  # of all modules, few of which are imported here
    subprocess.run([*install, "--force-reinstall", "--no-index", wheel], check=True, capture_output=True)
    where = [scripts / "python", "-c", "import railslip_ctrl; print(railslip_ctrl.__file__)"]
    imported = subprocess.run(where, check=True, capture_output=True, text=True, cwd=tmp_path).stdout
    assert imported.startswith(str(site))
    command = [scripts / "railslip", "margins", "--rail", "dry", "--kp", "190", "--ki", "5"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "stable but fragile" in done.stdout
    words = [scripts / "railslip", "report", "--no-html", "--rail", "wet"]
    report = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert report.returncode == 0
    assert (tmp_path / "railslip-report" / "loop.svg").exists()
