"""Compiled kernels in numba's cache belong to the source that they were made of."""

import os
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


def test_a_law_that_is_edited_is_compiled_anew_wherever_it_is_inlined(tmp_path):
    package = tmp_path / "tss_ros"
    shutil.copytree(
        Path(tss_ros.core.__file__).parent, package / "core",
        ignore=shutil.ignore_patterns("__pycache__", "*.nb[ic]"),
    )  # fmt: skip
    (package / "__init__.py").touch()
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
