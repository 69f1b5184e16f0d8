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

#: The installer that is asked for first.
UV = "uv>=0.5,<1"


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
    warm = fingerprint(packages, *(f"{path} {s.st_mtime_ns} {s.st_size}" for path, s in core))
    return [(PACKAGES_STAMP, packages), (BUILD_STAMP, build), (WARM_STAMP, warm)]


def is_current(stamp, content):
    """Tell whether a step has been carried out in the state that `content` stands for."""
    return stamp.is_file() and stamp.read_text() == content


def say(text):
    """Print one line of progress."""
    print("tss_ros: " + text, flush=True)


class Step:
    """A part of the set-up: commands one after the other, their output in a log.

    `commands` is a generator of commands, alone or with what their environment has besides. Each
    is answered with its exit status; StepFailed ends it.
    `expected_s` is how long it takes on two cores, by which the share of the whole is told.
    `share` tells how far it is, from 0 to 1.
    """

    def __init__(self, title, log_name, expected_s, commands, share):
        self.title, self.expected_s = title, expected_s
        self.log_path = ROOT / "log" / log_name
        self._commands, self._share, self._process = commands, share, None
        self._begun = self._took_s = None

    def begin(self, env):
        """Start the first command."""
        self.log_path.parent.mkdir(exist_ok=True)
        self._env, self._begun = env, time.time()
        self.log_path.write_bytes(b"")
        self._next(None)

    def _next(self, status):
        try:
            command = next(self._commands) if status is None else self._commands.send(status)
        except StopIteration:
            self._took_s = time.time() - self._begun
        else:
            command, more = command if isinstance(command, tuple) else (command, {})
            with open(self.log_path, "ab") as log:
                self._process = subprocess.Popen(
                    command, cwd=ROOT, env={**self._env, **more}, stdin=subprocess.DEVNULL,
                    stdout=log, stderr=log,
                )  # fmt: skip

    def poll(self):
        """Go on with the next command where one has ended; tell whether all have."""
        try:
            if not self.ended and self._process.poll() is not None:
                self._next(self._process.returncode)
        except StepFailed:
            print(self.log_path.read_text(errors="replace")[-3000:], file=sys.stderr)
            raise SetupError(
                f"{self.title} failed; the whole output is in {self.log_path}"
            ) from None
        return self.ended

    @property
    def ended(self):
        """Whether all commands have ended well."""
        return self._took_s is not None

    def share(self):
        """Tell how far it is, from 0 to 1."""
        if self._begun is None or self.ended:
            return float(self.ended)
        return min(0.99, self._share(self.log_path.read_text(errors="replace"), self._begun))

    def state(self):
        """Tell in words how far it is."""
        if self.ended:
            return f"{self.title} done in {self._took_s:.0f} s"
        return f"{self.title} {100 * self.share():.0f} %"

    def stop(self):
        """End what still runs."""
        if self._process and self._process.poll() is None:
            self._process.terminate()
            self._process.wait()


class StepFailed(Exception):
    """A command of a step has failed, and nothing can stand in for it."""


def demand(status):
    """Raise StepFailed unless a command has ended well."""
    if status != 0:
        raise StepFailed


class Progress:
    """Shows how far all steps are together, and how long they may still take."""

    #: [s] between two lines, and between two states of a terminal's line.
    LINE_S, TERMINAL_S = 2.5, 0.5

    def __init__(self, steps):
        self._steps, self._begun, self._shown = steps, time.monotonic(), 0.0
        self._terminal = sys.stdout.isatty()

    def show(self, running, now=False):
        """Show the steps that run, if it is time to."""
        clock = time.monotonic()
        if not now and clock - self._shown < (self.TERMINAL_S if self._terminal else self.LINE_S):
            return
        self._shown = clock
        states = ", ".join(step.state() for step in running)
        done = sum(step.expected_s * step.share() for step in self._steps)
        total = sum(step.expected_s for step in self._steps)
        left = total - done
        if done > 0.1 * total:  # before, what is expected says more than what was seen
            left *= (clock - self._begun) / done
        line = f"tss_ros: {100 * done / total:3.0f} %, about {left:.0f} s left: {states}"
        if self._terminal:
            line = "\r\033[K" + line[: shutil.get_terminal_size().columns - 1]
        print(line, end="", flush=True)
        if now or not self._terminal:
            print(flush=True)


