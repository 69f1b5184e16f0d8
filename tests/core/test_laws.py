"""Every registered law is held to what it declares; laws added later are tested without edits."""

import math
import re
import runpy
from dataclasses import replace
from decimal import Decimal

import numpy as np
import pytest
from differences import assert_variations_are_differences, differences
from formulas import Series, interpreted
from scipy.integrate import solve_ivp

from tss_ros.core import Propagator, State, TssError, disturbed, initial_state, ring
from tss_ros.core.model import forces, laws, made
from tss_ros.core.model.contract import Stretched, TetherLaw
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.model.laws import BEAD_LAWS, LAW_PARAMETERS, TETHER_LAWS
from tss_ros.core.model.laws.drag import EARTH_RATE_RAD_S
from tss_ros.core.model.laws.oblateness import EQUATORIAL_RADIUS_M
from tss_ros.core.model.stated import acceleration_of, tension_of
from tss_ros.core.model.system import MU_EARTH
from tss_ros.core.motion import taylor_motion
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.numerics import block_lu
from tss_ros.core.numerics.expressions import add, symbol, symbols

SPIN = -2.5
by_tether_law = pytest.mark.parametrize("law", TETHER_LAWS, ids=[law.name for law in TETHER_LAWS])
#: Those that turn in the orbit frame are in test_orbits.
CIRCLE_LAWS = [law for law in BEAD_LAWS if not law.feels_stars]
by_bead_law = pytest.mark.parametrize("law", CIRCLE_LAWS, ids=[law.name for law in CIRCLE_LAWS])


def values(law):
    """Values of parameters with which a law acts: the defaults, or a hundredth of the range."""
    return {
        p.name: p.default or p.minimum + 0.01 * (p.maximum - p.minimum) for p in law.parameters
    }


def a_ring(law, **options):
    """Six beads and segments, two blocks of lanes of which two are idle, under a law."""
    options = values(law) | options
    if isinstance(law, TetherLaw):
        options |= {"tether_law": law.name}
    elif not law.parameters:
        options |= {"linear_gravity": law.name == "linear_gravity"}
    return ring(
        satellites=5, satellite_mass_kg=[100.0, 150.0, 80.0, 200.0, 120.0],
        beads_per_tether=[1, 0, 0, 0, 0], bead_mass_kg=15.0, damping_n_s_per_m=40.0, **options,
    )  # fmt: skip


def a_state(system, stretch, seed=1):
    """The layout scaled by so much, turning, a little disturbed."""
    rng = np.random.default_rng(seed)
    position = np.array(system.layout_m)
    spin = system.spin_rate_rad_s(SPIN)
    ends = system.tether_ends
    length = np.linalg.norm(position[ends[:, 0]] - position[ends[:, 1]], axis=1)
    position *= stretch / np.min(length / system.rest_length_m)
    position += rng.normal(0.0, 0.3, position.shape)
    velocity = spin * np.stack([-position[:, 1], position[:, 0], 0 * position[:, 0]], 1)
    return State(position, velocity + rng.normal(0.0, 0.02, position.shape))


def acceleration(arrays, taut, velocity, position, time=0.0):
    a = np.empty_like(position)
    forces.acceleration(arrays, taut, time, velocity, position, a)
    return a


def jacobian(system, arrays, taut, velocity, position, time=0.0):
    """Both blocks of Eq. (52) as matrices (3n, 3n)."""
    symbolic = block_lu.analyse(system.n, system.tether_ends)
    by_r, by_v = np.empty((2, symbolic.row.size, 3, 3))
    forces.jacobian(arrays, symbolic.pair, taut, time, velocity, position, by_r, by_v)
    result = np.zeros((2, system.n, 3, system.n, 3))
    for k, (i, j) in enumerate(zip(symbolic.row, symbolic.column)):
        result[0, i, :, j] += by_r[k]
        result[1, i, :, j] += by_v[k]
    return result.reshape(2, 3 * system.n, 3 * system.n)


class Alone:
    """One law's acceleration of the beads of a system, without tethers and the others.

    In the frame that turns at so many times the orbit's rate, some time after it coincided with the
    orbit frame; in the orbit frame for 0.
    """

    time = 1234.5

    def __init__(self, law, ratio=0.0):
        self.system = system = a_ring(law)
        self.spin = ratio * system.orbit_rate_rad_s
        arrays, self.none = kernel_arrays(system, self.spin), np.zeros(system.m, dtype=bool)
        self.law = arrays._replace(acting=1 << BEAD_LAWS.index(law))
        # What the turning of the frame adds is taken off.
        self.without = arrays._replace(acting=0)
        rng = np.random.default_rng(7)
        self.position = rng.normal(0.0, 5e4, (system.n, 3))
        self.velocity = rng.normal(0.0, 100.0, (system.n, 3))

    def __call__(self, velocity, position):
        return acceleration(self.law, self.none, velocity, position, self.time) - acceleration(
            self.without, self.none, velocity, position, self.time
        )

    def by_position(self):
        return differences(lambda r: self(self.velocity, r), self.position, 3e3)

    def by_velocity(self):
        return differences(lambda v: self(v, self.position), self.velocity, 100.0)

    def jacobian(self):
        state = self.none, self.velocity, self.position, self.time
        return jacobian(self.system, self.law, *state) - jacobian(
            self.system, self.without, *state
        )


