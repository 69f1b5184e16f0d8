"""The benchmarks' own Python environment, the machine, and measuring in processes of their own."""

import contextlib
import datetime
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv-benchmarks"
COMPARED = ("numpy", "scipy", "numba", "heyoka", "scikit-sundae", "CyRK", "diffrax", "casadi")
LOCK = ROOT / "requirements" / "benchmarks.txt"
#: Set where OpenBLAS would choose wrong kernels or too many threads; solvers are measured without.
UNSET = ("OPENBLAS_NUM_THREADS", "OPENBLAS_CORETYPE")


def peers_python():
    """The Python of an environment with the locked peers, made first if need be."""
    python, stamp = VENV / "bin" / "python", VENV / ".stamp"
    wanted = hashlib.sha256(LOCK.read_bytes()).hexdigest()
    if not stamp.is_file() or stamp.read_text() != wanted:
        print(f"installing the solvers to compare with into {VENV.name}", flush=True)
        base = getattr(sys, "_base_executable", sys.executable)
        subprocess.run([os.path.realpath(base), "-m", "venv", "--clear", VENV], check=True)
        pip = [python, "-m", "pip", "install", "-qq", "--no-deps", "-r", LOCK]
        subprocess.run([*pip, "--only-binary", ":all:"], check=True)
        stamp.write_text(wanted)
    return str(python)


def environment(**more):
    """The environment that everything is measured in."""
    env = {name: value for name, value in os.environ.items() if name not in UNSET}
    env["PYTHONPATH"] = str(ROOT)
    env["BENCHMARKS_CACHE"] = str(VENV / "heyoka-cache")
    return {**env, **more}


def machine(python):
    """What was measured on, when, with what and beside what load."""
    model = "unknown processor"
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line for line in lines if line.startswith("model name")).partition(": ")[2]
    return {
        "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "processor": model,
        "cores": os.cpu_count(),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "load": [round(load, 2) for load in os.getloadavg()],
        "versions": versions(python),
    }


def versions(python):
    """Versions of what is compared, in the environment of another Python."""
    code = "import json; from benchmarks.processes import installed; print(json.dumps(installed()))"
    told = subprocess.run(
        [python, "-c", code],
        cwd=ROOT,
        env=environment(),
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(told.stdout)


def installed():
    """Versions of those of `COMPARED` that are installed."""
    found = {}
    for name in COMPARED:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def measured(python, case, solver, limit_s, **more):
    """What `benchmarks.worker` tells of one solver on one case.

    Parameters
    ----------
    python : str
    case, solver : str
    limit_s : float
        [s] after which its process is killed.
    **more
        Environment variables of the process.

    Returns
    -------
    dict
        With `ms` and `error` if it was accurate enough, otherwise with a `note`.
    """
    lines = []
    with tempfile.TemporaryFile("w+", encoding="utf-8") as out:
        command = [python, "-m", "benchmarks.worker", case, solver, repr(time.time())]
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=environment(**more),
            stdout=out,
            stderr=subprocess.DEVNULL,
            stdin=subprocess.DEVNULL,
        )
        try:
            process.wait(limit_s)
        except subprocess.TimeoutExpired:
            lines.append({"note": f"> {limit_s:g} s"})
        finally:
            process.kill()
            process.wait()
        out.seek(0)
        told = [line for line in out.read().splitlines() if line.startswith("{")]
    told = [json.loads(line) for line in told if line.endswith("}")]
    result = {key: value for line in (*told, *lines) for key, value in line.items()}
    if not {"ms", "note", "first_answer_s"} & set(result):
        result["note"] = f"ended with status {process.returncode}"
    return result
