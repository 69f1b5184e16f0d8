"""Laws of users, from installed packages and from files, in processes of their own."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tss_ros.core.model.laws import BEAD_LAWS, REEL_LAWS, TETHER_LAWS, THRUST_LAWS
from tss_ros.core.model.own_laws import statement

ROOT = Path(__file__).parents[2]
#: A package of laws: those of tss_ros stated once more, and others.
LAWS = '''
"""Laws of my own."""

from tss_ros.core.model.contract import BeadLaw, LawParameter, TetherLaw, ThrustLaw
from tss_ros.core.numerics.expressions import dot, sqrt

GAIN = LawParameter("my_gain", "Gain", "N s/m", 0.0, 1e3, 0.0)
HOLD = LawParameter("my_stiffness", "Gain", "N/m", 0.0, 1e3, 0.0)
FORCE = LawParameter("my_force_n", "Largest thrust", "N", 0.0, 10.0, 0.0)
WIDTH = LawParameter("my_width_m_s", "Half the dead band", "m/s", 1e-6, 10.0, 0.05)
TRAP = LawParameter("my_trap_per_s2", "Pull", "1/s^2", 0.0, 1.0, 0.0)


def damping(g, my_gain):
    return tuple(-my_gain * (v - w) for v, w in zip(g.velocity, g.rigid_velocity))


def keeping(g, my_stiffness):
    return tuple(my_stiffness * (s - d) for s, d in zip(g.shape, g.place))


def bang(g, my_force_n, my_width_m_s):
    """Next to nothing below the width, and nearly the whole force above it."""
    e = tuple((v - w) / my_width_m_s for v, w in zip(g.velocity, g.rigid_velocity))
    square = dot(e, e)
    share = my_force_n * square / ((1.0 + square) * sqrt(1.0 + square))
    return tuple(-share * x for x in e)


def trap(m, my_trap_per_s2):
    return tuple(-my_trap_per_s2 * x for x in m.position)


def tension(t):
    return t.stiffness * (t.length - t.rest) + t.damping * t.rate


def energy(t):
    return 0.5 * t.stiffness * (t.length - t.rest) ** 2


DAMPING = ThrustLaw("my_damping", "against the turn's error", damping, (GAIN,))
KEEPING = ThrustLaw("my_keeping", "towards the shape", keeping, (HOLD,))
BANG = ThrustLaw("my_bang", "dead band, then all", bang, (FORCE, WIDTH))
PULL = BeadLaw("my_trap", "pull to the centre", trap, (TRAP,))
SPRING = TetherLaw("my_spring", "spring and damper", tension, energy, pushes=True)
'''
ENTRY_POINTS = """[tss_ros.laws]
damping = my_laws:DAMPING
keeping = my_laws:KEEPING
bang = my_laws:BANG
trap = my_laws:PULL
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A folder in which a package with entry points is installed, as pip leaves it."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "my_laws.py").write_text(LAWS)
    about = folder / "my_laws-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: my_laws\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(ENTRY_POINTS)
    return folder


def run(program, folder, laws="", *, more=(), **environment):
    """A fresh Python that finds modules in a folder, and laws as the variable says."""
    path = [str(folder), str(ROOT / "tests" / "helpers"), os.environ.get("PYTHONPATH", "")]
    surroundings = {
        **os.environ, "PYTHONPATH": os.pathsep.join(path), "TSS_ROS_LAWS": laws, **environment
    }  # fmt: skip
    words = [sys.executable, "-c", program] if program else [sys.executable, *more]
    return subprocess.run(words, env=surroundings, capture_output=True, text=True, timeout=900)


def answer(*arguments, **options):
    """What such a process prints, as JSON."""
    done = run(*arguments, **options)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


# -- laws that act ---------------------------------------------------------------------------------