# -- derivatives -----------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.0, SPIN])
@by_bead_law
def test_the_jacobian_of_a_bead_law_is_the_limit_of_differences(law, ratio):
    alone = Alone(law, ratio)
    by_r, by_v = alone.jacobian()
    assert np.abs(by_r).max() > 0.0
    np.testing.assert_allclose(alone.by_position(), by_r, atol=1e-8 * np.abs(by_r).max())
    scale = np.abs(alone(alone.velocity, alone.position)).max() / 100.0
    atol = 1e-7 * max(np.abs(by_v).max(), 1e-3 * scale)
    np.testing.assert_allclose(alone.by_velocity(), by_v, atol=atol)


@by_tether_law
def test_the_jacobian_of_a_tether_law_is_the_limit_of_differences(law):
    system = a_ring(law)
    state = a_state(system, 1.001)
    spin, time = system.spin_rate_rad_s(SPIN), 321.0
    arrays, taut = kernel_arrays(system, spin), np.ones(system.m, dtype=bool)
    taut[2] = False
    rng = np.random.default_rng(2)
    v = rng.normal(0.0, 3.0, (system.n, 3))
    by_r, by_v = jacobian(system, arrays, taut, v, state.position_m, time)

    def of_position(r):
        return acceleration(arrays, taut, v, r, time)

    def of_velocity(v):
        return acceleration(arrays, taut, v, state.position_m, time)

    a, b = differences(of_position, state.position_m, 2.0), differences(of_velocity, v, 1.0)
    np.testing.assert_allclose(a, by_r, atol=1e-9 * np.abs(by_r).max())
    np.testing.assert_allclose(b, by_v, atol=1e-9 * np.abs(by_v).max())


# -- series and variations -------------------------------------------------------------------------


def moved(system, taut, state, times):
    """Where the motion from a state is at some times, by scipy, with its tethers held so."""
    arrays, shape = kernel_arrays(system, 0.0), state.position_m.shape

    def derivative(_, x):
        r, v = x.reshape(2, *shape)
        return np.concatenate([v.ravel(), acceleration(arrays, taut, v, r).ravel()])

    x = np.concatenate([state.position_m.ravel(), state.velocity_m_s.ravel()])
    solution = solve_ivp(
        derivative, (0.0, times[-1]), x, "DOP853", t_eval=times, rtol=1e-13, atol=1e-11
    )
    assert solution.success, solution.message
    return [x.reshape(2, *shape) for x in np.transpose(solution.y)]


def assert_series_are_the_motion(system, state, without):
    """At some points of an explicit step; and the law is to be seen in it."""
    integrator = Integrator(system, 0.0, 1e-12, 1e4, integrator="taylor")
    motion = integrator.begin(state)
    taut = motion.taut.copy()
    integrator.advance(motion, 1e9, steps=1)
    step = float(motion.progress["step_size"][0])
    times = step * np.array([0.1, 0.37, 0.7, 1.0])
    (bare,), found = moved(without, taut, state, times[-1:]), moved(system, taut, state, times)
    effect = np.abs(found[-1][0] - bare[0]).max()
    assert effect > 1e-3
    for time, (r, v) in zip(times, found):
        ours = State(np.empty_like(r), np.empty_like(v))
        taylor_motion.evaluate(motion.series, time, ours.velocity_m_s, ours.position_m)
        atol = min(3e-9, 1e-7 * effect)
        np.testing.assert_allclose(ours.position_m, r, rtol=0.0, atol=atol)
        np.testing.assert_allclose(ours.velocity_m_s, v, rtol=0.0, atol=atol)
    return taut, step


@by_tether_law
@pytest.mark.parametrize("slack", [0, 2])
def test_series_of_a_tether_law_are_the_motion(law, slack):
    system = a_ring(law)
    state = a_state(system, 1.0005)
    if slack:
        state.position_m[3] *= 0.99
    without = replace(system, axial_stiffness_n=system.axial_stiffness_n * 1e-9,
                      damping_n_s_per_m=system.damping_n_s_per_m * 0.0)
    taut, _ = assert_series_are_the_motion(system, state, without)
    assert np.count_nonzero(~taut) == slack


