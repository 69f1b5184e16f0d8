"""Spin axes that rest in the orbit frame: where they may point, after Likins and Pringle.

A formation turns rigidly at omega about an axis s, (s1, s2, s3) along the vertical, the flight and
the orbit normal. With moments of inertia C about the axis and A across it, the torque of the
gravity gradient, averaged over a turn, keeps the axis at rest where

    (C omega_s - A Omega s3) (e3 x s) = 3 Omega (C - A) s1 (e1 x s),    omega_s = omega + Omega s3.

Three families of axes solve it (P. W. Likins, J. Spacecraft 2, 1965; R. Pringle, AIAA J. 2, 1964):
the cylindrical s = e3; the hyperbolic, across the vertical; the conical, across the flight.
"""

from __future__ import annotations

import math

import numpy as np

from tss_ros.core.errors import NoSteadyState
from tss_ros.core.model import forces
from tss_ros.core.model.averaged_balance import AveragedBalance
from tss_ros.core.model.frames import Z_AXIS, rigid_velocity, turn_to
from tss_ros.core.model.system import State, System

CYLINDRICAL, CONICAL, HYPERBOLIC = FAMILIES = ("cylindrical", "conical", "hyperbolic")
#: f in s3 = C w / (f (A - C)).
_FACTOR = {CONICAL: 4.0, HYPERBOLIC: 1.0}
#: Most beads of a formation whose shape and axis are found together.
MOST_BEADS = 400
#: Farthest [degrees] from the given axis at which one is sought.
NEAR_DEG = 45.0
#: A tether shorter than this share of its rest length has collapsed.
COLLAPSED = 0.5
#: Largest distance of a bead from its place in the layout, over the radius.
FARTHEST_MOVED = 0.6
#: Rates over the one asked for from which a balance is sought that is not found from the layout,
#: steps on the way, and most beads of a system for which that is done.
NEARBY, STEPS, MOST_SOUGHT = (0.95, 1.05, 0.9, 1.1, 0.8, 1.25, 0.65, 1.5), 9, 30
#: Relative difference of the two moments of inertia across the axis that is worth a word, and
#: largest share of A that C may have for a formation that lies on its axis.
UNEVEN, ON_AXIS = 0.01, 1e-6
#: What is added to a body's moments of inertia, over their sum.
ROUNDING = 1e-12


def spin_axis_of(system: System, state: State, spin_rate_rad_s: float) -> np.ndarray:
    """Unit vector about which the beads of a state spin, in the orbit frame.

    Parameters
    ----------
    system : System
    state : State
    spin_rate_rad_s : float
        Of which the sign counts: about the axis itself or the other way round.

    Returns
    -------
    ndarray, shape (3,)
        That of the system where it is the orbit normal, or where there is no spin; else that of
        the turn of a rigid body with the same angular momentum, as seen in the orbit frame.
    """
    if system.turning_rad_s(spin_rate_rad_s) or not spin_rate_rad_s:
        return system.spin_axis
    mass = system.mass_kg
    arm, speed = (
        x - np.average(x, axis=0, weights=mass) for x in (state.position_m, state.velocity_m_s)
    )
    momentum, second = mass @ np.cross(arm, speed), (mass[:, None] * arm).T @ arm
    # A line of beads tells no turn about itself: there is none, then.
    inertia = np.trace(second) * (1.0 + ROUNDING) * np.eye(3) - second
    turn = np.linalg.solve(inertia, momentum) if np.trace(second) else np.zeros(3)
    size = math.copysign(np.linalg.norm(turn), spin_rate_rad_s)
    return turn / size if size else system.spin_axis


def apart_deg(a: np.ndarray, b: np.ndarray) -> float:
    """Angle [degrees] between two unit vectors."""
    return math.degrees(2.0 * math.atan2(np.linalg.norm(a - b), np.linalg.norm(a + b)))


