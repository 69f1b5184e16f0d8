"""The set-up: prerequisites, locks, activation, the minimal `ros2`, and who may import whom."""

import fcntl
import importlib.metadata
import importlib.util
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import termios
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import grimp
import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement

from tss_ros.executables import EXECUTABLES

ROOT = Path(__file__).resolve().parents[2]
ROS2 = ROOT / "setup_tools" / "ros2"
PYTHONS = ("3.10", "3.11", "3.12", "3.13")

_spec = importlib.util.spec_from_file_location("workspace", ROOT / "setup_tools" / "workspace.py")
workspace = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(workspace)


def run(*command, **options):
    return subprocess.run(command, capture_output=True, text=True, timeout=60, **options)


# ---------------------------------------------------------------- who may import whom, and style


def test_import_contracts():
    check = run("lint-imports", "--no-cache", cwd=ROOT)
    assert check.returncode == 0, check.stdout


def test_core_imports_numpy_scipy_numba_and_llvmlite_only():
    graph = grimp.build_graph("tss_ros", include_external_packages=True, cache_dir=None)
    core = {"tss_ros.core"} | graph.find_descendants("tss_ros.core")
    assert len(core) > 1
    core |= {"tss_ros.extras"}  # words on what is not installed
    imported = set().union(*(graph.find_modules_directly_imported_by(m) for m in core)) - core
    assert imported - sys.stdlib_module_names <= {"numpy", "scipy", "numba", "llvmlite"}


def test_code_passes_ruff():
    check = run("ruff", "check", "--no-cache", "--output-format", "concise", cwd=ROOT)
    assert check.returncode == 0, check.stdout


# ---------------------------------------------------------------- metadata and locks


def read_lock(name, python):
    """Return {package: version} of a lock file's lines that hold on Linux for a Python version."""
    environment = {**default_environment(), "python_version": python, "sys_platform": "linux"}
    environment["python_full_version"] = python + ".5"
    pins = {}
    for line in (ROOT / "requirements" / name).read_text().splitlines():
        if line.startswith("#"):
            continue
        requirement = Requirement(line)  # a URL or an option would not parse or have no specifier
        (pin,) = requirement.specifier
        assert pin.operator == "==" and requirement.url is None, line
        if requirement.marker is None or requirement.marker.evaluate(environment):
            assert requirement.name not in pins, f"{name}: two pins of {requirement.name}"
            pins[requirement.name] = pin.version
    return pins


@pytest.mark.parametrize("python", PYTHONS)
def test_lock_covers_what_the_package_requires(python):
    pins = {}
    for lock in ("docs.txt", "ros.txt", "python.txt"):
        pins |= {name.lower(): version for name, version in read_lock(lock, python).items()}
    requirements = [Requirement(line) for line in importlib.metadata.requires("tss_ros")]
    names = {requirement.name for requirement in requirements}
    assert {"numpy", "mcap", "pytest", "sphinx"} <= names
    for requirement in requirements:
        assert pins[requirement.name.lower()] in requirement.specifier, requirement


@pytest.mark.parametrize("python", PYTHONS)
def test_the_two_locks_agree(python):
    pins, ros_pins = read_lock("python.txt", python), read_lock("ros.txt", python)
    assert "ros-jazzy-rclpy" in ros_pins
    for name in pins.keys() & ros_pins.keys():
        assert pins[name] == ros_pins[name]


def test_versions_and_executables_agree():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    assert package.findtext("version") == importlib.metadata.version("tss_ros")
    # colcon's own; pip may have left another one in the checkout
    built = importlib.metadata.distributions(name="tss_ros", path=[str(ROOT / "build/tss_ros")])
    scripts = next(iter(built)).entry_points
    assert scripts.names == EXECUTABLES.keys()
    for script in scripts:
        assert callable(script.load())
        assert os.access(ROOT / "install/tss_ros/lib/tss_ros" / script.name, os.X_OK)


# ---------------------------------------------------------------- prerequisites and ROS installs


