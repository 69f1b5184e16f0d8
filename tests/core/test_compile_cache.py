"""Compiled kernels in numba's cache belong to the source that they were made of."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tss_ros.core
from tss_ros.core.numerics import loops

ACCELERATION = """
import numpy as np
from tss_ros.core import ring
from tss_ros.core.model import forces
from tss_ros.core.model.kernel_arrays import kernel_arrays
system = ring(linear_gravity=True)
a, place = np.empty((3, 3)), np.array([[0.0, 1e3, 0.0]] * 3) + np.arange(3)[:, None]
slack = np.zeros(3, dtype=bool)
forces.acceleration(kernel_arrays(system, 0.0), slack, 0.0, np.zeros((3, 3)), place, a)
print(a[0, 1] / system.orbit_rate_rad_s**2, sum(forces.acceleration.stats.cache_hits.values()))
"""


@pytest.mark.long
def test_a_law_that_is_edited_is_compiled_anew_wherever_it_is_inlined(tmp_path):
    package = tmp_path / "tss_ros"
    shutil.copytree(
        Path(tss_ros.core.__file__).parent, package / "core",
        ignore=shutil.ignore_patterns("__pycache__", "*.nb[ic]"),
    )  # fmt: skip
    (package / "__init__.py").touch()
    shutil.copy(Path(tss_ros.core.__file__).parents[1] / "extras.py", package)
    surroundings = {
        **os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")
    }  # fmt: skip

    def found():
        run = subprocess.run(
            [sys.executable, "-c", ACCELERATION], env=surroundings, cwd=tmp_path, check=True,
            capture_output=True, text=True,
        )  # fmt: skip
        value, hits = run.stdout.split()
        return round(float(value)), int(hits)

    assert found() == (3000, 0)
    assert found() == (3000, 1)
    gravity = package / "core" / "model" / "laws" / "gravity.py"
    gravity.write_text(gravity.read_text().replace("(3.0 * height", "(30.0 * height"))
    assert found() == (30000, 0)


def test_a_kernel_that_only_kernels_call_says_so():
    with pytest.raises(TypeError, match="add can be called by compiled code only"):
        loops.add(np.zeros((2, 2)), 1.0, np.ones((2, 2)))


FIRST_RESULT = """
from numba.core import event
from tss_ros.core import compute_floquet, ring
with event.install_recorder("numba:compile") as recorded:
    verdict = compute_floquet(ring(), -2.5).verdict
print(verdict)
print(*{e.data["dispatcher"].py_func.__name__ for _, e in recorded.buffer})
"""


@pytest.mark.long
def test_the_integrator_is_compiled_once_by_two_processes_and_a_line_says_so(tmp_path):
    surroundings = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}

    def start():
        return subprocess.Popen(
            [sys.executable, "-c", FIRST_RESULT], env=surroundings, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip

    both = [start(), start()]
    answers = [process.communicate(timeout=600) for process in both]
    assert [out.splitlines()[0] for out, _ in answers] == ["asymptotically stable"] * 2
    compiled = [set(out.splitlines()[1].split()) for out, _ in answers]
    (said,) = [i for i, (_, errors) in enumerate(answers) if errors]
    assert re.fullmatch(r"tss_ros: compiling once, about \d+ s\n", answers[said][1])
    assert {"explicit_step", "advance"} <= compiled[said]
    assert not {"explicit_step", "advance"} & compiled[1 - said]
    if len(os.sched_getaffinity(0)) > 1:
        assert "implicit_step" not in compiled[said]
    out, errors = start().communicate(timeout=60)
    assert out == "asymptotically stable\n\n" and errors == ""
