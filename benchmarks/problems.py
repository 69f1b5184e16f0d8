"""What is measured: the motions and turns, with starts, ends and the errors that count."""

import math

import numpy as np

from tss_ros.core import State, initial_state, ring
from tss_ros.core.model import forces
from tss_ros.core.model.kernel_arrays import kernel_arrays

MOTION_ERROR, MODULUS_ERROR = 1e-8, 1e-6


def cut(beads):
    """A 3-star ring of Table 1 with so many beads in all, satellites included."""
    return {"beads_per_tether": [(beads - 3 + k) // 3 for k in (2, 1, 0)]}


_SIX_BEAD = {"satellite_mass_kg": 1000.0, "beads_per_tether": 1}
#: Motions: parameters of `ring`, rate [Omega], push [m], turns.
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
#: Undisturbed turns for the monodromy matrix.
TURNS = {
    f"{name}{damping}": ({"damping_n_s_per_m": float(damping)}, rate, 0.0, 1)
    for name, rate in (("M", -2.9), ("S", -2.2))
    for damping in (2000, 100, 1)
}
TURNS["6-bead turn"] = (_SIX_BEAD, -2.9, 0.0, 1)
LONG_TURNS = {"30 beads turn": (cut(30), -2.9, 0.0, 1)}
CASES = {**MOTIONS, **LAW_MOTIONS, **LONG_MOTIONS, **TURNS, **LONG_TURNS}


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
        self.system = ring(**parameters)
        self.spin = self.system.spin_rate_rad_s(rate)
        state = initial_state(self.system, rate)
        self.n = self.system.n
        offset = np.sin(1.0 + np.arange(3 * self.n))
        offset *= push / np.linalg.norm(offset)
        self.start = State(state.position_m + offset.reshape(-1, 3), state.velocity_m_s)
        self.radius = np.max(np.linalg.norm(state.position_m, axis=1))
        self.speed = abs(self.spin) * self.radius
        self.end_s = turns * 2.0 * math.pi / abs(self.spin)

    def taut(self):
        """Which tethers start taut, shape (m,): those longer than at rest, or growing."""
        excess, growth = np.empty((2, self.system.m))
        arrays = kernel_arrays(self.system, self.spin)
        forces.stretch(arrays, 0.0, *self._parts(self.turning()), excess, growth)
        return (excess > 0.0) | ((excess == 0.0) & (growth > 0.0))

    def orbit(self):
        """Start (6n,) in the orbit frame, velocities first."""
        return np.concatenate([np.ravel(self.start.velocity_m_s), np.ravel(self.start.position_m)])

    def turning(self):
        """Start (6n,) in the turning frame, velocities first."""
        v, r = self._parts(self.orbit().copy())
        v -= self.spin * np.stack([-r[:, 1], r[:, 0], np.zeros(self.n)], axis=1)
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
        v = v + self.spin * np.stack([-r[:, 1], r[:, 0], np.zeros(self.n)], axis=1)
        if self.turns == int(self.turns):
            return r, v
        cos, sin = math.cos(self.spin * self.end_s), math.sin(self.spin * self.end_s)
        back = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return r @ back, v @ back

    def scaled(self, matrix, frame):
        """Monodromy matrix of whole turns, in SI units, scaled and in the turning frame."""
        units, size = self.units(), 3 * self.n
        matrix = np.asarray(matrix, dtype=float)
        if frame == "orbit":
            cross = self.spin * np.kron(np.eye(self.n), [[0, 1, 0], [-1, 0, 0], [0, 0, 0]])
            there, back = np.eye(2 * size), np.eye(2 * size)
            there[:size, size:], back[:size, size:] = cross, -cross
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
