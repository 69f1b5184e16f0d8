"""ROS's own checks, where they are installed, and that `colcon test` runs the tests."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("tss_ros", "tests", "setup_tools", "launch", "setup.py")
#: Rules about docstrings that ruff's rules and numpydoc's form stand for.
DOCSTRINGS = ("D105", "D107", "D202", "D205", "D210", "D300", "D400", "D401", "D403", "D413")


@pytest.fixture(autouse=True)
def in_the_checkout(monkeypatch):
    monkeypatch.chdir(ROOT)


def ament(name):
    """One of ROS's checks, or the reason why the test is skipped."""
    return pytest.importorskip(f"ament_{name}.main", reason=f"ament_{name} is not installed")


def test_copyright():
    """The license stands in one file, which covers all others."""
    assert ament("copyright").main(["LICENSE"]) == 0


def test_flake8():
    status, errors = ament("flake8").main_with_errors(["--config", "setup.cfg", *FOLDERS])
    assert status == 0, errors


def test_pep257():
    options = ["--convention", "numpy", "--add-ignore", *DOCSTRINGS, "--"]
    assert ament("pep257").main([*options, "tss_ros", "launch", "setup.py"]) == 0


def test_xmllint():
    check = ament("xmllint").main
    if not shutil.which("xmllint"):
        pytest.skip("xmllint is not installed")
    files = ["package.xml", "msg_configs/tss_interfaces/package.xml"]
    files += ["msg_configs/simulation_interfaces/package.xml", "launch/review.launch.xml"]
    assert check(files) == 0


def test_colcon_runs_the_tests(tmp_path):
    """One file of them, as this is one of them."""
    command = ["colcon", "--log-base", str(tmp_path / "log"), "test", "--base-paths", "."]
    command += ["msg_configs", "--packages-select", "tss_ros", "--test-result-base", str(tmp_path)]
    command += ["--event-handlers", "console_direct+"]
    command += ["--pytest-args", "tests/project/test_house.py"]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert shown.returncode == 0, shown.stdout + shown.stderr
    assert int(re.search(r"(\d+) passed", shown.stdout)[1]) > 100
