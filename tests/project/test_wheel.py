"""The wheel that pip makes: its metadata, its one command, and what it does without the extras."""

import importlib.metadata
import subprocess
import sys
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tss_ros.executables import EXECUTABLES, WITHOUT_ROS
from tss_ros.extras import EXTRAS
from tss_ros.scenarios.scenario import shipped

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    (folder / "source").mkdir()
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    for name in listed.stdout.splitlines():  # pip would leave its build in the checkout
        if (ROOT / name).is_file() and not name.startswith(("docs/", "tests/")):
            path = folder / "source" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes((ROOT / name).read_bytes())
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index"]
    made = subprocess.run(
        [*pip, "-w", str(folder), str(folder / "source")], capture_output=True, text=True
    )
    assert made.returncode == 0, made.stderr
    (path,) = folder.glob("*.whl")
    return zipfile.ZipFile(path)


def read(wheel, name):
    (path,) = [path for path in wheel.namelist() if path.endswith(name)]
    return wheel.read(path).decode()


def test_it_has_one_command(wheel):
    assert read(wheel, "entry_points.txt").split("\n", 1) == [
        "[console_scripts]", "tss = tss_ros.__main__:main\n"
    ]  # fmt: skip
    assert not [name for name in wheel.namelist() if "/scripts/" in name or "data/bin" in name]


def test_its_metadata_could_be_published(wheel):
    metadata = Parser().parsestr(read(wheel, "METADATA"))
    assert metadata["Name"] == "tss_ros" and metadata["License"] == "Apache-2.0"
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert metadata.get_payload().startswith("# tss_ros")
    classifiers = metadata.get_all("Classifier")
    assert "Typing :: Typed" in classifiers and len(classifiers) > 8
    assert {"all", "cluster", "docs", "plots", "review", "ros", "tables"} <= set(
        metadata.get_all("Provides-Extra")
    )
    assert metadata["Project-URL"]


def test_it_has_types_scenarios_and_settings(wheel):
    names = set(wheel.namelist())
    assert "tss_ros/py.typed" in names and "tss_ros/ros/loopback.xml" in names
    assert {f"tss_ros/scenarios/{name}.yaml" for name in shipped()} <= names


def test_every_extra_that_advice_names_brings_its_package(wheel):
    metadata = Parser().parsestr(read(wheel, "METADATA"))
    brought = importlib.metadata.packages_distributions()
    required = [Requirement(text) for text in metadata.get_all("Requires-Dist")]
    for package, extra in EXTRAS.items():
        names = {
            r.name.lower() for r in required if r.marker and r.marker.evaluate({"extra": extra})
        }
        assert names & {name.lower() for name in brought[package]}, package


@pytest.fixture(scope="module")
def bare(wheel, tmp_path_factory):
    """A function that runs Python with the wheel and what it requires, and nothing else."""
    folder = tmp_path_factory.mktemp("bare")
    wheel.extractall(folder)
    metadata = Parser().parsestr(read(wheel, "METADATA"))
    wanted, seen = list(metadata.get_all("Requires-Dist")), set()
    while wanted:
        requirement = Requirement(wanted.pop())
        if requirement.marker and not requirement.marker.evaluate({"extra": ""}):
            continue
        if requirement.name not in seen:
            seen.add(requirement.name)
            distribution = importlib.metadata.distribution(requirement.name)
            wanted += distribution.requires or []
            for top in {file.parts[0] for file in distribution.files}:
                if top not in ("..", "__pycache__"):
                    (folder / top).symlink_to(distribution.locate_file(top))

    def run(*words):
        command = [sys.executable, "-S", *words]
        environ = {"PYTHONPATH": str(folder), "PATH": "/usr/bin:/bin", "HOME": str(folder)}
        return subprocess.run(command, env=environ, capture_output=True, text=True, timeout=120)

    return run


@pytest.mark.parametrize(
    ("words", "package", "extra"),
    [
        (["sweep", "--rates", "-3", "-2", "2"], "pyarrow", "tables"),
        (["follow", "--from=-3", "--to=-2"], "pyarrow", "tables"),
        (["review", "bag"], "rerun", "review"),
    ],
)
def test_a_command_names_the_extra_that_it_needs(bare, words, package, extra):
    refused = bare("-m", "tss_ros", *words)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert refused.stderr == (
        f"{words[0]}: needs {package}, which is not installed: pip install 'tss_ros[{extra}]'\n"
    )


@pytest.mark.parametrize("name", sorted(EXECUTABLES.keys() - WITHOUT_ROS))
def test_an_executable_that_needs_ros_says_so_in_a_line(bare, name):
    code = "import sys; from tss_ros import executables; sys.exit(executables.run(sys.argv[1]))"
    refused = bare("-c", code, name)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert refused.stderr.startswith(f"{name}: needs ROS 2, and its package rclpy is not found: ")
    assert refused.stderr.count("\n") == 1


def test_the_core_scenarios_and_bags_need_no_extra(bare):
    code = "import tss_ros.core as c, tss_ros.bags.recording, tss_ros.scenarios.scenario as s\n"
    code += "print(s.load('three_star').build().n, c.ring(5).n)"
    assert bare("-c", code).stdout == "3 5\n"
    assert bare("-m", "tss_ros", "verify", "no_bag").stderr.startswith("tss verify: ")
    figure = bare("-c", "from tss_ros import plots; plots.deviation")
    assert figure.stderr.splitlines()[-1] == (
        "ModuleNotFoundError: tss_ros.plots needs matplotlib, which is not installed:"
        " pip install 'tss_ros[plots]'"
    )