def resting_state(system: System, spin_rate_rad_s: float) -> tuple[State, str]:
    """The formation turning rigidly about the axis next to the given one at which it may rest.

    Parameters
    ----------
    system : System
    spin_rate_rad_s : float

    Returns
    -------
    State
        In the orbit frame.
    str
        Family and place of the axis, in words.

    Raises
    ------
    NoSteadyState
        If there is no axis next to the given one, or tethers do not hold the formation there.
    """
    given = system.spin_axis
    layout = system.layout_m - np.average(system.layout_m, axis=0, weights=system.mass_kg)
    body = layout @ turn_to(given)
    about, first, second = _moments(body, system.mass_kg)
    if about < ON_AXIS * second:
        raise NoSteadyState(f"no formation spins about {named(given)}: all its beads lie on it")
    ratio = spin_rate_rad_s / system.orbit_rate_rad_s
    family, s3 = _nearest(given, ratio, about, 0.5 * (first + second))
    if family != CYLINDRICAL and system.n > MOST_BEADS:
        raise NoSteadyState(
            f"steady axes other than the orbit normal are sought for at most {MOST_BEADS} beads,"
            f" got {system.n} about {named(given)}"
        )
    if family == CYLINDRICAL:
        axis = math.copysign(1.0, given[2]) * Z_AXIS
        place = layout @ turn_to(axis, given).T
        place = AveragedBalance(system, place, axis[2] * spin_rate_rad_s).solved(ratio)
    else:
        place, s3 = _balanced(system, body, spin_rate_rad_s, family, s3)
        about, first, second = _moments(place, system.mass_kg)
        rates = _rates(family, about, 0.5 * (first + second))
        if abs(s3) > 1.0:
            raise NoSteadyState(
                f"no steady axis next to {named(given)} at spin_rate_ratio {ratio:g}:"
                f" {_asked(family, s3)}; {rates}"
            )
        axis = _axis(family, s3, given)
        _require_near(axis, given, family, ratio, rates)
        place = place @ (turn_to(axis, given) @ turn_to(given)).T
    words = (
        f"{family} axis {apart_deg(axis, Z_AXIS):.4g} degrees from the orbit normal,"
        f" {apart_deg(axis, given):.3g} from the given one"
    )
    if (uneven := 2.0 * (second - first) / (first + second)) > UNEVEN:
        words += f", its moments of inertia across the axis {uneven:.0%} apart"
    return State(place, rigid_velocity(place, spin_rate_rad_s, axis)), words


def _balanced(system, body, spin, family, s3):
    """Places with the axis along z, and s3, in balance next to a layout.

    Where they are not found from the layout they are sought along the rate, from one nearby.
    """
    try:
        return _from(system, body, body, spin, family, s3)
    except NoSteadyState as error:
        refusal, known = str(error), ""
    for share in NEARBY if system.n <= MOST_SOUGHT else ():
        try:
            place, there = _from(system, body, body, spin * share, family, s3 * share)
        except NoSteadyState:
            continue
        known = f"; there is one at {spin * share / system.orbit_rate_rad_s:.4g}"
        try:
            for rate in np.linspace(share, 1.0, STEPS)[1:]:
                place, there = _from(system, body, place, spin * rate, family, there)
            return place, there
        except NoSteadyState:
            break
    raise NoSteadyState(refusal + known)


def _from(system, layout, place, spin, family, s3):
    """Places and s3 to which Newton's method leads from given ones, next to the layout."""
    ratio = spin / system.orbit_rate_rad_s
    balance = _AxisBalance(system, place, spin, family, s3)
    found = balance.solved(ratio)
    _require_shape(balance, layout, found[:-1], ratio)
    return found[:-1], found[-1, 0] / balance.radius