def carry_out(steps, progress, env):
    """Carry out steps side by side."""
    try:
        for step in steps:
            step.begin(env)
        while sum(step.poll() for step in steps) < len(steps):
            progress.show(steps)
            time.sleep(0.1)
        if steps:
            progress.show(steps, now=True)
    finally:
        for step in steps:
            step.stop()


def environment(ros):
    """Return the environment in which the tools of .venv install and build."""
    left_out = ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")
    env = {name: value for name, value in os.environ.items() if name not in left_out}
    # without this, colcon has make wait while other work keeps the machine busy
    env["MAKEFLAGS"] = f"-j{len(os.sched_getaffinity(0))}"
    env["VIRTUAL_ENV"] = str(VENV)
    env["PYTHONUNBUFFERED"] = "1"  # so that logs show at once how far things are
    env["PATH"] = os.pathsep.join([str(VENV / "bin"), env.get("PATH", os.defpath)])
    if ros is None:
        env["AMENT_PREFIX_PATH"] = env["CMAKE_PREFIX_PATH"] = str(VENV)
    return env


def packages(ros):
    """The step that makes .venv afresh from the lock files."""
    return Step("packages", "packages.log", 25, install_packages(ros), packages_share(ros))


def packages_share(ros):
    """Return how far the installation is: packages fetched, then those in .venv."""
    wanted = sum(line[:1].isalnum() for lock in locks(ros) for line in lock.open())

    def share(log, begun):
        fetched = max(log.count("Collecting "), count_new(uv_cache(), begun))
        there = sum(1 for _ in VENV.glob("lib/python3*/site-packages/*.dist-info"))
        return (0.7 * min(fetched, wanted) + 0.3 * there) / wanted

    return share


def uv_cache():
    """Return where uv keeps the packages that it has fetched."""
    caches = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(os.environ.get("UV_CACHE_DIR") or Path(caches, "uv")) / "archive-v0"


def count_new(folder, since):
    """Return how many entries of a folder are newer than a time."""
    try:
        return sum(entry.stat().st_mtime >= since for entry in os.scandir(folder))
    except OSError:
        return 0


def install_packages(ros):
    """Install by uv where the package index has it, else by pip, which takes three times longer."""
    # what was built against the old packages is of no use with the new ones
    for folder in ("build", "install"):
        shutil.rmtree(ROOT / folder, ignore_errors=True)
    create = [os.path.realpath(sys.executable), "-m", "venv", "--clear", VENV]
    if ros:
        create.append("--system-site-packages")
    demand((yield create))
    pip = [VENV / "bin" / "python", "-m", "pip", "install", "--no-deps", "--progress-bar", "off"]
    # empy 3 is published as source only, which the locked setuptools builds
    setuptools = ["-c", locks(ros)[0], "setuptools"]
    everything = ["--only-binary", ":all:", "--no-binary", "empy", "--no-build-isolation"]
    for lock in locks(ros):
        everything += ["-r", lock]
    # beside a ROS install, packages of the system do not count, which is what pip alone can be told
    if ros is None and (yield [*pip, UV]) == 0:
        uv = [VENV / "bin" / "uv", "pip", "install", "--no-progress", "--no-deps"]
        uv += ["--python", VENV / "bin" / "python"]
        more = uv_settings(pip_settings())
        installed = (yield [*uv, *setuptools], more) == 0 and (yield [*uv, *everything], more) == 0
    else:
        installed = False
    if not installed:
        demand((yield [*pip, *setuptools]))
        demand((yield [*pip, "--ignore-installed", *everything]))
    if ros is None:
        correct_exported_paths()