SAME = """
import json
import numpy as np
from tss_ros.core import Propagator, compute_floquet, disturbed, initial_state, ring

base = {"damping_n_s_per_m": 1000.0}
own = {"my_gain": 0.3, "my_stiffness": 1e-3, "tether_law": "my_spring", "thrust_limit_n": 0.05}
built_in = {"rotation_damping_n_s_per_m": 0.3, "shape_keeping_n_per_m": 1e-3,
            "thrust_limit_n": 0.05}
ends, results = [], []
for law in (own, built_in, {}):
    system = ring(**base, **law)
    start = disturbed(initial_state(system, -2.9), 10.0, seed=1)
    ends.append(Propagator(system, -2.9, start).sample([2000.0])[0][0])
for law in (own, built_in):
    results.append(compute_floquet(ring(**base, **law), -2.9))
moduli = [np.sort(np.abs(result.multiplier)) for result in results]
print(json.dumps({
    "apart": np.abs(ends[0] - ends[1]).max(), "effect": np.abs(ends[2] - ends[1]).max(),
    "multipliers": np.abs(moduli[0] - moduli[1]).max(),
    "deciding": [result.deciding_modulus for result in results],
    "loss": [result.spin_loss for result in results],
    "liouville": results[0].liouville_error,
}))
"""


@pytest.mark.long
def test_a_law_that_says_the_same_once_more_does_the_same(package):
    """Simulation and closed loop under the laws of the package, and under a user's."""
    found = answer(SAME, package, "my_laws:SPRING")
    assert found["apart"] < 1e-8 < 1.0 < found["effect"]
    assert found["multipliers"] < 1e-6  # of Jordan blocks; the one that decides:
    assert found["deciding"][0] == pytest.approx(found["deciding"][1], abs=1e-11)
    assert found["loss"][0] == pytest.approx(found["loss"][1], abs=1e-11)
    assert found["liouville"] < 1e-6


NONLINEAR = """
import json
import numpy as np
from differences import assert_variations_are_differences, differences
from tss_ros.core import Propagator, State, compute_floquet, disturbed, ring
from tss_ros.core.model import forces
from tss_ros.core.model.feedback import analysed, thrust
from tss_ros.core.motion.integrator import Integrator

system = ring(damping_n_s_per_m=1000.0, my_force_n=0.1, my_width_m_s=4e-4)
result = compute_floquet(system, -2.9, certify=False)
driven = Integrator(system, result.spin_rate_rad_s, 1e-13, 1e4).driven(result.spin_loss)
times = np.linspace(0.0, result.period_s, 60)
r, v = Propagator(system, -2.9, result.state).sample(times)
size = [np.linalg.norm(thrust(system, -2.9, State(*x)), axis=1).max() for x in zip(r, v)]
matrix = assert_variations_are_differences(driven, result.state, result.period_s, 3e-7, 1e-6,
                                           result.switches)
moduli = [np.sort(np.abs(x)) for x in (np.linalg.eigvals(matrix), result.multiplier)]

state, symbolic = disturbed(result.state, 0.1, seed=2), analysed(system)
arrays, none = driven.arrays._replace(acting=0, spin=0.0), np.zeros(system.m, dtype=bool)
r, v = state.position_m, state.velocity_m_s
by_r, by_v = np.empty((2, symbolic.row.size, 3, 3))
forces.jacobian(arrays, symbolic.pair, none, 0.0, v, r, by_r, by_v)

def acceleration(v, r):
    a = np.empty_like(r)
    forces.acceleration(arrays, none, 0.0, v, r, a)
    return a

missed = []
for blocks, x, of, step in ((by_r, r, lambda r: acceleration(v, r), 1e-3),
                            (by_v, v, lambda v: acceleration(v, r), 4e-6)):
    whole = np.zeros((system.n, 3, system.n, 3))
    whole[symbolic.row, :, symbolic.column, :] = blocks
    expected = differences(of, x, step).reshape(whole.shape)
    missed.append(np.abs(whole - expected).max() / np.abs(expected).max())
print(json.dumps({"thrust": [min(size), max(size)], "missed": missed,
                  "moduli": np.abs(moduli[0] - moduli[1]).max(), "verdict": result.verdict}))
"""