def _require_shape(balance, layout, place, ratio):
    """Refuse a balance in which the formation has fallen together, or tipped over."""
    system = balance.system
    share = forces.lengths_and_rates(system, place, place)[0] / system.rest_length_m
    worst = int(np.argmin(share))
    about, before = (_moments(x, system.mass_kg)[0] for x in (place, layout))
    moved = np.linalg.norm(place - layout, axis=1) / np.max(np.linalg.norm(layout, axis=1))
    farthest = int(np.argmax(moved))
    if share[worst] < COLLAPSED:
        words = f"tether {system.tether_name[worst]} shrinks to {share[worst]:.2g} of its length"
    elif about < COLLAPSED**4 * before:
        words = f"all beads fall to {math.sqrt(about / before):.2g} of their distance from the axis"
    elif moved[farthest] > FARTHEST_MOVED:
        words = f"{system.bead_name[farthest]} moves by {moved[farthest]:.2f} of the radius"
    else:
        return
    raise NoSteadyState(
        f"no taut configuration next to the layout at spin_rate_ratio {ratio:g}: {words}"
        f"{balance.pushing}"
    )


def _moments(place, mass):
    """Moments of inertia [kg m^2] about z and, smaller and larger, across it."""
    arm = place - np.average(place, axis=0, weights=mass)
    second = (mass[:, None] * arm).T @ arm
    about = second[0, 0] + second[1, 1]
    return about, *(second[2, 2] + np.linalg.eigvalsh(second[:2, :2]))


def _nearest(given, ratio, about, across):
    """Family and s3 of the axis next to a given one, by the moments of inertia of the layout."""
    wanted = {CYLINDRICAL: math.copysign(1.0, given[2])}
    for family, factor in _FACTOR.items():
        slope = factor * (across - about)
        wanted[family] = about * ratio / slope if slope else math.inf
    axes = {f: _axis(f, s3, given) for f, s3 in wanted.items() if abs(s3) <= 1.0}
    family = min(axes, key=lambda name: apart_deg(axes[name], given))
    others = [f for f in _FACTOR if f not in axes]
    rates = "; ".join(f"{_asked(f, wanted[f])}, {_rates(f, about, across)}" for f in others)
    _require_near(axes[family], given, family, ratio, rates)
    return family, wanted[family]


def _require_near(axis, given, family, ratio, more):
    if (apart := apart_deg(axis, given)) > NEAR_DEG:
        raise NoSteadyState(
            f"no steady axis within {NEAR_DEG:g} degrees of {named(given)} at spin_rate_ratio"
            f" {ratio:g}: the nearest, a {family} one, is {named(axis)}, {apart:.1f} degrees away"
            + (f"; {more}" if more else "")
        )


def _axis(family, s3, given):
    """The axis of a family on the side of a given one, along x, y and z."""
    if family == CYLINDRICAL:
        return np.array([0.0, 0.0, s3])
    beside = math.sqrt(max(1.0 - s3**2, 0.0))
    if family == CONICAL:
        return np.array([0.0, math.copysign(beside, given[1]), s3])
    return np.array([math.copysign(beside, given[0]), 0.0, s3])


def named(axis: np.ndarray) -> str:
    """An axis in words, "[0, 1, 0]"."""
    return f"[{', '.join(f'{x:.4g}' for x in axis + 0.0)}]"


def _asked(family, s3):
    return f"a {family} axis would need {abs(s3):.4g} of its length 1 along the orbit normal"


def _rates(family, about, across):
    most = _FACTOR[family] * abs(across - about) / about
    return f"there is a {family} one for rates of a size up to {most:.4g}"


