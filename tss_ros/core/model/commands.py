"""What acts on a formation from outside: thrusters that push its beads, and tethers that fail."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from tss_ros.core.errors import TssError
from tss_ros.core.model.frames import Z_AXIS, turn_about
from tss_ros.core.model.kernel_arrays import KernelArrays
from tss_ros.core.model.sky import CENTRE_VELOCITY, sky_at
from tss_ros.core.model.system import System
from tss_ros.core.numerics.simd import kernel

#: Axes that a force may rest in: those of the orbit frame; those that the orbit frame has at time
#: 0, fixed among the stars; those at time 0, turning with the spin against the orbit frame.
FRAMES = ("orbit", "inertial", "spinning")
#: Rest length [m] of a tether that is cut: it never becomes taut.
NEVER_M = 1e15


class Commands(NamedTuple):
    """What acts from one instant on until it is changed.

    Attributes
    ----------
    force_n : ndarray, shape (3, n, 3)
        [N] on each bead, along the axes of each of `FRAMES`; they add up.
    cut : ndarray, shape (m,), bool
        Which tether segments pull no longer.
    """

    force_n: np.ndarray
    cut: np.ndarray

    @classmethod
    def none(cls, system: System) -> Commands:
        """No force, and every tether whole."""
        return cls(np.zeros((len(FRAMES), system.n, 3)), np.zeros(system.m, dtype=bool))

    @classmethod
    def of(
        cls,
        system: System,
        forces: Iterable[tuple[str, str, Sequence[float]]] = (),
        cut: Iterable[str] = (),
    ) -> Commands:
        """Forces and failures by name.

        Parameters
        ----------
        system : System
        forces : iterable of (bead, frame, force)
            Names of a bead and of one of `FRAMES`, and x, y, z [N].
        cut : iterable of str
            Names of tether segments.

        Raises
        ------
        TssError
            If there is no bead, frame or segment of a name, or if a force is no three numbers.
        """
        commands = cls.none(system)
        for bead, frame, force_n in forces:
            place = _index("frame", frame, FRAMES), _index("bead", bead, system.bead_name)
            if np.shape(force_n) != (3,):
                raise TssError(f"force on {bead} must be x, y, z [N], got {force_n!r:.80}")
            commands.force_n[place] += force_n
        for tether in cut:
            commands.cut[_index("tether", tether, system.tether_name)] = True
        return commands.checked(system)

    @property
    def pushes(self) -> bool:
        """Whether a force acts."""
        return bool(self.force_n.any())

    @property
    def acts(self) -> bool:
        """Whether there is anything but what acts without commands."""
        return self.pushes or bool(self.cut.any())

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
        force_n, cut = np.array(self.force_n, dtype=float), np.array(self.cut, dtype=bool)
        shape = (len(FRAMES), system.n, 3)
        if force_n.shape != shape or cut.shape != (system.m,):
            raise TssError(
                f"commands for {system.n} beads and {system.m} tethers need force_n of shape"
                f" {shape} and cut of shape ({system.m},), got {force_n.shape} and {cut.shape}"
            )
        if not np.isfinite(force_n).all():
            raise TssError("force_n must be finite, got NaN or infinity")
        return Commands(force_n, cut)

    def in_arrays(
        self, arrays: KernelArrays, system: System, spin_rate_rad_s: float, since_s: float = 0.0
    ) -> KernelArrays:
        """Kernels' arrays of a system, with these commands in place of others.

        Parameters
        ----------
        arrays : KernelArrays
        system : System
        spin_rate_rad_s : float
            omega [rad/s] about the formation's axis.
        since_s : float
            Time at which the time of the kernels begins.

        Returns
        -------
        KernelArrays
        """
        thrust, axis = np.empty((0, 0, 0)), system.spin_axis
        if self.pushes:
            thrust = self.force_n / system.mass_kg[:, None]
            thrust[1] = thrust[1] @ turn_about(Z_AXIS, -arrays.rate * since_s).T
            thrust[2] = thrust[2] @ turn_about(axis, spin_rate_rad_s * since_s).T
        return arrays._replace(
            rest=np.where(self.cut, NEVER_M, system.rest_length_m),
            stiffness=np.where(self.cut, 0.0, system.axial_stiffness_n / system.rest_length_m),
            damping=np.where(self.cut, 0.0, system.damping_n_s_per_m),
            thrust=thrust,
            thrust_axis=tuple(map(float, axis)),
            thrust_spin=float(spin_rate_rad_s),
        )


def _index(what, name, names):
    if name not in names:
        raise TssError(f"{what} is {name!r:.80}; allowed: {', '.join(names):.200}")
    return names.index(name)


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