@pytest.mark.long
def test_derivatives_and_multipliers_of_a_law_that_is_not_linear_are_differences(package):
    found = answer(NONLINEAR, package, "my_laws:SPRING")
    least, most = found["thrust"]
    assert 0.03 < least < most < 0.05  # of 0.1 N: between the dead band and the whole force
    assert max(found["missed"]) < 1e-6
    assert found["moduli"] < 1e-6


THRUST = """
import json
import numpy as np
from numba.core import event
from tss_ros.core import State, ring
from tss_ros.core.model.feedback import thrust
from tss_ros.core.model.feedback_thrust import add_thrust

system = ring(law_gain=0.25)
place = np.array(system.layout_m)
with event.install_recorder("numba:compile") as recorded:
    force = thrust(system, -2.5, State(place, 0.0 * place))
print(json.dumps([force[0, 0], sum(add_thrust.stats.cache_hits.values())]))
"""
ONE_LAW = """
from law_helper import FACTOR
from tss_ros.core.model.contract import LawParameter, ThrustLaw

GAIN = LawParameter("law_gain", "Gain", "N s/m", 0.0, 1e3, 0.0)


def thrust(g, law_gain):
    return tuple(FACTOR * law_gain * (w - v) for v, w in zip(g.velocity, g.rigid_velocity))


LAW = ThrustLaw("one_law", "against the turn's error", thrust, (GAIN,))
"""


@pytest.mark.long
def test_a_law_that_is_changed_is_compiled_anew(tmp_path):
    """Where the change is in the law, and where it is in a module that the law imports."""
    (tmp_path / "one_law.py").write_text(ONE_LAW)
    (tmp_path / "law_helper.py").write_text("FACTOR = 1.0\n")

    def found():
        return answer(
            THRUST, tmp_path, "one_law:LAW", NUMBA_CACHE_DIR=str(tmp_path / "cache"),
            PYTHONDONTWRITEBYTECODE="1",
        )  # fmt: skip

    (first, hits), again = found(), found()
    assert hits == 0 and again == [first, 1] and first != 0.0
    (tmp_path / "law_helper.py").write_text("FACTOR = 2.0\n")
    (second, hits), again = found(), found()
    assert second == 2.0 * first and hits == 0 and again == [second, 1]
    (tmp_path / "one_law.py").write_text(ONE_LAW.replace("(w - v)", "(w - v) * 3.0"))
    third, hits = found()
    assert third == pytest.approx(6.0 * first, rel=1e-15) and hits == 0


HANGING = """
import json
from dataclasses import replace
from tss_ros.core import compute_floquet, formation

chain = formation("chain", satellites=2, damping_n_s_per_m=100.0)
system = replace(chain, law_parameters={"law_gain": 1e-3})
print(json.dumps(compute_floquet(system, 0.0).message))
"""


@pytest.mark.long
def test_nothing_hangs_where_a_law_thrusts_at_rest(tmp_path):
    pull = "return tuple(-law_gain * d for d in g.place)"
    text = ONE_LAW.replace("from law_helper", "# ")
    (tmp_path / "one_law.py").write_text(re.sub("return tuple.*", pull, text))
    said = answer(HANGING, tmp_path, "one_law:LAW")
    assert said == "feedback thrusts 5 N where the formation would hang at rest"


EVERYWHERE = """
import json
from tss_ros.core.model.parameters import with_parameter
from tss_ros.scenarios import scenario
from tss_ros.scenarios.parameters import GRAPH, SCENARIO, VARIED, names
from tss_ros.sweeps.software import versions

named = {"my_gain", "my_stiffness", "my_force_n", "my_width_m_s", "my_trap_per_s2"}
for table in (SCENARIO, GRAPH, VARIED):
    assert named <= set(names(table))
system = scenario.load("three_star").build({"my_gain": 0.5, "tether_law": "my_spring"})
assert system.law_parameters["my_gain"] == 0.5
assert with_parameter(system, "my_gain", 0.7).law_parameters["my_gain"] == 0.7
print(json.dumps(versions()["core"]))
"""