class _AxisBalance(AveragedBalance):
    """The balance of the forces, and of the torque by which s3 is found, an unknown as well.

    Places are those of the beads with the axis along z, (n, 3) [m], and a row with s3 times the
    radius; forces likewise.
    """

    def __init__(self, system, layout_m, spin, family, s3):
        super().__init__(system, layout_m, abs(spin))
        # In the orbit frame and without bead laws, tethers alone accelerate beads at rest.
        self.arrays = self.arrays._replace(spin=0.0)
        self.rate, self.ratio = system.orbit_rate_rad_s, spin / system.orbit_rate_rad_s
        self.conical, self.factor_s3, self.s3 = family == CONICAL, _FACTOR[family], s3
        self.beads, self.mass = self.mass, np.append(self.mass, np.mean(self.mass))

    def start(self, place):
        self.mass, mass = self.beads, self.mass
        place = super().start(place)
        self.mass = mass
        return np.vstack([place, [self.s3 * self.radius, 0.0, 0.0]])

    def stretched(self, place):
        return super().stretched(place[:-1])

    def field(self, s3):
        """Averaged acceleration over place [1/s^2] across the axis and along it; slopes by s3."""
        square = self.rate**2
        vertical, slope = (1.0 - s3**2, -2.0 * s3) if self.conical else (0.0, 0.0)
        across = self.ratio**2 + 2.0 * self.ratio * s3 + 1.0 - 1.5 * vertical + 0.5 * s3**2
        along = 3.0 * vertical - s3**2
        slopes = 2.0 * self.ratio - 1.5 * slope + s3, 3.0 * slope - 2.0 * s3
        return [square * x for x in (across, along, *slopes)]

    def torque(self, place, s3):
        """What is left of C w - f (A - C) s3, over A + C, falling with s3; slopes by place, s3."""
        weight = self.beads[:, None] * place
        about = np.sum(weight[:, :2] * place[:, :2])
        across = 0.5 * about + np.sum(weight[:, 2] * place[:, 2])
        both, more = about + across, math.copysign(1.0, across - about)
        left = about * self.ratio + self.factor_s3 * (about - across) * s3
        by_place = 2.0 * weight * (self.ratio + self.factor_s3 * s3)
        by_place -= weight * self.factor_s3 * s3
        by_place[:, 2] = -2.0 * weight[:, 2] * self.factor_s3 * s3
        return [more * x / both for x in (left, by_place, self.factor_s3 * (about - across))]

    def force(self, place):
        beads, s3 = place[:-1], place[-1, 0] / self.radius
        across, along, *_ = self.field(s3)
        acceleration = np.empty_like(beads)
        forces.acceleration(self.arrays, self.taut, 0.0, self.still, beads, acceleration)
        # The centre of mass is held where it is, whatever the mean gravity does with it.
        centre = np.average(beads, axis=0, weights=self.beads)
        acceleration += (beads - centre) * [across, across, along] - self.outward * centre
        left = [[self.torque(beads, s3)[0] * self.scale / self.mass[-1], 0.0, 0.0]]
        return self.mass[:, None] * np.vstack([acceleration, left])

    def factor(self, place, slow=0.0):
        beads, s3, n = place[:-1], place[-1, 0] / self.radius, self.system.n
        symbolic, known = self.symbolic, self.symbolic.row.size
        forces.jacobian(
            self.arrays, symbolic.pair, self.taut, 0.0, self.still, beads, self.by_r, self.by_v
        )
        matrix = np.zeros((n + 1, 3, n + 1, 3))
        matrix[symbolic.row, :, symbolic.column, :] = self.by_r[:known]
        across, along, across_by, along_by = self.field(s3)
        share = np.tile(self.beads / np.sum(self.beads), (n, 1))
        for axis, rate in enumerate((across, across, along)):
            matrix[:n, axis, :n, axis] += rate * (np.eye(n) - share) - self.outward * share
        matrix[:n, :, n, 0] = beads * [across_by, across_by, along_by] / self.radius
        _, by_place, by_s3 = self.torque(beads, s3)
        size = self.scale / self.mass[-1]
        matrix[n, 0, :n], matrix[n, 0, n, 0] = size * by_place, size * by_s3 / self.radius
        matrix[n, [1, 2], n, [1, 2]] = -self.outward
        pinned = rigid_velocity(beads[self.pinned], 1.0)
        pinned /= max(np.linalg.norm(pinned), 1e-300)
        most = np.max(np.abs(matrix[self.pinned, :, self.pinned]))
        matrix[self.pinned, :, self.pinned] -= most * np.outer(pinned, pinned)
        self.matrix = matrix.reshape(3 * n + 3, -1) - slow * np.eye(3 * n + 3)

    def correction(self, force):
        right = (force / self.mass[:, None]).ravel()
        if not (np.isfinite(right).all() and np.isfinite(self.matrix).all()):
            return np.full_like(force, np.nan)
        return -np.linalg.lstsq(self.matrix, right, rcond=1e-15)[0].reshape(-1, 3)
