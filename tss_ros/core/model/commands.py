"""What acts on a formation from outside: thrusters, reels of tethers, and tethers that fail."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tss_ros.core.errors import TssError, index_of
from tss_ros.core.model.cubics import cubic_at, cubic_crossings, cubic_from
from tss_ros.core.model.frames import Z_AXIS, turn_about
from tss_ros.core.model.kernel_arrays import ROW, KernelArrays
from tss_ros.core.model.reels import (
    NEVER_M,
    SHORTEST_M,
    Deployment,
    deployment,
    reel_index,
    reels,
    segment_rests,
    whole_lengths,
)
from tss_ros.core.model.sky import CENTRE_VELOCITY, sky_at
from tss_ros.core.model.system import System
from tss_ros.core.numerics.simd import kernel

#: Axes that a force may rest in: those of the orbit frame; those that the orbit frame has at time
#: 0, fixed among the stars; those at time 0, turning with the spin against the orbit frame.
FRAMES = ("orbit", "inertial", "spinning")
#: How far a rest length [m] may jump where commands change, relative to it and in metres.
CONTINUOUS = 1e-9, 1e-6
#: How far ahead [s] the end of a reel is looked for: rates of rounding errors come to theirs later.
HORIZON_S = 1e10


class Commands(NamedTuple):
    """What acts from one instant on until it is changed.

    Attributes
    ----------
    force_n : ndarray, shape (3, n, 3)
        [N] on each bead, along the axes of each of `FRAMES`; they add up.
    cut : ndarray, shape (m,), bool
        Which tether segments pull no longer.
    reel : ndarray, shape (p, 5)
        For each of `reels.reels` the rest length out as a cubic: a time [s], and from there on
        length [m], rate [m/s], and the coefficients of the square and the cube of the time passed.
    """

    force_n: np.ndarray
    cut: np.ndarray
    reel: np.ndarray

    @classmethod
    def none(cls, system: System) -> Commands:
        """No force, and every tether whole and out."""
        lengths = whole_lengths(system)
        reel = np.zeros((lengths.size, 5))
        reel[:, 1] = lengths
        return cls(np.zeros((len(FRAMES), system.n, 3)), np.zeros(system.m, dtype=bool), reel)

    @classmethod
    def of(
        cls,
        system: System,
        forces: Iterable[tuple[str, str, Sequence[float]]] = (),
        cut: Iterable[str] = (),
        reel: Mapping[str, Sequence[float]] | None = None,
    ) -> Commands:
        """Forces, failures and reels by name.

        Parameters
        ----------
        system : System
        forces : iterable of (bead, frame, force)
            Names of a bead and of one of `FRAMES`, and x, y, z [N].
        cut : iterable of str
            Names of tether segments.
        reel : dict of str to sequence of float
            By name of a whole tether: a time [s], and the rest length out from there on as up to
            four coefficients, [m], [m/s] and so on.

        Raises
        ------
        TssError
            If there is no bead, frame, segment or tether of a name, or if a force is no three
            numbers.
        """
        commands = cls.none(system)
        for bead, frame, force_n in forces:
            place = index_of("frame", frame, FRAMES), index_of("bead", bead, system.bead_name)
            if np.shape(force_n) != (3,):
                raise TssError(f"force on {bead} must be x, y, z [N], got {force_n!r:.80}")
            commands.force_n[place] += force_n
        for tether in cut:
            commands.cut[index_of("tether", tether, system.tether_name)] = True
        for tether, numbers in (reel or {}).items():
            if not 2 <= np.size(numbers) <= 5:
                raise TssError(
                    f"reel of {tether} must be a time and 1 to 4 coefficients, got {numbers!r:.80}"
                )
            row = commands.reel[reel_index(system, tether)]
            row[:], row[: np.size(numbers)] = 0.0, numbers
        return commands.checked(system)

    @property
    def pushes(self) -> bool:
        """Whether a force acts."""
        return bool(self.force_n.any())

    @property
    def unreels(self) -> bool:
        """Whether a rest length changes."""
        return bool(self.reel[:, 2:].any())

    def acts(self, system: System) -> bool:
        """Whether there is anything but what acts without commands."""
        return self != Commands.none(system)

    def all_out(self, system: System) -> bool:
        """Whether rest lengths are those of the system, and stay."""
        return not self.unreels and np.array_equal(self.reel[:, 1], whole_lengths(system))

    def part_out(self, system: System, time_s: float) -> Deployment:
        """What of a system is out at a time [s]."""
        lengths = self.lengths_out(time_s)[0]
        out = (reel.segments_out(length) for reel, length in zip(reels(system), lengths))
        return deployment(system, tuple(out))

    def lengths_out(self, time_s: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rest length [m] out of each whole tether at times (...), and its rate [m/s]: (..., p)."""
        since, *cubics = self.reel.T
        return cubic_at(cubics, np.asarray(time_s, dtype=float)[..., None] - since)

    def rests(self, system: System, time_s: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rest length [m] of each segment at times (...), and its rate [m/s]: (..., m)."""
        return segment_rests(system, *self.lengths_out(time_s))

    def crossings(self, reel: int, length_m: float, first_s: float, last_s: float) -> list[float]:
        """Times [s] between two at which so much of a whole tether is out, in order."""
        since, *cubic = self.reel[reel].tolist()
        times = (since + time for time in cubic_crossings(cubic, length_m))
        return [time for time in times if first_s < time < last_s]

    def hand_overs(
        self, system: System, first_s: float, last_s: float
    ) -> list[tuple[float, tuple[int, ...]]]:
        """When beads leave reels or are taken in.

        Parameters
        ----------
        system : System
        first_s, last_s : float
            [s] while these commands act; the last one may be infinite.

        Returns
        -------
        list of (float, tuple of int)
            Times [s] from the first one on, and segments out of each whole tether from then on.
        """
        lines = reels(system)
        edges = {first_s}
        for i, line in enumerate(lines):
            for edge_m in line.edges_m:
                edges.update(self.crossings(i, edge_m, first_s, last_s))
        edges, found = [*sorted(edges), last_s], []
        for begin, end in zip(edges, edges[1:]):
            middle = 0.5 * (begin + end) if end < math.inf else begin + 1.0
            lengths = self.lengths_out(middle)[0]
            out = tuple(line.segments_out(x) for line, x in zip(lines, lengths))
            if not found or out != found[-1][1]:
                found.append((begin, out))
        return found

    def reels_that_stop(self, first_s: float) -> list[tuple[float, Commands]]:
        """These commands from a time [s] on, with every reel stopped where it comes to its end."""
        found, acting, begun = [(first_s, self)], self, first_s
        while True:
            ends = [
                (times[0], i)
                for i in range(len(self.reel))
                if (times := acting.crossings(i, SHORTEST_M, begun, begun + HORIZON_S))
            ]
            if not ends:
                return found
            begun, i = min(ends)
            reel = np.array(acting.reel)
            reel[i] = begun, SHORTEST_M, 0.0, 0.0, 0.0
            acting = acting._replace(reel=reel)
            found.append((begun, acting))

    def check_reels(self, system: System, before: Commands, first_s: float, last_s: float) -> None:
        """Raise TssError unless reels go on from others at a time [s], and last until another."""
        there, here = before.lengths_out(first_s)[0], self.lengths_out(first_s)[0]
        for i, line in enumerate(reels(system)):
            if abs(here[i] - there[i]) > CONTINUOUS[0] * abs(there[i]) + CONTINUOUS[1]:
                raise TssError(
                    f"rest length of {line.name} must go on from {there[i]:.9g} m at {first_s:g} s,"
                    f" got {here[i]:.9g}"
                )
            if not SHORTEST_M * (1.0 - CONTINUOUS[1]) <= there[i] < NEVER_M:
                raise TssError(f"rest length of {line.name} must be at least {SHORTEST_M:g} m")
            short = self.crossings(i, SHORTEST_M, first_s, last_s)
            if short and last_s < math.inf:
                raise TssError(
                    f"{line.name} would be shorter than {SHORTEST_M:g} m from {short[0]:.9g} s on:"
                    " let its reel stop before"
                )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Commands) and all(map(np.array_equal, self, other))

    def __ne__(self, other: object) -> bool:
        return not self == other

    __hash__ = None

    def checked(self, system: System) -> Commands:
        """A copy of its own.

        Raises
        ------
        TssError
            If it does not fit the system, or if a force is not finite.
        """
        parts = [np.array(x, dtype=kind) for x, kind in zip(self, (float, bool, float))]
        for name, part, like in zip(self._fields, parts, Commands.none(system)):
            if part.shape != like.shape:
                raise TssError(
                    f"commands for {system.n} beads and {system.m} tethers need {name} of shape"
                    f" {like.shape}, got {part.shape}"
                )
            if not np.isfinite(part).all():
                raise TssError(f"{name} must be finite, got NaN or infinity")
        return Commands(*parts)

    def in_arrays(
        self,
        arrays: KernelArrays,
        part: Deployment,
        spin_rate_rad_s: float,
        *,
        since_s: float = 0.0,
        time_s: float = 0.0,
    ) -> KernelArrays:
        """Kernels' arrays of the part of a system that is out, with these commands.

        Parameters
        ----------
        arrays : KernelArrays
            Of that part.
        part : Deployment
        spin_rate_rad_s : float
            omega [rad/s] about the formation's axis.
        since_s : float
            Time at which the time of the kernels begins, for the axes of forces.
        time_s : float
            Time of the kernels from which on they are meant.

        Returns
        -------
        KernelArrays
        """
        system = part.system
        thrust, axis, cut = np.empty((0, 0, 0)), system.spin_axis, self.cut[part.segments]
        if self.pushes:
            thrust = np.zeros((len(FRAMES), system.n, 3))
            for bead, carrier in enumerate(part.carrier):
                thrust[:, carrier] += self.force_n[:, bead]
            thrust /= system.mass_kg[:, None]
            thrust[1] = thrust[1] @ turn_about(Z_AXIS, -arrays.rate * since_s).T
            thrust[2] = thrust[2] @ turn_about(axis, spin_rate_rad_s * since_s).T
        reel = self._cubics(part, time_s)
        yields = arrays.inv_mass.size > arrays.beads
        if yields:
            reel[:, ROW:] = arrays.reel[:, ROW:]
        moves = yields or bool(reel[:, 1:ROW].any())
        share = np.ones(system.m) if moves else system.rest_length_m / reel[:, 0]
        rest = system.rest_length_m if moves else reel[:, 0]
        stiffness = share * (system.axial_stiffness_n / system.rest_length_m)
        reel[cut, :ROW] = NEVER_M, 0.0, 0.0, 0.0
        return arrays._replace(
            # Where reels yield their rest lengths as built are part of their law.
            rest=np.where(cut & (not yields), NEVER_M, rest),
            stiffness=np.where(cut, 0.0, stiffness),
            damping=np.where(cut, 0.0, share * system.damping_n_s_per_m),
            reel=reel if moves else np.empty((0, 6)),
            reel_since=float(time_s),
            thrust=thrust,
            thrust_axis=tuple(map(float, axis)),
            thrust_spin=float(spin_rate_rad_s),
        )

    def _cubics(self, part, time_s):
        """`KernelArrays.reel` of the segments out, cubics of the time since one [s], (m', 6)."""
        cubics = np.zeros((part.system.m, 6))
        cubics[:, 0], cubics[:, ROW] = part.system.rest_length_m, -1.0
        place = {k: i for i, k in enumerate(part.segments.tolist())}
        for line, whole, (since, *cubic) in zip(
            reels(part.whole), whole_lengths(part.whole), self.reel
        ):
            if cubic == [whole, 0.0, 0.0, 0.0]:
                continue
            paying, *others = [k for k in line.segments if k in place]
            cubics[place[paying], :ROW] = cubic_from(cubic, time_s - since)
            cubics[place[paying], 0] -= part.whole.rest_length_m[others].sum()
        return cubics


@kernel
def _orbit_axes(arrays, time):
    """Axes x, y, z of the orbit frame, one after the other, in the turning frame."""
    if arrays.orbit_starts.size > 0:
        sky = sky_at(arrays, time)
        ux, uy, uz = sky[0], sky[1], sky[2]
        vx, vy, vz = sky[CENTRE_VELOCITY], sky[CENTRE_VELOCITY + 1], sky[CENTRE_VELOCITY + 2]
        zx, zy, zz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        size = math.sqrt(zx * zx + zy * zy + zz * zz)
        zx, zy, zz = zx / size, zy / size, zz / size
        xx, xy, xz = uy * zz - uz * zy, uz * zx - ux * zz, ux * zy - uy * zx
        return xx, xy, xz, ux, uy, uz, zx, zy, zz
    c, s = math.cos(arrays.spin * time), math.sin(arrays.spin * time)
    zero = 0.0 * c
    return c, -s, zero, s, c, zero, zero, zero, zero + 1.0


@kernel
def add_commanded_thrust(arrays, time, a):
    """Add the accelerations (n, 3) by thrusters, in the turning frame at a time [s]."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = _orbit_axes(arrays, time)
    angle = (arrays.rate + arrays.spin) * time
    c, s = math.cos(angle), math.sin(angle)
    turned = arrays.thrust_spin * time
    along, across = math.cos(turned), math.sin(turned)
    kx, ky, kz = arrays.thrust_axis
    orbit, inertial, spinning = arrays.thrust[0], arrays.thrust[1], arrays.thrust[2]
    for i in range(orbit.shape[0]):
        x, y, z = spinning[i, 0], spinning[i, 1], spinning[i, 2]
        rest = (1.0 - along) * (kx * x + ky * y + kz * z)
        fx = orbit[i, 0] + along * x + across * (ky * z - kz * y) + rest * kx
        fy = orbit[i, 1] + along * y + across * (kz * x - kx * z) + rest * ky
        fz = orbit[i, 2] + along * z + across * (kx * y - ky * x) + rest * kz
        a[i, 0] += fx * xx + fy * yx + fz * zx + c * inertial[i, 0] + s * inertial[i, 1]
        a[i, 1] += fx * xy + fy * yy + fz * zy + c * inertial[i, 1] - s * inertial[i, 0]
        a[i, 2] += fx * xz + fy * yz + fz * zz + inertial[i, 2]