def test_parameters_of_own_laws_are_keys_of_scenarios_and_of_sweeps(package, tmp_path):
    core = answer(EVERYWHERE, package, "my_laws:SPRING")
    bare = "import json; from tss_ros.core.model import laws; from tss_ros.sweeps import software"
    assert core != answer(f"{bare}; print(json.dumps(software.versions()['core']))", tmp_path)


DOCUMENTED = """
import json
import numpy as np
from tss_ros.core import averaged_state, ring
from tss_ros.core.model import forces
from tss_ros.core.model.feedback import thrust, with_feedback
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.model.reel_law import rows_of

system = ring(soft_thrust_n=0.2)
turn = averaged_state(system, -2.5)
at_rest = thrust(system, -2.5, turn)
turn.velocity_m_s[0] += [0.0, 0.0, 0.15]
thrusts = [np.abs(at_rest).max(), *(float(z) for z in thrust(system, -2.5, turn)[:, 2])]
system = ring(slip_n=0.2, reel_damping_n_s_per_m=30.0, reel_mass_kg=4.0, reel_tension_n=0.5)
arrays = with_feedback(kernel_arrays(system, 0.0), system, system.spin_rate_rad_s(-2.5))
v, r = (np.array(x) for x in rows_of(system, averaged_state(system, -2.5)))
v[3:, 0], r[3:, 0] = (1e-3, 0.0, -0.5), (10e3, 10e3, 10001.0)
a = np.empty_like(r)
forces.acceleration(arrays, np.zeros(3, dtype=bool), 0.0, v, r, a)
print(json.dumps([thrusts, a[3:].tolist()]))
"""


def documented():
    """The laws of the page: of thrusters, of reels."""
    page = (ROOT / "docs" / "howto" / "own_law.md").read_text("utf-8")
    return re.findall(r"```python\n(.*?)```", page, re.S)


def test_the_laws_of_the_page_do_what_the_page_says(tmp_path):
    """The brake holds beside the package's own law of reels."""
    for name, code in zip(("soft_thrust", "slip"), documented(), strict=True):
        (tmp_path / f"{name}.py").write_text(code)
    (at_rest, *thrusts), rates = answer(DOCUMENTED, tmp_path, "soft_thrust:LAW,slip:LAW")
    expected = [-0.2 * e / (0.05**2 + e**2) ** 0.5 for e in (0.1, -0.05, -0.05)]
    assert at_rest < 1e-9
    assert thrusts == pytest.approx(expected, rel=1e-9)
    rate, out = (1e-3, 0.0, -0.5), (0.0, 0.0, 1.0)
    force = [0.2 * x / (1e-6 + x**2) ** 0.5 + y + 30.0 * x + 1.0 * y for x, y in zip(rate, out)]
    assert rates == [pytest.approx([-(0.5 + f) / 4.0, 0.0, 0.0], rel=1e-9) for f in force]


SLIPPING = """
import json
import numpy as np
from tss_ros import core
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.shooting import carried_motion, from_scaled, to_scaled

law = {"slip_n": 0.3, "slip_width_m_s": 0.01, "reel_mass_kg": 5.0}
system = core.ring(damping_n_s_per_m=20.0, **law)
start = core.disturbed(core.initial_state(system, -2.9), 3.0, 1)
motor = Integrator(system, system.spin_rate_rad_s(-2.9), 1e-12, 6e3)
x = to_scaled(motor, start)
motion, matrix = carry_displacements(motor, motor.begin(start), np.eye(x.size), 200.0)
missed = []
for k in np.flatnonzero(motor.real):
    ends = []
    for step in (1e-7, -1e-7):
        beside = x.copy()
        beside[k] += step
        end = carried_motion(motor, from_scaled(motor, beside), 200.0)
        ends.append(motor.scaled(end.v, end.r))
    missed.append(np.max(np.abs((ends[0] - ends[1]) / 2e-7 - matrix[:, k])[motor.real]))
found = core.compute_floquet(system, -2.9)
print(json.dumps({
    "switches": motion.switches, "missed": max(missed), "largest": np.abs(matrix).max(),
    "verdict": found.verdict, "count": len(found.multiplier), "decided": found.deciding_modulus,
    "liouville": found.liouville_error,
}))
"""


