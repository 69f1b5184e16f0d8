"""The tethered satellite system: beads, tether segments and the orbit they move in (section 2.1).

SI units throughout. The orbit frame o-xyz sits at the formation's nominal centre: y points radially
up, z along the orbit normal, x = y cross z.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tss_ros.core.arguments import finite, numbers, unit_vector
from tss_ros.core.errors import TssError, allowed_words, near_match
from tss_ros.core.model.contract import BeadLaw, TetherLaw
from tss_ros.core.model.laws import ACT_WITH, BEAD_LAWS, LAW_PARAMETERS, TETHER_LAWS
from tss_ros.core.presentation import Presented

#: Gravitational parameter of the Earth [m^3/s^2], as in the paper.
MU_EARTH = 3.986e14
#: Mean radius of the Earth [m], as in Table 1.
RADIUS_EARTH_M = 6378e3
#: Most beads that a table of a state shows.
MOST_SHOWN = 12
#: The z axis.
ORBIT_NORMAL = (0.0, 0.0, 1.0)


@dataclass(frozen=True, repr=False)
class State(Presented):
    """Positions and velocities of all beads in the orbit frame.

    Attributes
    ----------
    position_m : ndarray, shape (n, 3)
        [m] from the formation's nominal centre.
    velocity_m_s : ndarray, shape (n, 3)
        [m/s] measured in the rotating orbit frame.
    reel_length_m, reel_rate_m_s : ndarray, shape (p,)
        Rest lengths [m] that are states of the system, those next to reels that follow tension, and
        their rates [m/s]. Empty for a system without, and for rest lengths as built.
    """

    position_m: np.ndarray
    velocity_m_s: np.ndarray
    reel_length_m: np.ndarray = field(kw_only=True, default_factory=lambda: np.empty(0))
    reel_rate_m_s: np.ndarray = field(kw_only=True, default_factory=lambda: np.empty(0))

    def __post_init__(self):
        for name in ("reel_length_m", "reel_rate_m_s"):
            object.__setattr__(self, name, np.array(numbers(name, getattr(self, name))))
        if self.reel_length_m.ndim != 1 or self.reel_rate_m_s.shape != self.reel_length_m.shape:
            raise TssError(
                "reel_length_m and reel_rate_m_s must be a number each for every reel, got shapes"
                f" {self.reel_length_m.shape} and {self.reel_rate_m_s.shape}"
            )
        for name in ("position_m", "velocity_m_s"):
            array = numbers(name, getattr(self, name))
            if array.ndim != 2 or array.shape[1] != 3:
                raise TssError(f"{name} must be x, y, z of each bead, got shape {array.shape}")
            object.__setattr__(self, name, array)

    def _headline(self):
        size = np.max(np.linalg.norm(self.position_m, axis=1), initial=0.0)
        return f"of {len(self.position_m)} beads, up to {size:.6g} m from the centre"

    def _facts(self):
        return {
            f"bead {i + 1}": f"{np.array2string(r, precision=3, suppress_small=True)} m, "
            f"{np.array2string(v, precision=6, suppress_small=True)} m/s"
            for i, (r, v) in enumerate(zip(self.position_m[:MOST_SHOWN], self.velocity_m_s))
        }


@dataclass(frozen=True, repr=False)
class System(Presented):
    """Beads joined by tether segments on an orbit; arrays are validated and read-only.

    Attributes
    ----------
    bead_name : tuple of str, length n
    is_satellite : ndarray, shape (n,), bool
        False for beads that stand for tether mass.
    mass_kg : ndarray, shape (n,)
    tether_name : tuple of str, length m
    tether_ends : ndarray, shape (m, 2), int
        Indices of the two beads that each segment joins, Eq. (4).
    rest_length_m, axial_stiffness_n, damping_n_s_per_m : ndarray, shape (m,)
        Equilibrium length L [m], EA [N] and C [N s/m] of each segment, Eqs. (3) and (6).
    layout_m : ndarray, shape (n, 3)
        [m] nominal shape in the orbit frame at time 0. A first guess of the steady state, not the
        steady state itself.
    orbit_altitude_m : float
        H [m] above `RADIUS_EARTH_M`; that of the perigee if the orbit is no circle.
    linear_gravity : bool
        Use the gravity gradient linearised at the centre instead of Eq. (2).
    bilateral : bool
        Let segments push as well as pull: s = 1 always in Eq. (5). For closed-form checks.
    tether_law : str
        Name of one of `laws.TETHER_LAWS`: how taut segments pull.
    law_parameters : dict of str to float
        Values of `laws.LAW_PARAMETERS` by name, the elements of the orbit among them; those left
        out have their defaults.
    spin_axis : ndarray, shape (3,)
        Unit vector in the orbit frame about which the formation spins at time 0, as far as that
        is known: where the axis rests follows from the masses and the rate. Any length but zero
        may be given.

    Raises
    ------
    TssError
        If a value, a shape or the graph is not physical; the text names it.
    """

    bead_name: tuple[str, ...]
    is_satellite: np.ndarray
    mass_kg: np.ndarray
    tether_name: tuple[str, ...]
    tether_ends: np.ndarray
    rest_length_m: np.ndarray
    axial_stiffness_n: np.ndarray
    damping_n_s_per_m: np.ndarray
    layout_m: np.ndarray
    orbit_altitude_m: float = 1.0e6
    linear_gravity: bool = False
    bilateral: bool = False
    tether_law: str = TETHER_LAWS[0].name
    law_parameters: Mapping[str, float] = field(default_factory=dict)
    spin_axis: np.ndarray = field(default_factory=lambda: np.array(ORBIT_NORMAL))

    def __post_init__(self):
        n, m = len(self.bead_name), len(self.tether_name)
        if n < 2:
            raise TssError(f"a system needs at least 2 beads, got {n}")
        if m < 1:
            raise TssError("a system needs at least 1 tether, got 0")
        for names, what in ((self.bead_name, "bead"), (self.tether_name, "tether")):
            name, count = Counter(names).most_common(1)[0]
            if count > 1:
                raise TssError(f"duplicate {what} name {name!r}: {count} of them")
        for name in ("linear_gravity", "bilateral"):
            if not isinstance(value := getattr(self, name), bool | np.bool_):
                raise TssError(f"{name} must be True or False, got {value!r:.80}")
        self._store("is_satellite", self.is_satellite, n, bool)
        self._store("mass_kg", self.mass_kg, n, above=0.0)
        ends = np.array(numbers("tether_ends", self.tether_ends, None))
        if ends.shape != (m, 2) or not np.issubdtype(ends.dtype, np.integer):
            raise TssError(f"tether_ends must be {m} pairs of bead indices, got shape {ends.shape}")
        if ends.min() < 0 or ends.max() >= n:
            raise TssError(f"tether_ends must lie in 0..{n - 1}, got {ends.min()}..{ends.max()}")
        for name, (i, j) in zip(self.tether_name, ends):
            if i == j:
                raise TssError(f"tether {name!r} joins bead {self.bead_name[i]!r} to itself")
        ends = ends.astype(np.int64)
        ends.flags.writeable = False
        object.__setattr__(self, "tether_ends", ends)
        self._store("rest_length_m", self.rest_length_m, m, above=0.0)
        self._store("axial_stiffness_n", self.axial_stiffness_n, m, above=0.0)
        self._store("damping_n_s_per_m", self.damping_n_s_per_m, m, at_least=0.0)
        self._require_connected()
        layout = np.array(numbers("layout_m", self.layout_m))
        if layout.shape != (n, 3) or not np.isfinite(layout).all():
            raise TssError(f"layout_m must be {n} finite positions x y z, got shape {layout.shape}")
        layout.flags.writeable = False
        object.__setattr__(self, "layout_m", layout)
        altitude = finite("orbit_altitude_m", self.orbit_altitude_m, at_least=0.0)
        object.__setattr__(self, "orbit_altitude_m", altitude)
        object.__setattr__(self, "spin_axis", unit_vector("spin_axis", self.spin_axis))
        self._check_laws()

    def _check_laws(self):
        names = [law.name for law in TETHER_LAWS]
        if self.tether_law not in names:
            raise TssError(
                f"tether_law must be one of {', '.join(names)}, got {self.tether_law!r}"
                f"{near_match(self.tether_law, names)}"
            )
        if self.bilateral and not self.law.pushes:
            raise TssError(f"bilateral tethers push, but tether_law {self.tether_law} does not")
        values = {parameter.name: parameter.default for parameter in LAW_PARAMETERS}
        for name, value in self.law_parameters.items():
            if name not in values:
                raise TssError(
                    f"{name!r} is no parameter of a law that is loaded; laws of one's own are named"
                    f" by TSS_ROS_LAWS{allowed_words(name, values)}"
                )
            values[name] = value
        foreign = {p: law for law in TETHER_LAWS for p in law.parameters if law is not self.law}
        for parameter in LAW_PARAMETERS:
            number = finite(parameter.name, values[parameter.name], at_least=parameter.minimum)
            if number > parameter.maximum:
                raise TssError(
                    f"{parameter.name} must be at most {parameter.maximum:g}, got {number:g}"
                )
            if parameter in foreign and number != parameter.default:
                raise TssError(
                    f"{parameter.name} is {number:g}, which only tether_law"
                    f" {foreign[parameter].name} uses; it is {self.tether_law}"
                )
            values[parameter.name] = number
        object.__setattr__(self, "law_parameters", values)

    @cached_property
    def law(self) -> TetherLaw:
        """How taut segments pull."""
        return next(law for law in TETHER_LAWS if law.name == self.tether_law)

    @cached_property
    def acting(self) -> tuple[bool, ...]:
        """Which of `laws.BEAD_LAWS` act on the beads."""
        chosen = {"gravity": not self.linear_gravity, "linear_gravity": self.linear_gravity}
        return tuple(
            chosen[law.name] if law.name in chosen
            else self.law_parameters[law.parameters[0].name] != 0.0
            for law in BEAD_LAWS
        )  # fmt: skip

    @cached_property
    def idle_parameters(self) -> dict[str, tuple[str, ...]]:
        """Parameters of laws without effect, and others of which one would have to be not 0."""
        values = self.law_parameters
        return {name: of for name, of in ACT_WITH.items() if not any(values[one] for one in of)}

    @property
    def acting_laws(self) -> tuple[BeadLaw, ...]:
        """The laws that act on the beads."""
        return tuple(law for law, acts in zip(BEAD_LAWS, self.acting) if acts)

    @property
    def keeps_plane(self) -> bool:
        """Whether motions in the orbit plane stay there."""
        return all(law.keeps_plane for law in self.acting_laws)

    def _store(self, name, values, size, dtype=float, **bounds):
        array = np.array(numbers(name, values) if dtype is float else values, dtype=dtype)
        if array.shape != (size,):
            raise TssError(f"{name} must have {size} values, got shape {array.shape}")
        if dtype is float:
            for value in array:
                finite(name, value, **bounds)
        array.flags.writeable = False
        object.__setattr__(self, name, array)

    def _require_connected(self):
        reached, frontier = {0}, [0]
        neighbours = [[] for _ in self.bead_name]
        for i, j in self.tether_ends:
            neighbours[i].append(j)
            neighbours[j].append(i)
        while frontier:
            for j in neighbours[frontier.pop()]:
                if j not in reached:
                    reached.add(j)
                    frontier.append(j)
        for i, name in enumerate(self.bead_name):
            if i not in reached:
                raise TssError(f"bead {name!r} is not tethered to bead {self.bead_name[0]!r}")

    def _headline(self):
        count = int(np.count_nonzero(self.is_satellite))
        beads = f", {self.n - count} beads" if count < self.n else ""
        return (
            f"of {count} satellites{beads}, {self.m} tether segments;"
            f" {self.orbit_altitude_m / 1e3:g} km up, {self.tether_law}"
        )

    def _facts(self):
        per_part = {
            "satellite mass": (self.mass_kg[self.is_satellite], "kg"),
            "bead mass": (self.mass_kg[~self.is_satellite], "kg"),
            "rest length": (self.rest_length_m, "m"),
            "axial stiffness EA": (self.axial_stiffness_n, "N"),
            "damping C": (self.damping_n_s_per_m, "N s/m"),
        }
        facts = {
            name: f"{' to '.join(dict.fromkeys(f'{x:g}' for x in (min(v), max(v))))} {unit}"
            for name, (v, unit) in per_part.items()
            if v.size
        }
        return facts | {
            "orbit rate Omega": f"{self.orbit_rate_rad_s:.6e} rad/s",
            "laws": ", ".join((self.tether_law, *(law.name for law in self.acting_laws))),
            **{
                name: f"{value:g}"
                for name, value in self.law_parameters.items()
                if value and name not in self.idle_parameters
            },
        }

    @property
    def n(self) -> int:
        """Number of beads, satellites included."""
        return len(self.bead_name)

    @property
    def m(self) -> int:
        """Number of tether segments."""
        return len(self.tether_name)

    @property
    def orbit_radius_m(self) -> float:
        """R = R_E + H [m], that of the perigee if the orbit is no circle."""
        return RADIUS_EARTH_M + self.orbit_altitude_m

    @cached_property
    def mean_motion_rad_s(self) -> float:
        """n = sqrt(mu / a^3) [rad/s] with the semi-major axis a = R / (1 - e)."""
        axis = self.orbit_radius_m / (1.0 - self.law_parameters["eccentricity"])
        return math.sqrt(MU_EARTH / axis**3)

    @cached_property
    def on_circle(self) -> bool:
        """Whether the centre's orbit stays a circle: no ellipse, nor inclined with J2."""
        inclined = self.law_parameters["inclination_deg"] not in (0.0, 180.0)
        return self.law_parameters["eccentricity"] == 0.0 and not (
            inclined and self.law_parameters["j2"]
        )

    @cached_property
    def autonomous(self) -> bool:
        """Whether forces in the orbit frame do not depend on time."""
        inclination = self.law_parameters["inclination_deg"]
        felt = {"axis": inclination not in (0.0, 180.0), "sense": inclination != 0.0}
        return self.on_circle and not any(
            law.feels_stars or felt.get(law.feels_pole) for law in self.acting_laws
        )

    @cached_property
    def orbit_rate_rad_s(self) -> float:
        """Omega [rad/s]: n, or what the laws that act make of a circle's (`BeadLaw.orbit`)."""
        if not self.on_circle:
            return self.mean_motion_rad_s
        more = 0.0
        for law in self.acting_laws:
            if law.orbit is not None:
                values = {p.name: self.law_parameters[p.name] for p in law.parameters}
                more += law.orbit(self.orbit_radius_m, **values)
        return self.mean_motion_rad_s * math.sqrt(1.0 + more)

    def spin_rate_rad_s(self, spin_rate_ratio: float) -> float:
        """Spin rate omega [rad/s] in the orbit frame for w = omega / Omega; 0 if it hangs."""
        ratio = finite("spin_rate_ratio", spin_rate_ratio)
        if ratio and not 1e-3 <= abs(ratio) <= 1e4:
            raise TssError(
                f"spin_rate_ratio must be 0 or have a size from 0.001 to 10000, got {ratio:g}"
            )
        return ratio * self.orbit_rate_rad_s

    def period_s(self, spin_rate_ratio: float) -> float:
        """T = 2 pi / |omega| [s], one turn of the formation; of the orbit if it hangs, w = 0."""
        spin = self.spin_rate_rad_s(spin_rate_ratio)
        return 2.0 * math.pi / abs(spin or self.orbit_rate_rad_s)

    def turning_rad_s(self, spin_rate_rad_s: float) -> float:
        """Rate [rad/s] of the frame in which the formation hardly moves, about z.

        That of the spin where its axis is the orbit normal; elsewhere 0, the orbit frame itself.
        """
        x, y, z = self.spin_axis
        return math.copysign(spin_rate_rad_s, spin_rate_rad_s * z) if x == y == 0.0 else 0.0