@by_bead_law
def test_series_of_a_bead_law_are_the_motion(law):
    """Of slack tethers, whose steps are long: there all that a law does is seen."""
    system = a_ring(law)
    state = a_state(system, 0.3)
    state = replace(state, velocity_m_s=state.velocity_m_s * 3.0)
    without = replace(system, law_parameters={}, linear_gravity=law.name == "gravity")
    taut, step = assert_series_are_the_motion(system, state, without)
    assert not taut.any()
    assert step > 10.0


@pytest.mark.parametrize("kind", ["taylor", "radau"])
@by_tether_law
def test_variations_under_a_tether_law_are_differences_of_motions(law, kind):
    system = a_ring(law)
    state = a_state(system, 1.001)
    integrator = Integrator(system, system.spin_rate_rad_s(SPIN), 1e-13, 1e4, integrator=kind)
    assert_variations_are_differences(integrator, state, 0.3, 3e-5, 1e-8)


@pytest.mark.parametrize("kind", ["taylor", "radau"])
@by_bead_law
def test_variations_under_a_bead_law_are_differences_of_motions(law, kind):
    system = a_ring(law)
    state = a_state(system, 0.3)
    end, spin = 400.0, system.spin_rate_rad_s(SPIN)
    found = []
    for one in (system, replace(system, law_parameters={}, linear_gravity=law.name == "gravity")):
        integrator = Integrator(one, spin, 1e-13, 1e4, integrator=kind)
        found.append(assert_variations_are_differences(integrator, state, end, 3e-3, 1e-11))
    assert np.abs(found[0] - found[1]).max() > 1e2 * 1e-11  # the law is to be seen


# -- what tether laws declare ----------------------------------------------------------------------

STRETCHED = Stretched(
    symbol("length"), symbol("rate"),
    *(symbol(name, varies=False) for name in ("rest", "stiffness", "damping")),
)  # fmt: skip


class OfStretch:
    """An expression of a tether law, in decimal numbers, of length and rate."""

    def __init__(self, law, what):
        own = {p.name: symbol(p.name, varies=False) for p in law.parameters}
        self.expression = add(getattr(law, what)(STRETCHED, **own))
        known = {own[name]: value for name, value in values(law).items()}
        known |= {STRETCHED.rest: 1e4, STRETCHED.stiffness: 5.0, STRETCHED.damping: 120.0}
        self.known = {s: Series([value]) for s, value in known.items()}

    def __call__(self, length, rate=0.0):
        series = {STRETCHED.length: Series([length]), STRETCHED.rate: Series([rate])}
        return float(interpreted(self.expression, self.known | series).c[0])

    def slope(self, length, rate=0.0, by=0):
        h = [Decimal(0), Decimal(0)]
        h[by] = Decimal(10) ** -15
        length, rate = Decimal(length), Decimal(rate)
        sides = []
        for sign in (1, -1):
            place = (length + sign * h[0], rate + sign * h[1])
            series = {STRETCHED.length: Series(place[:1]), STRETCHED.rate: Series(place[1:])}
            sides.append(interpreted(self.expression, self.known | series).c[0])
        return float((sides[0] - sides[1]) / (2 * h[by]))


@by_tether_law
def test_the_energy_of_a_tether_grows_by_its_tension(law):
    tension, energy = OfStretch(law, "tension"), OfStretch(law, "energy")
    assert energy(1e4) == pytest.approx(0.0, abs=1e-12)
    for length in (1e4 + 1e-3, 10_001.0, 10_100.0, 11_000.0):
        assert energy.slope(length) == pytest.approx(tension(length), rel=1e-12)


@by_tether_law
def test_the_tension_begins_at_the_rest_length_and_grows(law):
    tension = OfStretch(law, "tension")
    assert tension(1e4) == pytest.approx(0.0, abs=1e-12)
    for length in (1e4, 1e4 + 1e-3, 10_001.0, 10_100.0, 11_000.0):
        assert tension.slope(length) > 0.0


@by_tether_law
def test_the_tension_grows_with_the_rate_by_the_damping(law):
    tension = OfStretch(law, "tension")
    for length, rate in ((10_000.0, 0.3), (10_001.0, -2.0), (11_000.0, 5.0)):
        assert tension.slope(length, rate, by=1) == pytest.approx(120.0, rel=1e-12)


@by_tether_law
def test_forces_of_a_tether_law_are_the_gradient_of_its_energy(law):
    """At rest, of a whole system: energies and forces come from the same statement."""
    system = a_ring(law)
    r, rest = a_state(system, 1.002).position_m, np.zeros((system.n, 3))
    taut, arrays = np.ones(system.m, dtype=bool), kernel_arrays(system, 0.0)
    force = system.mass_kg[:, None] * (
        acceleration(arrays, taut, rest, r) - acceleration(arrays, ~taut, rest, r)
    )
    gradient = differences(lambda r: forces.elastic_energy(system, r, rest), r, 1.0)
    np.testing.assert_allclose(-gradient.reshape(force.shape), force,
                               atol=1e-8 * np.abs(force).max())  # fmt: skip
    assert np.array_equal(forces.tether_state(system, r, rest)[2], taut)