def ros_prefix(folder, python="3.12"):
    (folder / f"lib/python{python}/site-packages/rclpy").mkdir(parents=True)
    return {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": str(folder)}


def test_sourced_ros_is_found_and_brings_its_own_packages(tmp_path):
    ros = workspace.find_ros(ros_prefix(tmp_path))
    assert (ros.prefix, ros.python) == (tmp_path, (3, 12))
    assert [lock.name for lock in workspace.locks(ros)] == ["python.txt"]
    own = ["simulation_interfaces", "tss_interfaces"]
    assert workspace.interface_packages(ros) == workspace.interface_packages(None) == own
    (tmp_path / "share" / "simulation_interfaces").mkdir(parents=True)
    assert workspace.interface_packages(ros) == ["tss_interfaces"]
    assert [lock.name for lock in workspace.locks(None)] == ["python.txt", "ros.txt"]


def test_an_installed_simulation_interfaces_is_not_hidden(tmp_path, monkeypatch):
    """What colcon is told to build, and what is left of an earlier build."""
    monkeypatch.setattr(workspace, "ROOT", tmp_path / "checkout")
    earlier = tmp_path / "checkout" / "install" / "simulation_interfaces"
    earlier.mkdir(parents=True)
    (told,) = answered(workspace.build_packages(None))
    assert earlier.exists() and "simulation_interfaces" in told and "-DPYTHON_ONLY=ON" in told
    environ = ros_prefix(tmp_path / "ros")
    (tmp_path / "ros" / "share" / "simulation_interfaces").mkdir(parents=True)
    (told,) = answered(workspace.build_packages(workspace.find_ros(environ)))
    assert not earlier.exists() and " tss_interfaces " in told and "-DPYTHON_ONLY=OFF" in told
    assert "simulation_interfaces" not in told


def test_own_prefixes_are_no_ros_install():
    own = f"{ROOT}/install/tss_ros:{ROOT}/.venv"
    assert workspace.find_ros({"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": own}) is None
    assert workspace.find_ros({"AMENT_PREFIX_PATH": own}) is None
    assert workspace.find_ros({}) is None


@pytest.fixture
def checkout(tmp_path):
    """A copy of this checkout's set-up in which nothing has been built, and a bare PATH for it."""
    for name in ("setup_tools", "requirements", "msg_configs"):
        shutil.copytree(ROOT / name, tmp_path / "checkout" / name)
    for name in ("package.xml", "setup.py", "setup.cfg", "activate"):
        shutil.copy(ROOT / name, tmp_path / "checkout" / name)
    (tmp_path / "bin").mkdir()
    for tool in ("sh", "dirname"):
        (tmp_path / "bin" / tool).symlink_to(shutil.which(tool))
    return tmp_path / "checkout"


def refusal(checkout, tools=(), **environ):
    """Return the one line with which the set-up refuses, given `tools` on PATH."""
    bare = checkout.parent / "bin"
    for tool in tools:
        (bare / tool).symlink_to("/bin/true")
    check = run(checkout / "setup_tools" / "setup", "make", env={"PATH": str(bare), **environ})
    assert check.returncode != 0 and not (checkout / ".venv").exists()
    assert check.stdout == "" and check.stderr.count("\n") == 1, check.stdout + check.stderr
    return check.stderr


def test_missing_python_is_named(checkout):
    assert "sudo apt install python3 python3-venv python3-dev" in refusal(checkout)


@pytest.mark.parametrize(
    ("tools", "missing"),
    [([], "C compiler"), (["gcc"], "C++ compiler"), (["gcc", "g++"], "make")],
)
def test_missing_build_tool_is_named(checkout, tools, missing):
    line = refusal(checkout, tools, PYTHON=os.path.realpath(sys.executable))
    assert f"no {missing} found" in line and "sudo apt install build-essential" in line


def test_other_ros_distribution_is_refused(checkout):
    line = refusal(checkout, PYTHON=os.path.realpath(sys.executable), ROS_DISTRO="humble")
    assert "humble" in line and "source /opt/ros/jazzy/setup.bash" in line


def test_ros_without_rclpy_is_refused(checkout, tmp_path):
    environ = {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": str(tmp_path / "opt")}
    line = refusal(checkout, PYTHON=os.path.realpath(sys.executable), **environ)
    assert "sudo apt install ros-jazzy-ros-base" in line


def test_python_of_the_ros_install_is_asked_for(checkout, tmp_path):
    environ = ros_prefix(tmp_path / "opt", python="3.99")
    line = refusal(checkout, PYTHON=os.path.realpath(sys.executable), **environ)
    assert "sudo apt install python3.99" in line


@pytest.mark.parametrize(
    ("version", "machine", "expected"),
    [
        ((3, 9), "Linux x86_64", "python3.9 does not run tss_ros, 3.10 to 3.13 do: sudo apt"),
        ((3, 14), "Linux x86_64", "python3.14 does not run tss_ros, 3.10 to 3.13 do: sudo apt"),
        ((3, 12), "Linux aarch64", "this is Linux aarch64: install ROS 2 Jazzy (sudo apt"),
        ((3, 12), "Darwin x86_64", "this is Darwin x86_64: install ROS 2 Jazzy"),
    ],
)
def test_unsupported_platform_is_named(version, machine, expected):
    with pytest.raises(workspace.SetupError, match=re.escape(expected)):
        workspace.check_prerequisites(None, os.environ, version, machine)


@pytest.mark.parametrize(
    ("module", "package"), [("ensurepip", "venv"), ("venv", "venv"), (None, "dev")]
)
def test_missing_part_of_python_is_named(monkeypatch, tmp_path, module, package):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == module else find_spec(name)
    )
    monkeypatch.setattr(workspace.sysconfig, "get_config_var", lambda _: str(tmp_path))
    with pytest.raises(workspace.SetupError, match=f"sudo apt install python3.12-{package}$"):
        workspace.check_prerequisites(None, os.environ, (3, 12), "Linux x86_64")


# ---------------------------------------------------------------- steps


@pytest.fixture
def empty_checkout(monkeypatch, tmp_path):
    """The set-up for a checkout with nothing in it."""
    monkeypatch.setattr(workspace, "ROOT", tmp_path)
    monkeypatch.setattr(workspace, "VENV", tmp_path / ".venv")
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    (tmp_path / ".venv" / "bin" / "python").symlink_to(sys.executable)
    return tmp_path


def told(commands):
    alone = [command[0] if isinstance(command, tuple) else command for command in commands]
    return [" ".join(map(str, command)) for command in alone]


def answered(generator, *statuses):
    """The commands of a step whose commands end with these statuses."""
    return told([next(generator), *(generator.send(status) for status in statuses)])


def test_packages_come_by_uv_where_it_is_to_be_had(empty_checkout):
    steps = answered(workspace.install_packages(None), 0, 0, 0)
    assert "-m venv --clear" in steps[0] and steps[1].endswith(workspace.UV)
    assert "pip install --no-deps" in steps[1]
    for step in steps[2:]:
        assert "/bin/uv pip install" in step and "--no-deps" in step
    assert "ros.txt" in steps[3] and "--only-binary :all: --no-binary empy" in steps[3]


@pytest.mark.parametrize("statuses", [(0, 1), (0, 0, 1), (0, 0, 0, 2)])
def test_packages_come_by_pip_where_uv_fails(empty_checkout, statuses):
    steps = answered(workspace.install_packages(None), *statuses, 0)
    assert "uv" in steps[1] and all("-m pip install" in step for step in steps[-2:])
    assert "--ignore-installed" in steps[-1] and "ros.txt" in steps[-1]


def test_beside_a_ros_install_packages_come_by_pip(empty_checkout, tmp_path):
    ros = workspace.RosInstall(tmp_path, (3, 12), [tmp_path])
    steps = answered(workspace.install_packages(ros), 0, 0)
    assert not [step for step in steps if "uv" in step.split("/")[-1]]
    assert "--system-site-packages" in steps[0] and "ros.txt" not in steps[2]


def test_what_pip_is_told_uv_is_told(monkeypatch, tmp_path):
    (tmp_path / "pip.conf").write_text(
        "[global]\nindex-url = https://a.example/simple\n"
        "extra-index-url = https://b.example/simple\n    file:///c\n"
        "find-links = /old\ncert = /cert.pem\ntrusted-host = a.example\n"
    )
    for name in [name for name in os.environ if name.startswith(("PIP_", "UV_", "SSL_"))]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("PIP_CONFIG_FILE", str(tmp_path / "pip.conf"))
    monkeypatch.setenv("PIP_FIND_LINKS", "/wheels /more")
    monkeypatch.setenv("UV_HTTP_TIMEOUT", "5")
    settings = {**workspace.pip_settings(), "timeout": ["60"]}
    assert workspace.uv_settings(settings) == {
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "UV_DEFAULT_INDEX": "https://a.example/simple",
        "UV_INDEX": "https://b.example/simple file:///c",
        "UV_FIND_LINKS": "/wheels,/more",
        "SSL_CERT_FILE": "/cert.pem",
        "UV_INSECURE_HOST": "a.example",
    }


def test_corrected_files_are_no_longer_those_of_uvs_cache(empty_checkout):
    cached = empty_checkout / "cached.cmake"
    cached.write_text('"/opt/python/cp311-cp311/include/python3.11"')
    numpy = empty_checkout / ".venv/lib/python3.11/site-packages/numpy/_core/include"
    numpy.mkdir(parents=True)
    (empty_checkout / ".venv/share").mkdir()
    used = empty_checkout / ".venv/share/used.cmake"
    os.link(cached, used)
    workspace.correct_exported_paths()
    assert "/opt/python" not in used.read_text()
    assert "/opt/python" in cached.read_text()


def say_and_end(seconds, status):
    yield ["sh", "-c", f"echo 40 %; sleep {seconds}; exit {status}"]


def step(title, seconds, commands):
    return workspace.Step(title, f"{title}.log", seconds, commands, workspace.kernels_share)


def test_steps_run_side_by_side_and_are_never_silent_for_long(empty_checkout, capsys):
    steps = [step("one", 10, say_and_end(3, 0)), step("two", 30, say_and_end(3.5, 0))]
    workspace.carry_out(steps, workspace.Progress(steps), dict(os.environ))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) >= 3
    assert re.fullmatch(r"tss_ros:  40 %, about \d+ s left: one 40 %, two 40 %", lines[1])
    assert re.fullmatch(
        r"tss_ros: 100 %, about 0 s left: one done in \d+ s, two done in \d+ s", lines[-1]
    )


