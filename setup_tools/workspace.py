"""Makes the workspace of this checkout, .venv, build/ and install/, for `make` and `activate`.

Standard library only, and free of syntax that a Python too old for the project would stumble
over, so that it can still say what is wrong.
"""

import fcntl
import hashlib
import importlib.util
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
OLDEST, NEWEST = (3, 10), (3, 13)

PACKAGES_STAMP = VENV / ".stamp-packages"
BUILD_STAMP = ROOT / "install" / ".stamp-build"
WARM_STAMP = VENV / ".stamp-warm"


class SetupError(Exception):
    """The workspace cannot be made here; the message says in one line what to do about it."""


class RosInstall:
    """A sourced ROS 2 Jazzy: where it is, and the (major, minor) of the Python it is built for.

    `prefixes` are those of all workspaces that are sourced.
    """

    def __init__(self, prefix, python, prefixes):
        self.prefix = prefix
        self.python = python
        self.prefixes = prefixes


def find_ros(environ):
    """Return the RosInstall that `environ` has sourced, or None where there is none."""
    distro = environ.get("ROS_DISTRO", "")
    if distro not in ("", "jazzy"):
        raise SetupError(
            f"ROS_DISTRO is {distro}, but tss_ros runs on jazzy: source /opt/ros/jazzy/setup.bash, "
            "or use a shell with no ROS sourced"
        )
    # an activated shell has this checkout's own prefixes there as well
    prefixes = [Path(p) for p in environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    prefixes = [p for p in prefixes if ROOT not in p.resolve().parents]
    if not distro or not prefixes:
        return None
    for prefix in prefixes:
        for folder in sorted(prefix.glob("lib/python3.*/site-packages/rclpy")):
            return RosInstall(prefix, (3, int(folder.parts[-3].split(".")[1])), prefixes)
    raise SetupError(
        "ROS 2 Jazzy is sourced, but has no rclpy: sudo apt install ros-jazzy-ros-base"
    )


def check_prerequisites(ros, environ, version=sys.version_info[:2], machine=None):
    """Raise SetupError for the first thing that is missing and that only the user can install."""
    machine = machine or f"{platform.system()} {platform.machine()}"
    name = "python{}.{}".format(*version)
    if not OLDEST <= version <= NEWEST:
        raise SetupError(
            f"{name} does not run tss_ros, 3.10 to 3.13 do: sudo apt install python3.12 "
            "python3.12-venv python3.12-dev, then make PYTHON=python3.12"
        )
    if ros is None and machine != "Linux x86_64":
        raise SetupError(
            f"ROS 2 comes as wheels for Linux x86_64 only, and this is {machine}: install ROS 2 "
            "Jazzy (sudo apt install ros-jazzy-ros-base) and source it"
        )
    for module in ("venv", "ensurepip"):
        if importlib.util.find_spec(module) is None:
            raise SetupError(f"{name} has no module {module}: sudo apt install {name}-venv")
    if not Path(sysconfig.get_config_var("INCLUDEPY"), "Python.h").is_file():
        raise SetupError(f"the C headers of {name} are missing: sudo apt install {name}-dev")
    for what, variable, programs in (
        ("C compiler", "CC", ["cc", "gcc", "clang"]),
        ("C++ compiler", "CXX", ["c++", "g++", "clang++"]),
        ("make", "", ["make", "gmake"]),
    ):
        # CXX may hold arguments as well, as in "ccache g++"
        programs = shlex.split(environ.get(variable, ""))[:1] or programs
        if not any(shutil.which(program, path=environ.get("PATH")) for program in programs):
            raise SetupError(
                f"no {what} found ({', '.join(programs)}): sudo apt install build-essential"
            )


def locks(ros):
    """Return the lock files to install; a ROS install brings its own share of them."""
    names = ["python.txt"] if ros else ["python.txt", "ros.txt"]
    return [ROOT / "requirements" / name for name in names]


def interface_packages(ros):
    """Return the message packages to build: not simulation_interfaces where the real one is."""
    prefixes = ros.prefixes if ros else []
    installed = any((p / "share" / "simulation_interfaces").is_dir() for p in prefixes)
    return ["tss_interfaces"] if installed else ["simulation_interfaces", "tss_interfaces"]


def fingerprint(*parts):
    """Return a digest of strings and of files' names and contents."""
    digest = hashlib.sha256()
    for part in parts:
        content = part.read_bytes() if isinstance(part, Path) and part.is_file() else b""
        digest.update(f"{part}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def wanted_stamps(ros):
    """Return (stamp file, its content when up to date) for the three steps, in their order."""
    python = os.path.realpath(sys.executable)
    packages = fingerprint(python, str(ros.prefix) if ros else "wheels", *locks(ros))
    sources = [ROOT / name for name in ("package.xml", "setup.py", "setup.cfg")]
    for name in interface_packages(ros):
        sources += sorted((ROOT / "msg_configs" / name).rglob("*"))
    # the rest is linked into install/: names matter here, contents do not
    shared = ("msg_configs/*.yaml", "config/*", "launch/*", "layouts/*")
    names = sorted(path.name for pattern in shared for path in ROOT.glob(pattern))
    build = fingerprint(packages, *names, *sources)
    # numba, too, knows a source file by its time and size
    core = [(path, path.stat()) for path in sorted((ROOT / "tss_ros" / "core").rglob("*.py"))]
    warm = fingerprint(build, *(f"{path} {s.st_mtime_ns} {s.st_size}" for path, s in core))
    return [(PACKAGES_STAMP, packages), (BUILD_STAMP, build), (WARM_STAMP, warm)]


def is_current(stamp, content):
    """Tell whether a step has been carried out in the state that `content` stands for."""
    return stamp.is_file() and stamp.read_text() == content


def say(text):
    """Print one line of progress."""
    print("tss_ros: " + text, flush=True)


def run(title, log_name, commands, env):
    """Run commands one after the other, output into a log; show now and then where they are."""
    log_path = ROOT / "log" / log_name
    log_path.parent.mkdir(exist_ok=True)
    start = time.monotonic()
    say(title)
    with open(log_path, "wb") as log:
        for command in commands:
            process = subprocess.Popen(
                command, cwd=ROOT, env=env, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
            while process.poll() is None:
                try:
                    process.wait(timeout=10)
                except subprocess.TimeoutExpired:
                    line = log_path.read_text(errors="replace").rstrip().rpartition("\n")[2]
                    say(f"  {time.monotonic() - start:3.0f} s  {line.strip()[:80]}".rstrip())
            if process.returncode != 0:
                print(log_path.read_text(errors="replace")[-3000:], file=sys.stderr)
                raise SetupError(f"{title} failed; its whole output is in {log_path}")
    say(f"  {time.monotonic() - start:3.0f} s  done")


def environment(ros):
    """Return the environment in which the tools of .venv install and build."""
    left_out = ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")
    env = {name: value for name, value in os.environ.items() if name not in left_out}
    env["VIRTUAL_ENV"] = str(VENV)
    env["PYTHONUNBUFFERED"] = "1"  # so that logs show at once how far things are
    env["PATH"] = os.pathsep.join([str(VENV / "bin"), env.get("PATH", os.defpath)])
    if ros is None:
        env["AMENT_PREFIX_PATH"] = env["CMAKE_PREFIX_PATH"] = str(VENV)
    return env


def install_packages(ros):
    """Make .venv afresh from the lock files."""
    # what was built against the old packages is of no use with the new ones
    for folder in ("build", "install"):
        shutil.rmtree(ROOT / folder, ignore_errors=True)
    create = [os.path.realpath(sys.executable), "-m", "venv", "--clear", VENV]
    if ros:
        create.append("--system-site-packages")
    pip = [VENV / "bin" / "python", "-m", "pip", "install", "--no-deps", "--progress-bar", "off"]
    # empy 3 is published as source only, which the locked setuptools builds
    setuptools = [*pip, "-c", locks(ros)[0], "setuptools"]
    # beside a ROS install, packages of the system do not count: their programs are not in .venv/bin
    packages = [*pip, "--ignore-installed", "--only-binary", ":all:"]
    packages += ["--no-binary", "empy", "--no-build-isolation"]
    for lock in locks(ros):
        packages += ["-r", lock]
    run(
        "installing the locked Python packages into .venv",
        "packages.log",
        [create, setuptools, packages],
        environment(ros),
    )
    if ros is None:
        correct_exported_paths()


def correct_exported_paths():
    """Point the wheels' CMake exports, which name the machine they were built on, to this one."""
    numpy = next((VENV / "lib").glob("python3*/site-packages/numpy/_core/include"))
    replacements = {
        r'/opt/python/[^;"]*/numpy/_core/include': str(numpy),
        r'/opt/python/[^;"/]*/include/python3\.\d+': sysconfig.get_config_var("INCLUDEPY"),
    }
    for path in (VENV / "share").rglob("*.cmake"):
        text = corrected = path.read_text()
        for pattern, replacement in replacements.items():
            corrected = re.sub(pattern, replacement, corrected)
        if corrected != text:
            path.write_text(corrected)


def build_packages(ros):
    """Build the messages and tss_ros; tss_ros is linked, so that edits need no new build."""
    for folder in (ROOT / "build", ROOT / "install"):  # colcon stumbles over links to what is gone
        for path in folder.rglob("*"):
            if path.is_symlink() and not path.exists():
                path.unlink()
    packages = [*interface_packages(ros), "tss_ros"]
    if "simulation_interfaces" not in packages:  # ours of an earlier build would hide the real one
        for folder in (ROOT / "build", ROOT / "install"):
            shutil.rmtree(folder / "simulation_interfaces", ignore_errors=True)
    colcon = [VENV / "bin" / "colcon", "build", "--symlink-install"]
    colcon += ["--base-paths", ".", "msg_configs", "--packages-select", *packages]
    colcon += ["--event-handlers", "console_direct+", "--cmake-args"]
    colcon += ["-DCMAKE_BUILD_TYPE=Release", "-DBUILD_TESTING=OFF"]
    # C++ nodes of a ROS install may want the messages, too; beside the wheels there are none
    colcon += ["-DPYTHON_ONLY={}".format("OFF" if ros else "ON")]
    run("building the messages and tss_ros", "build.log", [colcon], environment(ros))


def warm_cache(ros):
    """Compile the core ahead of its first use, into numba's cache beside the sources."""
    core = ROOT / "tss_ros" / "core"
    if (core / "compile_cache.py").is_file():
        warm = [VENV / "bin" / "python", "-m", "tss_ros.core.compile_cache"]
        run("compiling the numerical core", "warm.log", [warm], environment(ros))


def place_minimal_ros2(environ):
    """Put the minimal `ros2` into .venv where there is no real one; take it away where there is."""
    source, target = ROOT / "setup_tools" / "ros2", VENV / "bin" / "ros2"
    ours = target.is_file() and "in place of the real ros2cli" in target.read_text(errors="replace")
    folders = [
        p for p in environ.get("PATH", "").split(os.pathsep) if p and Path(p) != target.parent
    ]
    if shutil.which("ros2", path=os.pathsep.join(folders)):
        if ours:
            target.unlink()
    elif not target.exists() or (ours and target.read_bytes() != source.read_bytes()):
        shutil.copy(source, target)


def main(occasion):
    """Bring the workspace up to date; `activate` does not recompile an edited core for that."""
    ros = find_ros(os.environ)
    if ros and ros.python != sys.version_info[:2]:
        name = "python{}.{}".format(*ros.python)
        python = shutil.which(name)
        if python is None:
            raise SetupError(f"ROS 2 in {ros.prefix} needs {name}: sudo apt install {name}")
        os.execv(python, [python, "-S", __file__, occasion])
    stamps = wanted_stamps(ros)
    if not all(is_current(*stamp) for stamp in (stamps[:2] if occasion == "activate" else stamps)):
        check_prerequisites(ros, os.environ)
        source = f"in {ros.prefix}" if ros else "from wheels"
        say("Python {}.{}, ROS 2 Jazzy {}".format(*sys.version_info[:2], source))
        checkout = os.open(ROOT, os.O_RDONLY)
        fcntl.flock(checkout, fcntl.LOCK_EX)  # another shell may be at work here
        steps = (install_packages, build_packages, warm_cache)
        for step, (stamp, content) in zip(steps, wanted_stamps(ros)):
            if not is_current(stamp, content):
                step(ros)
                stamp.write_text(content)
        os.close(checkout)
    place_minimal_ros2(os.environ)


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except SetupError as error:
        sys.exit(f"tss_ros: {error}")
    except KeyboardInterrupt:
        sys.exit("tss_ros: set-up interrupted; run it again to finish it")
