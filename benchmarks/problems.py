"""What is measured: the motions and turns, with starts, ends and the errors that count."""

import numpy as np

from tss_ros.core import State, formation, initial_state
from tss_ros.core.model import forces
from tss_ros.core.model.frames import Z_AXIS, rigid_velocity, turn_about
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.model.orbits import reference_orbit

MOTION_ERROR, MODULUS_ERROR = 1e-8, 1e-6


def cut(beads):
    """A 3-star ring of Table 1 with so many beads in all, satellites included."""
    return {"beads_per_tether": [(beads - 3 + k) // 3 for k in (2, 1, 0)]}


_SIX_BEAD = {"satellite_mass_kg": 1000.0, "beads_per_tether": 1}
#: Motions: parameters of `formation`, a ring if no shape is said, rate [Omega], push [m], turns;
#: of a formation that hangs, rate 0, a turn is an orbit.
MOTIONS = {
    f"{name}{damping}": (
        {"damping_n_s_per_m": float(damping)},
        rate,
        push,
        2 if (name, damping) == ("B", 1) else 10,
    )
    for name, rate, push in (("A", -2.9, 0.05), ("B", -2.2, 10.0))
    for damping in (1, 100, 2000)
}
MOTIONS["6-bead"] = (_SIX_BEAD, -2.9, 0.05, 10)
LONG_MOTIONS = {f"{beads} beads": (cut(beads), -2.9, 0.05, 0.1) for beads in (30, 100, 300)}
#: What else acts on A1 and B1: parameters of laws. The drag is that of a low orbit.
LAWS = {
    "J2": {"j2": 1.08263e-3},
    "drag": {
        "orbit_altitude_m": 400e3,
        "drag_m2_per_kg": 0.02,
        "air_density_kg_m3": 3e-12,
        "scale_height_m": 58e3,
    },
}
LAW_MOTIONS = {
    f"{name} {law}": ({**MOTIONS[name][0], **parameters}, *MOTIONS[name][1:])
    for law, parameters in LAWS.items()
    for name in ("A1", "B1")
}
_CHAIN = {"shape": "chain", "satellites": 4, "damping_n_s_per_m": 1.0}
#: As the scenario double_pyramid_earth_facing, but for the damping.
_PYRAMID = {
    "shape": "double_pyramid",
    "satellites": 4,
    "satellite_mass_kg": [50.0] * 4 + [500.0] * 2,
    "tether_length_m": [1414.2] * 4 + [3162.3] * 8,
    "damping_n_s_per_m": 100.0,
    "spin_axis": [0.0, 1.0, 0.0],
}
_INCLINED = {
    "damping_n_s_per_m": 1.0,
    "j2": LAWS["J2"]["j2"],
    "inclination_deg": 51.6,
    "argument_of_perigee_deg": 40.0,
}
#: Formations that hang or face the Earth, on a circle.
FORMATION_MOTIONS = {
    "chain": (_CHAIN, 0.0, 0.05, 2),
    "pyramid": (_PYRAMID, 5.0, 0.05, 10),
}
#: On orbits that are no circles.
ORBIT_MOTIONS = {
    "ellipse": ({"damping_n_s_per_m": 100.0, "eccentricity": 0.1}, -2.9, 0.05, 10),
    "inclined J2": (_INCLINED, -2.2, 10.0, 2),
}
#: Undisturbed turns for the monodromy matrix.
TURNS = {
    f"{name}{damping}": ({"damping_n_s_per_m": float(damping)}, rate, 0.0, 1)
    for name, rate in (("M", -2.9), ("S", -2.2))
    for damping in (2000, 100, 1)
}
TURNS["6-bead turn"] = (_SIX_BEAD, -2.9, 0.0, 1)
LONG_TURNS = {"30 beads turn": (cut(30), -2.9, 0.0, 1)}
FORMATION_TURNS = {
    "chain turn": (_CHAIN, 0.0, 0.0, 1),
    "pyramid turn": (_PYRAMID, 5.0, 0.0, 1),
}
_DUMBBELL = {"shape": "chain", "satellites": 2, "damping_n_s_per_m": 100.0, "eccentricity": 0.1}
ORBIT_TURNS = {
    "ellipse turn": (_DUMBBELL, 0.0, 0.0, 1),
    "inclined J2 turn": (_INCLINED, -2.2, 0.0, 1),
}
#: Positions [m] and velocities [m/s] of motions that close, for the others `initial_state` will do.
STARTS = {
    "ellipse turn": (
        [
            [0.00267544626799325, 5000.162203068908, 0.0],
            [-0.00267544626799325, -5000.162203068908, 0.0],
        ],
        [
            [-0.39087034317043823, 1.350558169144054e-06, 0.0],
            [0.3830683256215365, -1.350558169144054e-06, 0.0],
        ],
    ),
}
OTHER_MOTIONS = {**FORMATION_MOTIONS, **ORBIT_MOTIONS}
OTHER_TURNS = {**FORMATION_TURNS, **ORBIT_TURNS}
ALL_TURNS = {**TURNS, **LONG_TURNS, **OTHER_TURNS}
CASES = {**MOTIONS, **LAW_MOTIONS, **LONG_MOTIONS, **OTHER_MOTIONS, **ALL_TURNS}


class Problem:
    """One case: system, spin rate [rad/s], start, and where it ends [s].

    Parameters
    ----------
    name : str
        One of `CASES`.
    """

    def __init__(self, name):
        parameters, rate, push, turns = CASES[name]
        self.name, self.turns = name, turns
        self.system = formation(**{"shape": "ring", **parameters})
        self.spin = self.system.spin_rate_rad_s(rate)
        self.turning_rate = self.system.turning_rad_s(self.spin)
        self.reference = None if self.system.autonomous else reference_orbit(self.system)
        state = initial_state(self.system, rate)
        if name in STARTS:
            state = State(*STARTS[name])
        self.n = self.system.n
        offset = np.sin(1.0 + np.arange(3 * self.n))
        offset *= push / np.linalg.norm(offset)
        self.start = State(state.position_m + offset.reshape(-1, 3), state.velocity_m_s)
        self.radius = np.max(np.linalg.norm(state.position_m, axis=1))
        self.speed = max(abs(self.spin), self.system.orbit_rate_rad_s) * self.radius
        self.end_s = turns * self.system.period_s(rate)

    def taut(self):
        """Which tethers start taut, shape (m,): those longer than at rest, or growing."""
        excess, growth = np.empty((2, self.system.m))
        arrays = kernel_arrays(self.system, self.turning_rate)
        forces.stretch(arrays, 0.0, *self._parts(self.turning()), excess, growth)
        return (excess > 0.0) | ((excess == 0.0) & (growth > 0.0))

    def orbit(self):
        """Start (6n,) in the orbit frame, velocities first."""
        return np.concatenate([np.ravel(self.start.velocity_m_s), np.ravel(self.start.position_m)])

    def turning(self):
        """Start (6n,) in the turning frame, velocities first."""
        v, r = self._parts(self.orbit().copy())
        if self.reference:
            v = self.reference.into_even_frame(v, r)
        v = v - rigid_velocity(r, self.turning_rate)
        return np.concatenate([v.ravel(), r.ravel()])

    def units(self):
        """Scales (6n,) of velocities [m/s], then of positions [m]."""
        return np.repeat([self.speed, self.radius], 3 * self.n)

    def _parts(self, x):
        return x[: 3 * self.n].reshape(-1, 3), x[3 * self.n :].reshape(-1, 3)

    def from_orbit(self, x):
        """Positions and velocities of a state (6n,) of the orbit frame, velocities first."""
        v, r = self._parts(np.asarray(x, dtype=float))
        return r, v

    def from_turning(self, x):
        """The same of a state of the turning frame at the end; all errors are of the orbit's."""
        v, r = self._parts(np.asarray(x, dtype=float))
        v = v + rigid_velocity(r, self.turning_rate)
        if self.turns != int(self.turns):
            back = turn_about(Z_AXIS, self.turning_rate * self.end_s).T
            r, v = r @ back, v @ back
        if self.reference:
            even = self.reference.out_of_even_frame(np.array([self.end_s]), v[None], r[None])
            v, r = (x[0] for x in even)
        return r, v

    def scaled(self, matrix, frame):
        """Monodromy matrix of whole turns, in SI units, scaled and in the turning frame.

        Of one in the orbit frame on a circle, or "inertial": along its axes at time 0.
        """
        units, size = self.units(), 3 * self.n
        matrix = np.asarray(matrix, dtype=float)
        if frame != "turning":
            faster = self.turning_rate
            if frame == "inertial":
                faster += self.system.orbit_rate_rad_s
            cross = faster * np.kron(np.eye(self.n), [[0, 1, 0], [-1, 0, 0], [0, 0, 0]])
            there, back = np.eye(2 * size), np.eye(2 * size)
            there[:size, size:], back[:size, size:] = cross, -cross
            if frame == "inertial":
                turned = turn_about(Z_AXIS, faster * self.end_s).T
                there = np.kron(np.eye(2 * self.n), turned) @ there
            matrix = there @ matrix @ back
        return matrix * units / units[:, None]

    def distance(self, one, other):
        """Largest distance of two final states, of position over R_1, of velocity over its rim."""
        return max(
            np.linalg.norm(np.subtract(a, b), axis=1).max() / unit
            for a, b, unit in zip(one, other, (self.radius, self.speed))
        )


def largest_modulus(matrix):
    """Largest modulus of the multipliers of a monodromy matrix."""
    return float(np.abs(np.linalg.eigvals(np.asarray(matrix, dtype=float))).max())