def pip_settings():
    """Return pip's settings by name; those of the environment count most."""
    command = [VENV / "bin" / "python", "-m", "pip", "config", "list"]
    listed = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False).stdout
    settings, of_environment = {}, {}
    for line in listed.splitlines():
        name, _, value = line.partition("=")
        where = of_environment if name.startswith(":env:") else settings
        where[name.rpartition(".")[2]] = value.strip("'\"").replace("\\n", " ").split()
    return {**settings, **of_environment}


def uv_settings(settings):
    """Return an environment for uv from pip's settings, which it does not read itself."""
    found = {"UV_INDEX_STRATEGY": "unsafe-best-match"}  # as pip: all indexes count alike
    for name, separator, variable in (
        ("index-url", " ", "UV_DEFAULT_INDEX"),
        ("extra-index-url", " ", "UV_INDEX"),
        ("find-links", ",", "UV_FIND_LINKS"),
        ("trusted-host", " ", "UV_INSECURE_HOST"),
        ("cert", " ", "SSL_CERT_FILE"),
        ("default-timeout", " ", "UV_HTTP_TIMEOUT"),
        ("timeout", " ", "UV_HTTP_TIMEOUT"),
    ):
        if settings.get(name):
            found[variable] = separator.join(settings[name])
    if settings.get("no-index", ["0"])[0].lower() in ("1", "true", "yes", "on"):
        found["UV_NO_INDEX"] = "1"
    return {name: value for name, value in found.items() if name not in os.environ}


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
            path.unlink()  # uv has it linked to its cache
            path.write_text(corrected)


def interfaces(ros):
    """The step that builds the messages and tss_ros."""
    return Step("interfaces", "build.log", 60, build_packages(ros), build_share)


def build_share(log, begun):
    """Return how far CMake's packages are, by the logs that colcon keeps of each."""
    shares = []
    for cmake in (ROOT / "msg_configs").glob("*/CMakeLists.txt"):
        path = ROOT / "log" / "latest_build" / cmake.parent.name / "stdout.log"
        new = path.is_file() and path.stat().st_mtime >= begun
        text = path.read_text(errors="replace") if new else ""
        percent = re.findall(r"^\[ *(\d+)%\]", text, re.M)
        shares.append(float(percent[-1]) / 100 if percent else 0.0)
    return sum(shares) / len(shares)


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
    demand((yield colcon))


def kernels(ros):
    """The step that compiles the core ahead of its first use, into numba's cache."""
    return Step("kernels", "kernels.log", 60, compile_kernels(), kernels_share)


def kernels_share(log, begun):
    """Return how far the kernels are, from what their compilation prints."""
    percent = re.findall(r"(\d+) %", log)
    return float(percent[-1]) / 100 if percent else 0.0


def compile_kernels():
    """Compile the numerical core, where there is one."""
    if (ROOT / "tss_ros" / "core" / "compile_cache.py").is_file():
        demand((yield [VENV / "bin" / "python", "-m", "tss_ros.core.compile_cache"]))


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


def make_workspace(ros):
    """Carry out the steps that are due: first the packages, then what they are needed for."""
    due = [
        (make(ros), *stamp)
        for make, stamp in zip((packages, interfaces, kernels), wanted_stamps(ros))
        if not is_current(*stamp)
    ]
    progress = Progress([step for step, _, _ in due])
    first = [entry for entry in due if entry[1] == PACKAGES_STAMP]
    for together in (first, [entry for entry in due if entry not in first]):
        try:
            carry_out([step for step, _, _ in together], progress, environment(ros))
        finally:  # one may have come to its end when the other failed
            for step, stamp, content in together:
                if step.ended:
                    stamp.write_text(content)


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
        make_workspace(ros)
        os.close(checkout)
    place_minimal_ros2(os.environ)


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except SetupError as error:
        sys.exit(f"tss_ros: {error}")
    except KeyboardInterrupt:
        sys.exit("tss_ros: set-up interrupted; run it again to finish it")