def test_a_step_that_fails_ends_the_other_and_shows_its_log(empty_checkout, capsys):
    def fail():
        workspace.demand((yield ["sh", "-c", "echo reason; exit 3"]))

    steps = [step("long", 10, say_and_end(60, 0)), step("bad", 1, fail())]
    begun = time.monotonic()
    with pytest.raises(workspace.SetupError, match="bad failed; the whole output is in .*bad.log"):
        workspace.carry_out(steps, workspace.Progress(steps), dict(os.environ))
    assert time.monotonic() - begun < 50
    assert capsys.readouterr().err.strip() == "reason"
    assert not any(s.ended for s in steps)


# ---------------------------------------------------------------- the workspace in use


def test_second_set_up_does_nothing():
    if not all(
        workspace.is_current(*s) for s in workspace.wanted_stamps(workspace.find_ros(os.environ))
    ):
        pytest.skip("edited since the last `make`")
    check = run(ROOT / "setup_tools" / "setup", "make")
    assert (check.returncode, check.stdout, check.stderr) == (0, "", "")


@pytest.mark.parametrize("given", [None, "SUBNET", "SYSTEM_DEFAULT"])
def test_activate_from_another_folder(tmp_path, given):
    environ = dict(os.environ)
    seen = given or "LOCALHOST"
    if "ROS_DISTRO" not in environ:
        environ = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    elif given == "SUBNET":
        seen = "LOCALHOST"  # Jazzy's own setup files set SUBNET
    environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = given or ""
    script = (
        f". {ROOT}/activate && python -c 'import rclpy, tss_ros, tss_interfaces.msg' && "
        "echo $ROS_AUTOMATIC_DISCOVERY_RANGE && ros2 run tss_ros nonesuch"
    )
    shell = run("bash", "-euc", script, env=environ, cwd=tmp_path)
    assert (shell.stdout, shell.stderr) == (f"{seen}\n", "No executable found\n")


