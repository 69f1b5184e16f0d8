"""What a law states, and from which everything else follows.

A tether law states the tension of a taut tether, a bead law the acceleration of a bead, a thrust
law the thrust of a satellite, a reel law the force that holds a tether, each as an expression of
`numerics.expressions`. Values, Jacobians, Taylor series and variations are made of it
(`model.made`, `model.feedback_thrust`, `model.reel_yield`). Registered laws are held to what they
declare: those of the package by tests, others when they are loaded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tss_ros.core.numerics.expressions import Expression

Vector = tuple[Expression, Expression, Expression]


@dataclass(frozen=True)
class LawParameter:
    """A number that a law needs, the same for all beads and tethers.

    Attributes
    ----------
    name, meaning, unit : str
        Its name everywhere: scenario key, node parameter, column of a sweep.
    minimum, maximum, default : float
    note : str
        More about it, as a clause; "" for nothing.
    """

    name: str
    meaning: str
    unit: str
    minimum: float
    maximum: float
    default: float
    note: str = ""


@dataclass(frozen=True)
class Stretched:
    """A taut tether, as its law sees it.

    Attributes
    ----------
    length, rate : Expression
        l [m] > L and l' [m/s], Eq. (6).
    rest, stiffness, damping : Expression
        L [m], EA/L [N/m] and C [N s/m], Eqs. (3) and (6).
    """

    length: Expression
    rate: Expression
    rest: Expression
    stiffness: Expression
    damping: Expression


@dataclass(frozen=True)
class TetherLaw:
    """How a tether pulls while it is longer than its rest length.

    Attributes
    ----------
    name : str
        Value of the parameter `tether_law`.
    meaning : str
        In a few words.
    tension : callable
        Of a `Stretched` and the law's parameters by name: tension [N]. Its part with the rate must
        be damping * rate, and without it must be 0 at the rest length and grow with the length.
    energy : callable
        Likewise: elastic energy [J].
    pushes : bool
        Whether the tension may be negative. Where not, a tether is let go where its tension
        reaches zero, and takes hold again where it would be positive.
    parameters : tuple of LawParameter
    """

    name: str
    meaning: str
    tension: Callable[..., Expression]
    energy: Callable[..., Expression]
    pushes: bool
    parameters: tuple[LawParameter, ...] = ()


@dataclass(frozen=True)
class Moving:
    """A bead, as a law sees it, in a frame with the formation's nominal centre as its origin.

    Attributes
    ----------
    position, velocity : tuple of Expression
        [m] and [m/s] in that frame.
    up : tuple of Expression
        Unit vector away from the Earth at the centre.
    radius : Expression
        R [m], the centre's distance from the Earth's now.
    mean_motion : Expression
        n = sqrt(mu / R^3) [rad/s], the rate of a circular orbit of this radius round a round Earth.
    turning : Expression
        [rad/s] how fast the frame turns about z, against the stars.
    climb : Expression
        [m] height of the centre above `System.orbit_altitude_m`; 0 on a circle.
    centre_velocity : tuple of Expression
        [m/s] of the centre against the stars, along the axes of the frame.
    pole : tuple of Expression
        Unit vector along the axis of the Earth, to the north.
    sun : tuple of Expression
        Unit vector to the Sun.

    On a circle z is the orbit normal and, for the laws that ask for the pole, the Earth's axis;
    laws that ask for the Sun act where the orbit is carried as a table only (`model.orbits`).
    """

    position: Vector
    velocity: Vector
    up: Vector
    radius: Expression
    mean_motion: Expression
    turning: Expression
    climb: Expression
    centre_velocity: Vector
    pole: Vector
    sun: Vector


@dataclass(frozen=True)
class BeadLaw:
    """What accelerates every bead.

    Attributes
    ----------
    name, meaning : str
    acceleration : callable
        Of a `Moving` and the law's parameters by name: three components [m/s^2]. A law that bends
        the centre's own orbit states what the bead feels more than the centre, with the centrifugal
        force n^2 (x, y, 0), or the share of it that `orbit` says.
    parameters : tuple of LawParameter
        The law acts where the first of them is not zero; one without parameters is chosen by the
        system.
    orbit : callable, optional
        Of R and the law's parameters: (Omega / n)^2 - 1 of the circular orbit that feels the law.
    by_velocity : bool
        Whether the acceleration depends on the velocity.
    from_potential : bool
        Whether it is the gradient of a potential, so that its Jacobian is symmetric.
    keeps_plane : bool
        Whether it leaves beads in the orbit plane that are there.
    feels_pole : str
        Whether it knows where the axis of the Earth points, "axis", and in which sense the Earth
        turns about it, "sense"; "" for neither.
    feels_stars : bool
        Whether it knows a direction fixed among the stars, so that it turns in the orbit frame.
    typical : float
        Value of the first parameter where the law is chosen by its name alone, as one of
        `laws.PERTURBATIONS`; 0 if it cannot be.
    """

    name: str
    meaning: str
    acceleration: Callable[..., Vector]
    parameters: tuple[LawParameter, ...] = ()
    orbit: Callable[..., float] | None = None
    by_velocity: bool = False
    from_potential: bool = True
    keeps_plane: bool = True
    feels_pole: str = ""
    feels_stars: bool = False
    typical: float = 0.0

    def __post_init__(self):
        if self.by_velocity and self.from_potential:
            raise ValueError(
                f"bead law {self.name!r} depends on the velocity, so it has no potential:"
                " say from_potential=False"
            )


@dataclass(frozen=True)
class Guided:
    """A satellite with thrusters, as a law sees it, in axes of which z is the orbit normal.

    Attributes
    ----------
    place, velocity : tuple of Expression
        [m] and [m/s] from the mean of all satellites; the velocity is that in the orbit frame.
    rigid_velocity : tuple of Expression
        [m/s] omega z x place, the velocity in a rigid turn at the rate that is aimed at.
    shape : tuple of Expression
        [m] its place in the steady shape, turned about z by the angle that fits the satellites
        best.
    mass : Expression
        [kg]
    """

    place: Vector
    velocity: Vector
    rigid_velocity: Vector
    shape: Vector
    mass: Expression


@dataclass(frozen=True)
class ThrustLaw:
    """What the thruster of every satellite does.

    Thrusts of several laws are added; `thrust_limit_n` limits the sum.

    Attributes
    ----------
    name, meaning : str
    thrust : callable
        Of a `Guided` and the law's parameters by name: three components [N]. It has to turn with
        the satellites: the axes may be any with this z.
    parameters : tuple of LawParameter
        The law acts where the first of them is not zero.
    """

    name: str
    meaning: str
    thrust: Callable[..., Vector]
    parameters: tuple[LawParameter, ...]


@dataclass(frozen=True)
class Reeled:
    """A reel that follows the tension of its tether, as a law sees it.

    Attributes
    ----------
    paid_out : Expression
        L - L_0 [m]: rest length of the segment next to it, less that as built.
    rate : Expression
        L' [m/s]
    """

    paid_out: Expression
    rate: Expression


@dataclass(frozen=True)
class ReelLaw:
    """What every reel holds its tether with.

    The drum obeys m L'' = T - T_0 - F, T being the tension next to it: it pays out faster where the
    tether pulls harder. The forces F of several laws are added.

    Attributes
    ----------
    name, meaning : str
    force : callable
        Of a `Reeled` and the law's parameters by name: F [N], 0 where nothing is paid out and the
        reel stands.
    parameters : tuple of LawParameter
        The law acts where the first of them is not zero.
    """

    name: str
    meaning: str
    force: Callable[..., Expression]
    parameters: tuple[LawParameter, ...]


Law = BeadLaw | TetherLaw | ThrustLaw | ReelLaw