@by_tether_law
def test_the_tension_shown_is_the_one_that_acts(law):
    """In values one by one, for arrays, and as what the beads at both ends feel."""
    system = a_ring(law)
    state = a_state(system, 1.002)
    r, v = state.position_m, state.velocity_m_s
    arrays, pull = kernel_arrays(system, 0.0), np.empty(system.m)
    forces.tensions(arrays, 0.0, v, r, pull)
    length, shown, _ = forces.tether_state(system, r, v)
    np.testing.assert_allclose(shown, pull, rtol=1e-13)
    for k, (i, j) in enumerate(system.tether_ends):
        only = np.arange(system.m) == k
        felt = acceleration(arrays, only, v, r) - acceleration(arrays, ~only & only, v, r)
        along = (r[i] - r[j]) / length[k]
        assert felt[i] @ along * system.mass_kg[i] == pytest.approx(-pull[k], rel=1e-9)
        assert felt[j] @ along * system.mass_kg[j] == pytest.approx(pull[k], rel=1e-9)


@by_tether_law
def test_tether_forces_change_neither_momentum_nor_angular_momentum(law):
    system = a_ring(law)
    state = a_state(system, 1.002)
    r, v, arrays = state.position_m, state.velocity_m_s, kernel_arrays(system, 0.0)
    taut = np.ones(system.m, dtype=bool)
    force = system.mass_kg[:, None] * (
        acceleration(arrays, taut, v, r) - acceleration(arrays, ~taut, v, r)
    )
    scale = np.abs(force).sum()
    assert scale > 1.0
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * scale
    assert np.abs(np.cross(r, force).sum(axis=0)).max() < 1e-12 * scale * np.abs(r).max()


@by_tether_law
def test_a_tether_law_that_does_not_push_says_so(law):
    system = a_ring(law)
    state = a_state(system, 1.0003)
    closing = replace(state, velocity_m_s=-0.01 * state.position_m)
    _, pull, taut = forces.tether_state(system, closing.position_m, closing.velocity_m_s)
    assert taut.all()
    assert (pull.min() < 0.0) == law.pushes


def test_the_papers_tether_pushes_and_that_which_only_pulls_does_not():
    pushes = {law.name: law.pushes for law in TETHER_LAWS}
    assert pushes["kelvin_voigt"] and not pushes["tension_only"] and not pushes["stiffening"]


# -- what bead laws declare ------------------------------------------------------------------------


@by_bead_law
def test_a_bead_law_has_a_potential_if_it_says_so(law):
    """Then the derivative by position is symmetric: the force is free of curl."""
    by_r = Alone(law).by_position()
    asymmetry = np.abs(by_r - by_r.T).max() / np.abs(by_r).max()
    assert (asymmetry < 1e-8) == law.from_potential


@by_bead_law
def test_a_bead_law_with_a_potential_does_no_work_round_a_loop(law):
    alone = Alone(law)

    def power(angle):
        r = alone.position + 2e5 * np.array([math.cos(angle), 0.6 * math.sin(angle), 0.3])
        along = 2e5 * np.array([-math.sin(angle), 0.6 * math.cos(angle), 0.0])
        a = alone(alone.velocity, r) @ along
        return np.array([a, np.abs(a)])

    angles = 2.0 * math.pi * np.arange(64) / 64
    work, size = np.mean([power(angle) for angle in angles], axis=0)
    assert (np.abs(work).max() < 1e-10 * size.max()) == law.from_potential


@by_bead_law
def test_a_bead_law_depends_on_the_velocity_if_it_says_so(law):
    alone = Alone(law)
    a, b = (alone(v, alone.position) for v in (alone.velocity, 0.5 * alone.velocity))
    assert (np.abs(a - b).max() > 1e-12 * np.abs(a).max()) == law.by_velocity
    names = {s.name for a in acceleration_of(law, (0.0, 1.0, 0.0)) for s in symbols(add(a))}
    assert bool(names & {"vx", "vy", "vz"}) == law.by_velocity


@by_bead_law
def test_a_bead_law_keeps_the_plane_if_it_says_so(law):
    alone = Alone(law)
    level = np.array([1.0, 1.0, 0.0])
    a = alone(alone.velocity * level, alone.position * level)
    assert (np.abs(a[:, 2]).max() == 0.0) == law.keeps_plane


@by_bead_law
def test_a_bead_law_does_not_depend_on_the_frame_it_is_seen_from(law):
    """The frame that turns with a formation, and the orbit frame, give the same acceleration."""
    alone, turning = Alone(law), Alone(law, SPIN)
    angle = turning.spin * turning.time
    c, s = math.cos(angle), math.sin(angle)
    into_orbit = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    r, v = alone.position, alone.velocity
    relative = v - turning.spin * np.cross([0.0, 0.0, 1.0], r)
    a, expected = turning(relative @ into_orbit, r @ into_orbit) @ into_orbit.T, alone(v, r)
    np.testing.assert_allclose(a, expected, rtol=0.0, atol=1e-8 * np.abs(expected).max())