# ---------------------------------------------------------------- the minimal ros2


@pytest.fixture
def package(tmp_path):
    """A prefix with the package `tools` in it; returns a function that calls the minimal ros2."""
    marker = tmp_path / "share/ament_index/resource_index/packages/tools"
    folder = tmp_path / "lib/tools"
    for path in (marker.parent, folder / "a", folder / "b", folder / ".hidden"):
        path.mkdir(parents=True)
    marker.touch()
    scripts = {
        "show": 'printf "<%s>" "$0" "$MARK" "$@"',
        "fail": "exit 7",
        "killed": "kill -KILL $$",
        "wait": "trap 'echo caught INT; exit 0' INT; trap 'echo caught TERM; exit 3' TERM; "
        "echo ready; while :; do sleep 0.05; done",
        "count": "trap 'echo INT' INT; trap 'exit 4' TERM; "
        "echo ready; while :; do sleep 0.05; done",
        "a/twice": "",
        "b/twice": "",
        ".hidden/secret": "",
    }
    for name, body in scripts.items():
        (folder / name).write_text(f"#!/bin/sh\n{body}\n")
        (folder / name).chmod(0o755)
    (folder / "data").write_text("not executable")

    def ros2(*arguments, start=run, path="/usr/bin:/bin", **environ):
        environ = {"PATH": path, "AMENT_PREFIX_PATH": f"/nonexistent:{tmp_path}", **environ}
        return start(sys.executable, "-S", ROS2, *arguments, env=environ)

    ros2.folder = tmp_path
    return ros2