@pytest.mark.long
def test_multipliers_of_reels_with_a_brake_of_ones_own_are_differences(tmp_path):
    (tmp_path / "slip.py").write_text(documented()[1])
    found = answer(SLIPPING, tmp_path, "slip:LAW")
    assert found["switches"] >= 1
    assert found["missed"] < 1e-5 * max(1.0, found["largest"])
    assert found["verdict"] == "asymptotically stable" and found["count"] == 24
    assert 0.0 < found["decided"] < 1.0 and found["liouville"] < 1e-6


# -- laws that are refused -------------------------------------------------------------------------

BAD = {
    "name taken": (
        'LAW = ThrustLaw("drag", "", linear, (GAIN,))', "'drag': another law has this name already"
    ),
    "name no word": ('LAW = ThrustLaw("my law", "", linear, (GAIN,))', "its name must be a word"),
    "parameter taken": (
        'LAW = ThrustLaw("l", "", lambda g, j2: linear(g, j2),'
        ' (LawParameter("j2", "", "", 0, 1, 0),))',
        "another name: 'j2' is taken",
    ),
    "parameter of what is seen": (
        'LAW = ThrustLaw("l", "", lambda g, mass: linear(g, mass),'
        ' (LawParameter("mass", "", "", 0, 1, 0),))',
        "another name: 'mass' is taken",
    ),
    "acts always": (
        'LAW = ThrustLaw("l", "", linear, (LawParameter("gain", "", "", 0, 2, 1),))',
        "its default must be 0, got 1",
    ),
    "default beyond": (
        'LAW = ThrustLaw("l", "", linear, (LawParameter("gain", "", "", 1, 2, 0),))',
        "the default of gain, 0, must lie in its range, from 1 to 2",
    ),
    "no parameter": ('LAW = ThrustLaw("l", "", lambda g: g.place, ())', "needs a parameter"),
    "two components": (
        'LAW = ThrustLaw("l", "", lambda g, gain: linear(g, gain)[:2], (GAIN,))',
        "its thrust must have three components, got 2",
    ),
    "nothing": ('LAW = ThrustLaw("l", "", lambda g, gain: None, (GAIN,))', "its thrust failed:"),
    "if": (
        'LAW = ThrustLaw("l", "", lambda g, gain: g.place if g.place[0] > 0 else g.shape, (GAIN,))',
        "its thrust failed: TypeError: .*; write + - * /, ** with a number, and sqrt, exp, excess",
    ),
    "truth": (
        'LAW = ThrustLaw("l", "", lambda g, gain: g.place if gain else g.shape, (GAIN,))',
        "its thrust failed: TypeError: a formula is neither true nor false",
    ),
    "math": (
        'import math\nLAW = ThrustLaw("l", "", lambda g, gain: [math.sqrt(gain)] * 3, (GAIN,))',
        "its thrust failed: TypeError",
    ),
    "other argument": ('LAW = ThrustLaw("l", "", lambda g, c: linear(g, c), (GAIN,))', "'gain'"),
    "unknown symbol": (
        "from tss_ros.core.numerics.expressions import symbol\n"
        'LAW = ThrustLaw("l", "", lambda g, gain: [symbol("wind") * x for x in g.place], (GAIN,))',
        "nothing is known of: wind",
    ),
    "not smooth": (
        'LAW = ThrustLaw("l", "", lambda g, gain: [gain * (v - w) / sqrt(sum((a - b) ** 2 for a, b'
        " in zip(g.velocity, g.rigid_velocity))) for v, w in zip(g.velocity, g.rigid_velocity)],"
        " (GAIN,))",
        "in the steady turn the thrust has no",
    ),
    "along x": (
        'LAW = ThrustLaw("l", "", lambda g, gain: (gain * g.velocity[0], 0.0, 0.0), (GAIN,))',
        "the thrust must turn with the satellites",
    ),
    "odd power": (
        'LAW = ThrustLaw("l", "", lambda g, gain: [gain * g.mass ** 0.3 * d for d in g.place],'
        " (GAIN,))",
        "has a power of 0.3: exponents must be multiples of 1/64",
    ),
    "bead law by velocity": (
        'LAW = BeadLaw("l", "", lambda m, gain: [-gain * v for v in m.velocity], (GAIN,))',
        "depends on the velocity: say by_velocity=True",
    ),
    "bead law of a frame": (
        'LAW = BeadLaw("l", "", lambda m, gain: [-gain * v for v in m.velocity], (GAIN,),'
        " by_velocity=True, from_potential=False)",
        "must be the same in axes that turn otherwise",
    ),
    "bead law without potential": (
        'LAW = BeadLaw("l", "", lambda m, gain: (-gain * m.position[1], gain * m.position[0], 0),'
        " (GAIN,))",
        "is no gradient of a potential: say from_potential=False",
    ),
    "bead law out of the plane": (
        'LAW = BeadLaw("l", "", lambda m, gain: (0.0, 0.0, gain), (GAIN,))', "say keeps_plane=False"
    ),
    "bead law of the Sun": (
        'LAW = BeadLaw("l", "", lambda m, gain: [gain * s for s in m.sun], (GAIN,),'
        " keeps_plane=False)",
        "say feels_stars=True",
    ),
    "bead law of the pole": (
        'LAW = BeadLaw("l", "", lambda m, gain: [gain * s for s in m.pole], (GAIN,),'
        " keeps_plane=False)",
        "say feels_pole=",
    ),
    "bead law of the orbit": (
        'LAW = BeadLaw("l", "", lambda m, gain: [gain * x for x in m.position], (GAIN,),'
        " orbit=lambda radius, gain: gain)",
        "leave `orbit` out",
    ),
    "tether's damping": (
        'LAW = TetherLaw("l", "", lambda t: t.length - t.rest, lambda t: 0.0, pushes=True)',
        "the tension must grow by damping",
    ),
    "tether's rest": (
        'LAW = TetherLaw("l", "", lambda t: t.stiffness * t.length + t.damping * t.rate,'
        " lambda t: 0.0, pushes=True)",
        "the tension at the rest length must be 0, got 50000 N",
    ),
    "tether's slope": (
        'LAW = TetherLaw("l", "", lambda t: t.stiffness * (t.rest - t.length) + t.damping * t.rate,'
        " lambda t: 0.0, pushes=True)",
        "the tension must grow with length; not at a strain of 1e-06",
    ),
    "tether's energy": (
        'LAW = TetherLaw("l", "", lambda t: t.stiffness * (t.length - t.rest) + t.damping * t.rate,'
        " lambda t: t.stiffness * (t.length - t.rest) ** 2, pushes=True)",
        "the energy's slope must be the tension at rate 0",
    ),
    "reel's rest": (
        'LAW = ReelLaw("l", "", lambda r, gain: gain * (r.rate + 1.0), (GAIN,))',
        "the force must be 0 where nothing is paid out and the reel stands, got 10 N",
    ),
    "reel's jump": (
        'LAW = ReelLaw("l", "", lambda r, gain: gain * r.rate / sqrt(r.rate**2 + r.paid_out**2),'
        " (GAIN,))",
        "where the reel stands the force has no",
    ),
    "reel's components": (
        'LAW = ReelLaw("l", "", lambda r, gain: (gain * r.rate, 0.0), (GAIN,))',
        "its force failed: TypeError",
    ),
    "parameter of reels": (
        'LAW = ReelLaw("l", "", lambda r, paid_out: paid_out * r.rate,'
        ' (LawParameter("paid_out", "", "", 0, 1, 0),))',
        "another name: 'paid_out' is taken",
    ),
    "no law": ("LAW = GAIN", "bad:LAW of TSS_ROS_LAWS must be a BeadLaw, .*, got LawParameter"),
    "not there": ("", "bad:LAW of TSS_ROS_LAWS could not be loaded: AttributeError"),
    "its own error": ("raise OSError('no file')", "could not be loaded: OSError: no file"),
    "more of the core": (
        "from tss_ros.core import ring", "its module may import tss_ros.core.model.contract and"
    ),
}  # fmt: skip
BEGINNING = """
from tss_ros.core.model.contract import BeadLaw, LawParameter, ReelLaw, TetherLaw, ThrustLaw
from tss_ros.core.numerics.expressions import sqrt

GAIN = LawParameter("gain", "Gain", "N s/m", 0.0, 1e3, 0.0)


def linear(g, gain):
    return tuple(-gain * d for d in g.place)


"""
#: Loads the laws of several modules, one after another, and prints what is said of each.
REFUSALS = """
import json, os, sys
said = []
for name in sys.argv[1:]:
    os.environ["TSS_ROS_LAWS"] = f"{name}:LAW"
    for module in [name for name in sys.modules if name.startswith(("tss_ros.core.model", "bad"))]:
        del sys.modules[module]
    try:
        import tss_ros.core.model.laws
        said.append("")
    except ValueError as error:
        said.append(f"{type(error).__name__}: {error}")
print(json.dumps(said))
"""