@by_bead_law
def test_the_circular_orbit_of_a_bead_law_stays_where_it_is(law):
    """A bead at rest at the centre of the orbit frame feels nothing but what slows all orbits."""
    system = a_ring(law)
    nothing, none = np.zeros((system.n, 3)), np.zeros(system.m, dtype=bool)
    a = acceleration(kernel_arrays(system, 0.0), none, nothing, nothing)
    gravity = system.mean_motion_rad_s**2 * system.orbit_radius_m
    if law.from_potential:
        assert np.abs(a).max() < 1e-17 * gravity
    else:
        assert law.orbit is None and np.abs(a[:, 1:]).max() < 1e-17 * gravity


# -- gravity and the Earth's oblateness ------------------------------------------------------------


def slack_beads(**options):
    """A light system whose tethers are slack: each bead is on an orbit of its own."""
    return ring(satellites=3, tether_length_m=1e9, satellite_mass_kg=1.0, **options)


class Inertial:
    """Motions seen from the Earth's centre in axes that stand still.

    The x axis points to the orbit frame at time 0, the y axis along its motion.
    """

    def __init__(self, system):
        self.system, self.rate = system, system.orbit_rate_rad_s
        self.arrays, self.none = kernel_arrays(system, 0.0), np.zeros(system.m, dtype=bool)

    def axes(self, time):
        """Columns: x, y, z of the orbit frame."""
        c, s = math.cos(self.rate * time), math.sin(self.rate * time)
        return np.array([[s, c, 0.0], [-c, s, 0.0], [0.0, 0.0, 1.0]])

    def seen(self, time, r, v):
        axes, q = self.axes(time), r + np.array([0.0, self.system.orbit_radius_m, 0.0])
        return q @ axes.T, (v + self.rate * np.cross([0.0, 0.0, 1.0], q)) @ axes.T

    def unseen(self, time, q, u):
        axes = self.axes(time)
        q, u = q @ axes, u @ axes
        r = q - np.array([0.0, self.system.orbit_radius_m, 0.0])
        return r, u - self.rate * np.cross([0.0, 0.0, 1.0], q)

    def acceleration(self, q, u):
        """Of beads at time 0."""
        r, v = self.unseen(0.0, q, u)
        z = np.array([0.0, 0.0, 1.0])
        a = acceleration(self.arrays, self.none, v, r)
        rotating = r + np.array([0.0, self.system.orbit_radius_m, 0.0])
        a = a + 2.0 * self.rate * np.cross(z, v)
        return (a + self.rate**2 * np.cross(z, np.cross(z, rotating))) @ self.axes(0.0).T

    def motion(self, q, u, end, **options):
        """By scipy in the orbit frame, all beads alike; q and u there of the first."""
        n = self.system.n

        def derivative(_, x):
            r, v = np.tile(x[:3], (n, 1)), np.tile(x[3:], (n, 1))
            return np.concatenate([x[3:], acceleration(self.arrays, self.none, v, r)[0]])

        r, v = self.unseen(0.0, q, u)
        x = np.concatenate([r, v])
        return solve_ivp(
            derivative, (0.0, end), x, "DOP853", rtol=1e-12, atol=1e-7, **options
        )


def a_few_orbits(seed, n=3):
    """Places and velocities at random about the Earth, within 1000 km of a circle's."""
    rng = np.random.default_rng(seed)
    return rng.normal(0.0, 3e5, (n, 3)) + [7378e3, 0, 0], rng.normal(0, 300, (n, 3)) + [0, 7e3, 1e3]


@pytest.mark.parametrize("seed", range(3))
def test_gravity_is_the_printed_formula(seed):
    """Eq. (2) about the Earth's centre, without what its own frame adds."""
    q, u = a_few_orbits(seed)
    expected = -MU_EARTH * q / np.linalg.norm(q, axis=1)[:, None] ** 3
    a = Inertial(slack_beads()).acceleration(q, u)
    np.testing.assert_allclose(a, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())


def test_linear_gravity_is_gravity_to_first_order():
    """Half as far from the centre, the two differ by a quarter."""
    r = np.random.default_rng(1).normal(0.0, 1e3, (3, 3))
    still, none = np.zeros((3, 3)), np.zeros(3, dtype=bool)
    full, linear = (kernel_arrays(slack_beads(linear_gravity=x), 0.0) for x in (False, True))
    gaps = [
        acceleration(full, none, still, part * r) - acceleration(linear, none, still, part * r)
        for part in (1.0, 0.5)
    ]
    largest = np.abs(gaps[0]).max()
    assert largest < 1e-3 * np.abs(acceleration(linear, none, still, r)).max()
    np.testing.assert_allclose(gaps[1], gaps[0] / 4.0, rtol=0.0, atol=1e-3 * largest)


