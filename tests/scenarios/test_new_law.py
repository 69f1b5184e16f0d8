"""A law is one file and its registration: what takes parameters needs no word about it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import tss_ros

LAW = '''
"""A pull towards the centre."""

from tss_ros.core.model.contract import BeadLaw, LawParameter

TRAP = LawParameter("trap_per_s2", "Pull per distance from the centre", "1/s^2", 0.0, 1.0, 0.0)


def acceleration(bead, trap_per_s2):
    return tuple(-1.0 * trap_per_s2 * x for x in bead.position)


LAW = BeadLaw("trap", "pull to the centre", acceleration, parameters=(TRAP,))
'''
PROGRAM = '''
import generate
from rclpy.serialization import deserialize_message
from tss_interfaces.msg import SystemDescription
from tss_ros.messages import steps
from tss_ros.ros import parameters
from tss_ros.scenarios import scenario
from tss_ros.scenarios.parameters import GRAPH, SCENARIO, VARIED, names

for table in (SCENARIO, GRAPH, VARIED, parameters.SIMULATOR, parameters.OVERRIDES):
    assert "trap_per_s2" in names(table)
system = scenario.load("three_star").build({"trap_per_s2": 0.25})
assert system.law_parameters["trap_per_s2"] == 0.25
options = {"scenario": "three_star", "publish_period_s": 1.0}
options |= {"disturbance_m": 0.0, "disturbance_seed": 0}
data = steps.system_description(system, -2.5, [1.0] * 3, options)
described = deserialize_message(data, SystemDescription)
assert dict(zip(described.law_parameter_name, described.law_parameter))["trap_per_s2"] == 0.25
assert "| `trap_per_s2` | Pull per distance from the centre [1/s^2]." in generate.parameters()
'''


def test_a_law_of_ones_own_is_a_parameter_everywhere(tmp_path):
    package = Path(tss_ros.__file__).parent
    shutil.copytree(package, tmp_path / "tss_ros", ignore=shutil.ignore_patterns("__pycache__"))
    laws = tmp_path / "tss_ros" / "core" / "model" / "laws"
    (laws / "trap.py").write_text(LAW)
    text = (laws / "__init__.py").read_text()
    text = text.replace("    drag,\n", "    drag,\n    trap,\n").replace(
        "solar_pressure.LAW,", "solar_pressure.LAW, trap.LAW,"
    )
    (laws / "__init__.py").write_text(text)
    docs = Path(__file__).parents[2] / "docs"
    path = os.pathsep.join([str(tmp_path), str(docs), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**os.environ, "PYTHONPATH": path},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