def test_ros2_run_hands_over_arguments(package):
    shown = package("run", "tools", "show", "--ros-args", "-p", "x:=[1.0, 2.0]", "-h")
    path = package.folder / "lib/tools/show"
    assert shown.stdout == f"<{path}><><--ros-args><-p><x:=[1.0, 2.0]><-h>"
    assert shown.returncode == 0 and shown.stderr == ""


def test_ros2_run_prefix(package):
    shown = package("run", "--prefix", "env 'MARK=two words'", "tools", "show", "x")
    assert shown.stdout.endswith("<two words><x>")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nonesuch", "show"], "Package 'nonesuch' not found\n"),
        (["tools", "nonesuch"], "No executable found\n"),
        (["tools", "data"], "No executable found\n"),
        (["tools", "secret"], "No executable found\n"),
        (
            ["tools", "twice"],
            "Multiple executables found:\n- {0}/a/twice\n- {0}/b/twice\n",
        ),
    ],
)
def test_ros2_run_finds_as_upstream_does(package, arguments, message):
    refused = package("run", *arguments)
    assert refused.returncode == 1
    assert refused.stderr == message.format(package.folder / "lib/tools")


def test_ros2_run_reports_failure_as_upstream_does(package):
    failed = package("run", "tools", "fail")
    assert (failed.returncode, failed.stdout) == (7, "[ros2run]: Process exited with failure 7\n")
    killed = package("run", "tools", "killed")
    assert (killed.returncode, killed.stdout) == (256 - signal.SIGKILL, "[ros2run]: Killed\n")


@pytest.mark.parametrize(
    ("number", "name", "status"), [(signal.SIGINT, "INT", 0), (signal.SIGTERM, "TERM", 3)]
)
def test_ros2_run_passes_signals_on(package, number, name, status):
    def start(*command, env):
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env)

    process = package("run", "tools", "wait", start=start)
    with process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        output, _ = process.communicate(timeout=20)
    assert process.returncode == status
    assert f"caught {name}\n" in output and "[ros2run]: Received signal: " in output


def test_ctrl_c_of_a_terminal_comes_once(package):
    controller, terminal = pty.openpty()

    def start(*command, env):
        return subprocess.Popen(
            command,
            stdin=terminal,
            stdout=subprocess.PIPE,
            text=True,
            env=env,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )

    with package("run", "tools", "count", start=start) as process:
        assert process.stdout.readline() == "ready\n"
        os.write(controller, b"\x03")
        assert process.stdout.readline() == "INT\n"
        process.terminate()
        output, _ = process.communicate(timeout=20)
    os.close(controller)
    os.close(terminal)
    # Two that come at once may look like one, so what counts is that it was not passed on.
    assert process.returncode == 4 and "INT" not in output, output
    assert "Received signal:  Interrupt" not in output, output


def test_ros2_other_verbs_and_help(package):
    refused = package("topic", "list")
    assert refused.returncode == 1 and "ros-jazzy-ros2cli-common-extensions" in refused.stderr
    assert "'ros2 topic'" in refused.stderr
    for arguments in ([], ["-h"], ["run", "-h"]):
        shown = package(*arguments)
        assert shown.returncode == 0 and "usage: ros2" in shown.stdout
    assert package("run", "tools").returncode == 2


@pytest.fixture
def real_ros2(tmp_path):
    """A program that stands for the real ros2."""
    real = tmp_path / "real" / "ros2"
    real.parent.mkdir()
    real.write_text('#!/bin/sh\necho "real: $*"\nexit 5\n')
    real.chmod(0o755)
    return real


def test_ros2_gives_way_to_the_real_one(package, real_ros2):
    answer = package("topic", "list", path=f"{ROS2.parent}:{real_ros2.parent}:/usr/bin:/bin")
    assert (answer.returncode, answer.stdout) == (5, "real: topic list\n")


def test_minimal_ros2_is_placed_only_where_there_is_no_other(monkeypatch, tmp_path, real_ros2):
    target = tmp_path / "bin" / "ros2"
    target.parent.mkdir()
    monkeypatch.setattr(workspace, "VENV", tmp_path)
    without = {"PATH": f"{target.parent}:/usr/bin:/bin"}
    workspace.place_minimal_ros2(without)
    assert target.read_bytes() == ROS2.read_bytes() and os.access(target, os.X_OK)

    workspace.place_minimal_ros2({"PATH": f"{target.parent}:{real_ros2.parent}"})
    assert not target.exists()

    target.write_text("#!/bin/sh\n# installed by the user\n")
    workspace.place_minimal_ros2(without)
    assert "installed by the user" in target.read_text()