def test_a_circle_round_the_equator_is_faster_on_an_oblate_earth():
    """Its centrifugal force balances mu/R^2 (1 + (3/2) J2 (Re/R)^2)."""
    system = slack_beads(j2=1.08263e-3)
    radius = system.orbit_radius_m
    pull = MU_EARTH / radius**2 * (1.0 + 1.5 * 1.08263e-3 * (6378.137e3 / radius) ** 2)
    assert system.orbit_rate_rad_s**2 * radius == pytest.approx(pull, rel=1e-14)
    assert system.orbit_rate_rad_s > 1.0005 * system.mean_motion_rad_s


@pytest.mark.parametrize("seed", range(3))
def test_oblateness_is_the_printed_formula(seed):
    """PHYSICS 7: -(3/2) J2 mu Re^2/r^5 [(1 - 5 Z^2/r^2) (X, Y), (3 - 5 Z^2/r^2) Z]."""
    j2 = 1.08263e-3
    q, u = a_few_orbits(seed)
    r = np.linalg.norm(q, axis=1)[:, None]
    tall = 5.0 * q[:, 2:] ** 2 / r**2
    expected = -1.5 * j2 * MU_EARTH * 6378.137e3**2 / r**5 * np.hstack(
        [(1.0 - tall) * q[:, :2], (3.0 - tall) * q[:, 2:]]
    )  # fmt: skip
    a = Inertial(slack_beads(j2=j2)).acceleration(q, u) - Inertial(slack_beads()).acceleration(q, u)
    np.testing.assert_allclose(a, expected, atol=2e-12 * np.abs(expected).max() / j2)


def elements(q, u):
    """Node and argument of perigee [rad], inclination, semi-latus rectum and semi-major axis."""
    h = np.cross(q, u)
    eccentricity = np.cross(u, h) / MU_EARTH - q / np.linalg.norm(q)
    node = np.array([-h[1], h[0], 0.0])
    line = node / np.linalg.norm(node)
    across = np.cross(h / np.linalg.norm(h), line)
    return (
        math.atan2(node[1], node[0]),
        math.atan2(eccentricity @ across, eccentricity @ line),
        math.acos(h[2] / np.linalg.norm(h)),
        h @ h / MU_EARTH,
        1.0 / (2.0 / np.linalg.norm(q) - u @ u / MU_EARTH),
    )


def at_perigees(system, inclination, eccentricity, orbits):
    """Time and elements whenever a bead on an orbit of this inclination passes its perigee."""
    seen = Inertial(system)
    a = system.orbit_radius_m * 1.05
    nearest = a * (1.0 - eccentricity)
    fastest = math.sqrt(MU_EARTH / a * (1.0 + eccentricity) / (1.0 - eccentricity))
    # The perigee lies 40 degrees behind the node.
    c, s = math.cos(math.radians(40.0)), math.sin(math.radians(40.0))
    tilt = np.array([0.0, math.cos(inclination), math.sin(inclination)])
    node = np.array([1.0, 0.0, 0.0])
    q, u = nearest * (c * node + s * tilt), fastest * (-s * node + c * tilt)

    def away(time, x):
        q, u = seen.seen(time, x[:3], x[3:])
        return q @ u

    away.direction = 1.0
    period = 2.0 * math.pi * math.sqrt(a**3 / MU_EARTH)
    # Begin away from the perigee, so that the first passage is not the beginning itself.
    solution = seen.motion(q, u, (orbits + 0.5) * period, events=away)
    times, states = solution.t_events[0], solution.y_events[0]
    later = times > 0.5 * period
    return times[later], [
        elements(*seen.seen(t, x[:3], x[3:])) for t, x in zip(times[later], states[later])
    ]


@pytest.mark.parametrize("degrees", [5.0, 40.0, 63.4349488, 80.0, 120.0])
def test_node_and_perigee_of_inclined_orbits_move_as_they_should(degrees):
    """-(3/2) n J2 (Re/p)^2 cos i and (3/4) n J2 (Re/p)^2 (5 cos^2 i - 1), PHYSICS 7.

    The frame is one of an equatorial orbit, the bead's own orbit is not.
    """
    j2 = 2e-5
    system = slack_beads(j2=j2)
    times, found = at_perigees(system, math.radians(degrees), 0.1, 3)
    (node, perigee, i, p, a), end = found[0], found[-1]
    lasted = times[-1] - times[0]
    unit = j2 * math.sqrt(MU_EARTH / a**3) * (EQUATORIAL_RADIUS_M / p) ** 2
    node_rate = math.remainder(end[0] - node, 2 * math.pi) / lasted / unit
    perigee_rate = math.remainder(end[1] - perigee, 2 * math.pi) / lasted / unit
    assert len(found) == 3
    assert node_rate == pytest.approx(-1.5 * math.cos(i), abs=1e-3)
    assert perigee_rate == pytest.approx(0.75 * (5.0 * math.cos(i) ** 2 - 1.0), abs=2e-3)


