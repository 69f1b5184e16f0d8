"""The orbit of the formation's nominal centre where it is no circle at rest: ellipses, and J2.

Its axes, fixed among the stars, are those of the orbit frame at time 0: y up, z along the orbit
normal, x against the flight. On an orbit round a round Earth the motion is Kepler's, in closed
form. The oblateness J2 bends it; it is integrated then, orbit by orbit, by collocation.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev
from numpy.polynomial.polynomial import polyint

from tss_ros.core.errors import TssError
from tss_ros.core.model import forces
from tss_ros.core.model.elements import axes_of, eccentric_anomaly, of_degrees
from tss_ros.core.model.frames import Z_AXIS, rigid_velocity, turn_about
from tss_ros.core.model.kernel_arrays import KernelArrays, kernel_arrays
from tss_ros.core.model.laws.oblateness import EQUATORIAL_RADIUS_M
from tss_ros.core.model.laws.solar_pressure import OBLIQUITY_DEG
from tss_ros.core.model.system import MU_EARTH, System

#: Degree of the polynomials of a table's piece, and its length over sqrt(R^3 / mu): collisions with
#: the Earth's centre, seven half-pieces away in complex time, set the accuracy, 1e-15.
DEGREE, PIECE = 14, 0.25
#: Most corrections of the accelerations in a piece, and orbits that are kept at hand.
MOST_CORRECTIONS, KEPT = 30, 64


class _Collocation:
    """Matrices that take accelerations at nodes of a piece to its polynomials.

    Time runs from -1 to 1, and all that is integrated begins at 0.
    """

    def __init__(self):
        count = DEGREE - 1
        self.nodes = chebyshev.chebpts1(count)
        to_powers = np.zeros((count, count))
        for k in range(count):
            to_powers[: k + 1, k] = chebyshev.cheb2poly(np.eye(count)[k])[: k + 1]
        powers = to_powers @ np.linalg.inv(chebyshev.chebvander(self.nodes, count - 1))
        once, self.twice = (polyint(powers, order, lbnd=-1.0, axis=0) for order in (1, 2))
        self.at_nodes = np.vander(self.nodes, DEGREE + 1, increasing=True) @ self.twice
        self.end_once, self.end_twice = once.sum(axis=0), self.twice.sum(axis=0)


_COLLOCATION = _Collocation()


class ReferenceOrbit:
    """The orbit of a system's nominal centre.

    Parameters
    ----------
    system : System

    Attributes
    ----------
    period_s, rate_rad_s : float
        Of one orbit, T [s] and Omega = 2 pi / T; that of the elements at time 0 where J2 bends it.
    repeats : bool
        Whether every orbit is like the first, so that the system is periodic with T.
    axes : ndarray, shape (3, 3)
        Columns: the axes x, y, z of the orbit frame at time 0 in Earth-centred inertial ones, of
        which x points to the vernal equinox and z to the north.
    """

    def __init__(self, system: System):
        values = system.law_parameters
        self.system, self.rate_rad_s = system, system.orbit_rate_rad_s
        self.period_s = 2.0 * math.pi / self.rate_rad_s
        self._e, self._on_circle = values["eccentricity"], system.on_circle
        self._a = system.orbit_radius_m / (1.0 - self._e)
        self._j2 = 0.0 if system.on_circle else values["j2"]
        self.repeats = self._j2 == 0.0
        self._cos, self._sin = of_degrees(values["true_anomaly_deg"])
        half = math.radians(math.remainder(values["true_anomaly_deg"], 360.0)) / 2.0
        apart = math.sqrt((1.0 - self._e) / (1.0 + self._e))
        anomaly = 2.0 * math.atan2(apart * math.sin(half), math.cos(half))
        self._mean_anomaly = anomaly - self._e * math.sin(anomaly)
        self.axes = axes_of(values)
        self._pole = self.axes[2]
        longitude = of_degrees(values["sun_longitude_deg"])
        tilt = of_degrees(OBLIQUITY_DEG)
        self._sun = np.array([longitude[0], longitude[1] * tilt[0], longitude[1] * tilt[1]])
        self._starts = [self._start()]
        self._orbits, self._lock = OrderedDict(), threading.Lock()

    # -- where it is ------------------------------------------------------------------------------

    def state(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Place and velocity of the centre from the Earth's centre, along the axes at time 0.

        Parameters
        ----------
        time_s : ndarray, shape (k,)
            None below 0 where J2 bends the orbit.

        Returns
        -------
        position_m, velocity_m_s : ndarray, shape (k, 3)
        """
        times = np.atleast_1d(np.asarray(time_s, dtype=float))
        if self.repeats:
            return self._kepler(times)
        q, v = np.empty((2, times.size, 3))
        if times.size and not times.min() >= 0.0:
            raise TssError(f"time_s must be at least 0, got {times.min():g}")
        orbit = np.floor(times / self.period_s).astype(int)
        for k in np.unique(orbit):
            chosen = orbit == k
            starts, table = self._orbit(int(k))[:2]
            local = times[chosen] - k * self.period_s
            piece = np.clip(np.searchsorted(starts, local, side="right") - 1, 0, len(table) - 1)
            half = 0.5 * (starts[piece + 1] - starts[piece])[:, None]
            s, rows = (local - starts[piece])[:, None] / half - 1.0, table[piece]
            place, slope = np.zeros((2, local.size, 3))
            for power in range(DEGREE, -1, -1):
                slope = slope * s + place
                place = place * s + rows[:, power]
            q[chosen], v[chosen] = place, slope / half
        return q, v

    def inertial_state(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Likewise, along Earth-centred inertial axes: see `axes`."""
        q, v = self.state(time_s)
        return q @ self.axes.T, v @ self.axes.T

    def frame(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The orbit frame: y up, z along the orbit normal.

        Parameters
        ----------
        time_s : ndarray, shape (k,)

        Returns
        -------
        axes : ndarray, shape (k, 3, 3)
            Rows: x, y, z along the axes at time 0.
        turning_rad_s : ndarray, shape (k, 3)
            How fast it turns against the stars, likewise: about z as the centre goes round, about
            y as the plane of the orbit turns.
        """
        q, v = self.state(time_s)
        radius = np.linalg.norm(q, axis=1)[:, None]
        momentum = np.cross(q, v)
        h = np.linalg.norm(momentum, axis=1)[:, None]
        up, normal = q / radius, momentum / h
        axes = np.stack([np.cross(up, normal), up, normal], axis=1)
        across = np.sum(self._acceleration(q) * normal, axis=1)[:, None]
        return axes, radius / h * across * up + h / radius**2 * normal

    def inertial_axes(self, time_s: np.ndarray) -> np.ndarray:
        """Columns (k, 3, 3): the orbit frame's axes x, y, z along Earth-centred inertial ones."""
        return np.einsum("ij,kcj->kic", self.axes, self.frame(time_s)[0])

    @property
    def node_rate_rad_s(self) -> float:
        """Mean rate of the ascending node, to first order in J2."""
        return -2.0 * self._drift * math.cos(self._inclination)

    @property
    def perigee_rate_rad_s(self) -> float:
        """Mean rate of the argument of the perigee, to first order in J2."""
        return self._drift * (5.0 * math.cos(self._inclination) ** 2 - 1.0)

    @property
    def _inclination(self):
        return math.radians(self.system.law_parameters["inclination_deg"])

    @property
    def _drift(self):
        parameter = self._a * (1.0 - self._e**2)
        j2 = self.system.law_parameters["j2"]
        flat = j2 * (EQUATORIAL_RADIUS_M / parameter) ** 2
        return 0.75 * self.system.mean_motion_rad_s * flat

    # -- between the frame that turns evenly and the orbit frame ----------------------------------

    def into_even_frame(self, v: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Velocities (..., rows, 3) at time 0 in the frame that turns at Omega about z.

        Of velocities and positions in the orbit frame; positions are the same in both. Rest
        lengths, as `KernelArrays` has them behind the n beads, are the same in every frame.
        """
        return v + self._carried(r)

    def from_even_frame(self, v: np.ndarray, r: np.ndarray) -> np.ndarray:
        """The inverse of `into_even_frame`."""
        return v - self._carried(r)

    def _carried(self, r):
        beads, velocity = r[..., : self.system.n, :], np.zeros_like(r)
        velocity[..., : self.system.n, :] = np.cross(self._faster, beads)
        return velocity

    @cached_property
    def _faster(self):
        _, turning = self.frame(np.zeros(1))
        return turning[0] - [0.0, 0.0, self.rate_rad_s]

    def out_of_even_frame(
        self, time_s: np.ndarray, v: np.ndarray, r: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Velocities and positions (k, rows, 3) in the orbit frame, at each time (k,) [s].

        Of those in the frame that turns at Omega about z and is the orbit frame at time 0.
        """
        axes, turning = self.frame(time_s)
        moved, n = (np.array(v), np.array(r)), self.system.n
        v, r = v[:, :n], r[:, :n]
        fixed_v, fixed_r = np.empty_like(v), np.empty_like(r)
        for k, time in enumerate(time_s):
            turn = turn_about(Z_AXIS, self.rate_rad_s * time)
            fixed_r[k] = r[k] @ turn.T
            fixed_v[k] = (v[k] + rigid_velocity(r[k], self.rate_rad_s)) @ turn.T
        fixed_v -= np.cross(turning[:, None], fixed_r)
        for rows, x in zip(moved, (fixed_v, fixed_r)):
            rows[:, :n] = np.einsum("kij,knj->kni", axes, x)
        return moved

    def relative_acceleration(
        self,
        time_s: float,
        taut: np.ndarray,
        v: np.ndarray,
        r: np.ndarray,
        arrays: KernelArrays | None = None,
    ) -> np.ndarray:
        """Accelerations (n, 3) [m/s^2] of beads as seen from the orbit frame.

        Parameters
        ----------
        time_s : float
        taut : ndarray, shape (m,), bool
            Which tethers exert a force.
        v, r : ndarray, shape (rows, 3)
            Velocities [m/s] and positions [m] in the orbit frame, and what follows the beads.
        arrays : KernelArrays, optional
            With what else acts, for a frame that turns evenly with Omega.
        """
        step = 1e-4 / self.rate_rad_s * (1.0 - self._e) ** 1.5
        axes, turning = self.frame(time_s + step * np.arange(3.0))
        axes, omega = axes[0], turning[0]
        faster = (4.0 * turning[1] - 3.0 * omega - turning[2]) / (2.0 * step)
        fixed_r, fixed_v = r[: self.system.n] @ axes, v[: self.system.n] @ axes
        rate = self.rate_rad_s
        turn = turn_about(Z_AXIS, rate * time_s)
        even_r = fixed_r @ turn
        even_v = (fixed_v + np.cross(omega, fixed_r)) @ turn - rigid_velocity(even_r, rate)
        rows_v, rows_r = (np.append(x, y[len(x) :], 0) for x, y in ((even_v, v), (even_r, r)))
        arrays, a = arrays or self.arrays(0.0), np.empty_like(r)
        if not self.repeats:
            arrays = self.with_table(arrays, time_s, time_s)
        forces.acceleration(arrays, taut, time_s, rows_v, rows_r, a)
        a = a[: self.system.n]
        a += rigid_velocity(2.0 * even_v + rigid_velocity(even_r, rate), rate)
        a = a @ turn.T - np.cross(faster, fixed_r)
        return (a - np.cross(omega, 2.0 * fixed_v + np.cross(omega, fixed_r))) @ axes.T

    # -- tables -----------------------------------------------------------------------------------

    def arrays(self, turning_rad_s: float) -> KernelArrays:
        """The system for kernels; its table is empty where `table` has to fill it in."""
        arrays = kernel_arrays(self.system, turning_rad_s)._replace(
            pole=tuple(map(float, self._pole)),
            sun=tuple(map(float, self.axes.T @ self._sun)),
        )
        if not self.repeats:
            return self.with_table(arrays, 0.0, self.period_s)
        return self.with_table(arrays, 0.0, 0.0)._replace(
            orbit_period=self.period_s, orbits_per_s=1.0 / self.period_s
        )

    def with_table(self, arrays: KernelArrays, first_s: float, last_s: float) -> KernelArrays:
        """The same with a table of all orbits between two times; each is whole in it."""
        first, last = (int(time / self.period_s) for time in (first_s, last_s))
        orbits = [self._orbit(k) for k in range(first, last + 1)]
        starts = [k * self.period_s + orbit[0][:-1] for k, orbit in enumerate(orbits, first)]
        return arrays._replace(
            orbit_starts=np.concatenate([*starts, [(last + 1) * self.period_s]]),
            orbit_table=np.concatenate([orbit[1] for orbit in orbits]),
        )

    def _orbit(self, k):
        """Starts of the pieces of an orbit from its own, their polynomials, and its end."""
        with self._lock:
            while len(self._starts) <= k:
                before = len(self._starts) - 1
                self._orbits[before] = self._made_orbit(before)
                self._starts.append(self._orbits[before][2])
            if k not in self._orbits:
                self._orbits[k] = self._made_orbit(k)
            self._orbits.move_to_end(k)
            while len(self._orbits) > KEPT:
                self._orbits.popitem(last=False)
            return self._orbits[k]

    def _made_orbit(self, k):
        q, v = self._starts[k]
        starts, tables = [0.0], []
        while starts[-1] < self.period_s:
            end = self._end_of_piece(starts[-1], float(np.linalg.norm(q)))
            table, q, v = self._piece(q, v, 0.5 * (end - starts[-1]))
            if self.repeats:
                q, v = (x[0] for x in self._kepler(np.array([end])))
            tables.append(table)
            starts.append(end)
        return np.array(starts), np.array(tables), (q, v)

    def _piece(self, q, v, half):
        """Polynomials of a piece from a state on, of this half length [s]; and the state there."""
        a, last = np.tile(self._acceleration(q), (DEGREE - 1, 1)), math.inf
        line = q + half * (1.0 + _COLLOCATION.nodes[:, None]) * v
        for _ in range(MOST_CORRECTIONS):
            before, a = a, self._acceleration(line + half**2 * (_COLLOCATION.at_nodes @ a))
            change = float(np.max(np.abs(a - before)))
            if change >= last and change < 1e-13 * np.max(np.abs(a)):
                break
            last = change
        table = half**2 * (_COLLOCATION.twice @ a)
        table[0] += q + half * v
        table[1] += half * v
        q = q + 2.0 * half * v + half**2 * (_COLLOCATION.end_twice @ a)
        return table, q, v + half * (_COLLOCATION.end_once @ a)

    def _end_of_piece(self, begin, radius):
        length = PIECE * math.sqrt(radius / MU_EARTH) * radius
        left = self.period_s - begin
        return self.period_s if left < 1.2 * length else begin + length

    def _start(self):
        radius = self._a * (1.0 - self._e**2) / (1.0 + self._e * self._cos)
        fast = math.sqrt(MU_EARTH / (self._a * (1.0 - self._e**2)))
        if self._on_circle:
            fast = radius * self.rate_rad_s
        along, out = fast * (1.0 + self._e * self._cos), fast * self._e * self._sin
        return np.array([0.0, radius, 0.0]), np.array([-along, out, 0.0])

    def _kepler(self, times):
        """Place and velocity (k, 3) along the axes at time 0, round a round Earth."""
        a, e = self._a, self._e
        mean = self._mean_anomaly + self.rate_rad_s * np.remainder(times, self.period_s)
        mean = np.remainder(mean + math.pi, 2.0 * math.pi) - math.pi
        anomaly = eccentric_anomaly(mean, e)
        c, s = np.cos(anomaly), np.sin(anomaly)
        fallen = 2.0 * a * np.sin(0.5 * anomaly) ** 2
        b, distance = a * math.sqrt(1.0 - e * e), a * (1.0 - e) + e * fallen
        fast = self.rate_rad_s * a / distance
        place = a * (1.0 - e) - fallen, b * s
        velocity = -fast * a * s, fast * b * c
        zero = np.zeros_like(c)
        return tuple(
            np.stack([x * self._sin - y * self._cos, x * self._cos + y * self._sin, zero], axis=1)
            for x, y in (place, velocity)
        )

    def _acceleration(self, q):
        """Of the centre at places (..., 3), along the axes at time 0 [m/s^2]."""
        square = np.sum(q * q, axis=-1, keepdims=True)
        if self._on_circle:
            return -(self.rate_rad_s**2) * q
        round_ = -MU_EARTH / (square * np.sqrt(square))
        above = np.sum(q * self._pole, axis=-1, keepdims=True)
        flat = 1.5 * self._j2 * EQUATORIAL_RADIUS_M**2 / square
        level = (1.0 + flat * (1.0 - 5.0 * above**2 / square)) * q
        return round_ * (level + 2.0 * flat * above * self._pole)


#: The latest system and its orbit.
_latest: list[tuple[System, ReferenceOrbit]] = []


def reference_orbit(system: System) -> ReferenceOrbit:
    """The orbit of a system; that of the latest one is kept, with what was integrated of it."""
    for known, orbit in list(_latest):
        if known is system:
            return orbit
    orbit = ReferenceOrbit(system)
    _latest[:] = [(system, orbit)]
    return orbit