@pytest.fixture(scope="module")
def refusals(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    names = [f"bad_{k}" for k in range(len(BAD))]
    for name, (text, _) in zip(names, BAD.values()):
        (folder / f"{name}.py").write_text(BEGINNING + text + "\n")
    (folder / "program.py").write_text(REFUSALS)
    done = run("", folder, more=[str(folder / "program.py"), *names])
    assert done.returncode == 0, done.stderr
    said = (re.sub(r"\bbad_\d+:", "bad:", words) for words in json.loads(done.stdout))
    return dict(zip(BAD, said))


@pytest.mark.parametrize("case", BAD)
def test_a_bad_law_is_refused_with_what_is_wrong(refusals, case):
    words, said = BAD[case][1], refusals[case]
    assert said.startswith("TssError: bad:LAW of TSS_ROS_LAWS")
    assert all(part in said for part in words.split(".*")), said


def test_a_command_says_in_a_line_what_is_wrong(tmp_path):
    for laws, words in (
        ("my_law", "TSS_ROS_LAWS must have the form module:NAME,module:NAME, got 'my_law'"),
        ("nowhere:LAW", "nowhere:LAW of TSS_ROS_LAWS could not be loaded: ModuleNotFoundError"),
    ):
        done = run("", tmp_path, laws, more=["-m", "tss_ros", "summary", "nothing.mcap"])
        assert done.returncode == 1 and words in done.stderr
        assert done.stderr.startswith("summary: ") and done.stderr.count("\n") == 1


@pytest.mark.parametrize("name", ["satellites", "turns"])
def test_a_parameter_that_scenarios_have_already_is_refused(name, tmp_path):
    (tmp_path / "one_law.py").write_text(
        ONE_LAW.replace("law_gain", name).replace("FACTOR * ", "").replace("from law_h", "# ")
    )
    done = run("import tss_ros.scenarios.parameters", tmp_path, "one_law:LAW")
    words = f"TssError: a law's parameter needs another name: there is one called '{name}'"
    assert words in done.stderr


@pytest.mark.parametrize(
    "law", [*TETHER_LAWS, *BEAD_LAWS, *THRUST_LAWS, *REEL_LAWS], ids=lambda law: law.name
)
def test_the_package_s_own_laws_would_pass(law):
    if getattr(law, "orbit", None) is None:
        assert statement(law)