def test_the_perigee_of_a_nearly_equatorial_orbit_moves_half_as_fast_as_from_its_node():
    """Against the stars: 3 - 3/2, since the node goes back; what a formation's orbit shows."""
    system = slack_beads(j2=2e-5)
    times, found = at_perigees(system, 1e-3, 0.05, 3)
    longitude = [node + perigee for node, perigee, *_ in found]
    _, _, _, p, a = found[0]
    unit = 2e-5 * math.sqrt(MU_EARTH / a**3) * (EQUATORIAL_RADIUS_M / p) ** 2
    rate = math.remainder(longitude[-1] - longitude[0], 2.0 * math.pi) / (times[-1] - times[0])
    assert rate / unit == pytest.approx(1.5, abs=1e-3)


# -- drag ------------------------------------------------------------------------------------------

DRAG = {"drag_m2_per_kg": 2.0, "air_density_kg_m3": 1e-13, "scale_height_m": 6e4}


@pytest.mark.parametrize("seed", range(3))
def test_drag_is_that_of_air_which_turns_with_the_earth(seed):
    q, u = a_few_orbits(seed)
    system = slack_beads(**DRAG)
    against = u - EARTH_RATE_RAD_S * np.cross([0.0, 0.0, 1.0], q)
    height = np.linalg.norm(q, axis=1)[:, None] - system.orbit_radius_m
    density = 1e-13 * np.exp(-height / 6e4)
    expected = -0.5 * density * 2.0 * np.linalg.norm(against, axis=1)[:, None] * against
    a = Inertial(system).acceleration(q, u) - Inertial(slack_beads()).acceleration(q, u)
    np.testing.assert_allclose(a, expected, rtol=1e-9, atol=1e-13)


def test_drag_makes_circular_orbits_fall():
    """da/dt = -rho (Cd A/m) sqrt(mu a), times ((v - wind) / v)^2 as the air turns, too."""
    system = slack_beads(**DRAG)
    seen, n, radius = Inertial(system), system.mean_motion_rad_s, system.orbit_radius_m
    end = 2.0 * math.pi / n
    q, u = seen.seen(0.0, np.zeros(3), np.zeros(3))
    assert np.linalg.norm(u) == pytest.approx(n * radius, rel=1e-14)
    x = seen.motion(q, u, end).y[:, -1]
    q, u = seen.seen(end, x[:3], x[3:])
    a = 1.0 / (2.0 / np.linalg.norm(q) - u @ u / MU_EARTH)
    expected = -1e-13 * 2.0 * math.sqrt(MU_EARTH * radius) * (1.0 - EARTH_RATE_RAD_S / n) ** 2
    assert (a - radius) / end == pytest.approx(expected, rel=1e-3)
    assert a - radius < -50.0


def test_drag_takes_the_angular_momentum_that_its_torque_says():
    """Of a whole formation with taut tethers about the Earth's centre, where gravity has no torque.

    Its mass times its acceleration is the drag of all beads together: tethers add nothing.
    """
    options = {"damping_n_s_per_m": 500.0, "beads_per_tether": 1}
    system = ring(**DRAG, **options)
    mass, seen = system.mass_kg[:, None], Inertial(system)
    start = disturbed(initial_state(ring(**options), SPIN), 1.0, seed=1)
    end = 300.0
    motion = Propagator(system, SPIN, start, rtol=1e-12)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    times = np.concatenate([[0.0], 0.5 * end * (1.0 + nodes), [end]])
    torques, momenta = [], []
    for time, r, v in zip(times, *motion.sample(times)):
        q, u = seen.seen(time, r, v)
        against = u - EARTH_RATE_RAD_S * np.cross([0.0, 0.0, 1.0], q)
        height = np.linalg.norm(q, axis=1)[:, None] - system.orbit_radius_m
        speed = np.linalg.norm(against, axis=1)[:, None]
        force = -mass * 1e-13 * np.exp(-height / 6e4) * speed * against
        torques.append(np.cross(q, force).sum(axis=0))
        momenta.append((mass * np.cross(q, u)).sum(axis=0))
    change = 0.5 * end * weights @ np.array(torques[1:-1])
    np.testing.assert_allclose(momenta[-1] - momenta[0], change, rtol=0.0,
                               atol=1e-6 * np.abs(change).max())  # fmt: skip
    assert abs(change[2] / momenta[0][2]) > 1e-8


def test_drag_changes_the_momentum_of_a_formation_by_its_own_sum():
    """With taut, damped tethers of every law: these give and take alike."""
    for law in TETHER_LAWS:
        system, free = a_ring(law, **DRAG), a_ring(law)
        state = a_state(system, 1.002)
        taut = np.ones(system.m, dtype=bool)
        r, v, mass = state.position_m, state.velocity_m_s, system.mass_kg
        with_drag, without, drag = (
            mass @ acceleration(kernel_arrays(s, 0.0), tight, v, r)
            for s, tight in ((system, taut), (free, taut), (system, ~taut))
        )
        alone = drag - mass @ acceleration(kernel_arrays(free, 0.0), ~taut, v, r)
        np.testing.assert_allclose(with_drag - without, alone, atol=1e-9 * np.abs(alone).max())


# -- laws and values that are refused --------------------------------------------------------------


def spring_and(more):
    return lambda t: t.stiffness * (t.length - t.rest) + more(t)


@pytest.mark.parametrize(
    "tension",
    [
        spring_and(lambda t: 2.0 * t.damping * t.rate),
        spring_and(lambda t: t.damping * t.rate**2),
        spring_and(lambda t: t.damping * t.rate * (t.length / t.rest)),
        spring_and(lambda t: 0.0),
    ],
    ids=["twice the damping", "by the square of the rate", "rate times length", "no damping"],
)
def test_a_tension_that_grows_otherwise_than_by_the_damping_is_refused(tension, monkeypatch):
    """By itself, and when it is registered: then nothing can be made."""
    law = TetherLaw("odd", "an odd one", tension, TETHER_LAWS[0].energy, pushes=True)
    refused = pytest.raises(ValueError, match="tether law 'odd': the tension must grow by damping")
    with refused:
        tension_of(law)
    monkeypatch.setattr(laws, "TETHER_LAWS", (*TETHER_LAWS, law))
    with refused:
        runpy.run_path(made.__file__)


def test_a_registered_tether_law_gets_code_of_its_own_only_for_another_tension(monkeypatch):
    same = replace(TETHER_LAWS[0], name="same")
    other = replace(same, name="other", tension=spring_and(lambda t: 2.0 * (t.length - t.rest)
                                                           + t.damping * t.rate))  # fmt: skip
    monkeypatch.setattr(laws, "TETHER_LAWS", (*TETHER_LAWS, same, other))
    index = runpy.run_path(made.__file__)["TENSION_INDEX"]
    assert index["same"] == index[TETHER_LAWS[0].name] == 0
    assert index["other"] == len(made.TENSIONS)


def owner(parameter):
    """A law that has a parameter; any for the elements of the orbit."""
    owners = (law for law in (*TETHER_LAWS, *BEAD_LAWS) if parameter in law.parameters)
    return next(owners, BEAD_LAWS[0])


@pytest.mark.parametrize("parameter", LAW_PARAMETERS, ids=[p.name for p in LAW_PARAMETERS])
def test_values_of_law_parameters_are_kept_to_their_range(parameter):
    law, name = owner(parameter), parameter.name
    for edge in (parameter.minimum, parameter.maximum, parameter.default):
        assert a_ring(law, **{name: edge}).law_parameters[name] == edge
    assert parameter.minimum <= parameter.default <= parameter.maximum
    below, above = parameter.minimum - 1e-3, parameter.maximum * 1.01
    with pytest.raises(TssError, match=f"{name} must be at least {parameter.minimum:g}"):
        a_ring(law, **{name: below})
    with pytest.raises(TssError, match=re.escape(f"{name} must be at most {parameter.maximum:g}")):
        a_ring(law, **{name: above})
    for value in (math.nan, math.inf):
        with pytest.raises(TssError, match=f"{name} must be a finite number"):
            a_ring(law, **{name: value})


@by_tether_law
def test_parameters_of_another_tether_law_are_refused(law):
    for other in TETHER_LAWS:
        for parameter in set(other.parameters) - set(law.parameters):
            with pytest.raises(TssError, match=f"{parameter.name} .* only tether_law {other.name}"):
                a_ring(law, **{parameter.name: values(other)[parameter.name]})


def test_laws_are_told_apart_by_name():
    for registered in (TETHER_LAWS, BEAD_LAWS, LAW_PARAMETERS):
        names = [one.name for one in registered]
        assert len(set(names)) == len(names)
    with pytest.raises(TssError, match="tether_law must be one of .*, got 'tension_onyl'"):
        ring(tether_law="tension_onyl")
    named = "'j3' is no parameter of a law that is loaded; .* TSS_ROS_LAWS; allowed are stiffening"
    with pytest.raises(TssError, match=named):
        ring(j3=1e-6)


@by_bead_law
def test_a_bead_law_acts_where_its_first_parameter_is_not_zero(law):
    if law.parameters:
        assert law in a_ring(law).acting_laws
        assert law not in a_ring(law, **{law.parameters[0].name: 0.0}).acting_laws
        assert law not in ring().acting_laws
    else:
        chosen = {one.name for one in a_ring(law).acting_laws}
        assert chosen == {law.name}
