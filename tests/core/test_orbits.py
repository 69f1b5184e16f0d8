"""Orbits that are no circles at rest: Kepler, J2, drag and sunlight; Floquet and growth on them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tss_ros.core import (
    GrowthResult,
    NoSteadyState,
    Propagator,
    ReferenceOrbit,
    Satellite,
    State,
    Tether,
    TssError,
    assemble,
    compute_floquet,
    compute_modes,
    disturbed,
    find_critical_rates,
    follow,
    initial_state,
    lyapunov_exponents,
    orbit_elements,
    ring,
)
from tss_ros.core.model.laws.drag import EARTH_RATE_RAD_S
from tss_ros.core.model.laws.oblateness import EQUATORIAL_RADIUS_M
from tss_ros.core.model.system import MU_EARTH, RADIUS_EARTH_M
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator

J2 = 1.08263e-3
ELLIPSE = {"eccentricity": 0.3, "true_anomaly_deg": 40.0}
INCLINED = {"j2": J2, "inclination_deg": 50.0, "argument_of_perigee_deg": 30.0, "raan_deg": 100.0}
SUNLIT = {"solar_pressure_m2_per_kg": 20.0, "sun_longitude_deg": 70.0}
BLOWN = {"drag_m2_per_kg": 5.0, "air_density_kg_m3": 1e-10, "scale_height_m": 6e4}
ALL = {**INCLINED, **SUNLIT, **BLOWN, "eccentricity": 0.1}


def dumbbell(stiffness=5e6, damping=2000.0, **kw):
    """10 km long, along the vertical, of 100 kg at each end."""
    return assemble(
        [Satellite("up", 100.0, (0.0, 5e3, 0.0)), Satellite("down", 100.0, (0.0, -5e3, 0.0))],
        [Tether("tether", (0, 1), (1e4,), (stiffness,), (damping,), ())],
        **kw,
    )


# -- elements and states ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"inclination_deg": 33.0, "raan_deg": 200.0, "true_anomaly_deg": 17.0},
        {"eccentricity": 0.2, "argument_of_perigee_deg": 300.0, "true_anomaly_deg": 123.0},
        {"eccentricity": 0.7, "inclination_deg": 180.0, "argument_of_perigee_deg": 5.0},
        {"eccentricity": 0.9, "inclination_deg": 97.0, "raan_deg": 10.0,
         "argument_of_perigee_deg": 250.0, "true_anomaly_deg": 350.0},
    ],
    ids=["equatorial circle", "circle", "equatorial", "backwards", "any"],
)  # fmt: skip
def test_elements_make_a_state_and_the_state_makes_the_elements(given):
    system = ring(orbit_altitude_m=7e5, **given)
    state = ReferenceOrbit(system).inertial_state(np.zeros(1))
    found = orbit_elements(*(x[0] for x in state))
    angles = ("inclination_deg", "raan_deg", "argument_of_perigee_deg", "true_anomaly_deg")
    expected = {"orbit_altitude_m": 7e5, "eccentricity": 0.0, **dict.fromkeys(angles, 0.0)}
    assert found.keys() == expected.keys()
    for name, value in (expected | given).items():
        if name == "orbit_altitude_m":
            assert found[name] == pytest.approx(value, abs=1e-6)
        elif name == "eccentricity":
            assert found[name] == pytest.approx(value, abs=1e-13)
        else:
            assert math.remainder(found[name] - value, 360.0) == pytest.approx(0.0, abs=1e-9)


def test_a_state_that_is_no_orbit_round_the_earth_is_refused():
    place, speed = np.array([7e6, 0.0, 0.0]), math.sqrt(MU_EARTH / 7e6)
    with pytest.raises(TssError, match="an eccentricity below 1, got 1.42"):
        orbit_elements(place, np.array([0.0, 1.5563 * speed, 0.0]))
    with pytest.raises(TssError, match=r"at least 6378 km from its centre, got 4764\.\d+ km"):
        orbit_elements(place, np.array([0.0, 0.9 * speed, 0.0]))
    with pytest.raises(TssError, match="straight line"):
        orbit_elements(place, place)
    with pytest.raises(TssError, match="velocity_m_s must be three finite numbers"):
        orbit_elements(place, np.array([0.0, math.nan, 0.0]))


@pytest.mark.parametrize("eccentricity", [0.0, 0.3, 0.9])
def test_an_ellipse_is_keplers(eccentricity):
    """Perigee and apogee, speeds there, energy and momentum everywhere, and the third law."""
    system = ring(eccentricity=eccentricity, solar_pressure_m2_per_kg=1.0)
    orbit, a = ReferenceOrbit(system), system.orbit_radius_m / (1.0 - eccentricity)
    assert orbit.period_s == pytest.approx(2.0 * math.pi * math.sqrt(a**3 / MU_EARTH), rel=1e-14)
    q, v = orbit.state(orbit.period_s * np.linspace(0.0, 1.0, 201))
    distance, speed = np.linalg.norm(q, axis=1), np.linalg.norm(v, axis=1)
    assert distance[0] == pytest.approx(a * (1.0 - eccentricity), rel=1e-13)
    assert distance[100] == pytest.approx(a * (1.0 + eccentricity), rel=1e-13)
    energy = speed**2 / 2.0 - MU_EARTH / distance
    np.testing.assert_allclose(energy, -MU_EARTH / (2.0 * a), rtol=2e-13)
    momentum = math.sqrt(MU_EARTH * a * (1.0 - eccentricity**2))
    np.testing.assert_allclose(np.cross(q, v)[:, 2], momentum, rtol=2e-13)
    np.testing.assert_allclose(q[-1], q[0], atol=1e-12 * a)


def earth_pulls(q, j2, pole=(0.0, 0.0, 1.0)):
    """Gravity with J2 at places (..., 3) in Earth-centred inertial axes; of complex numbers too."""
    r = np.sqrt(np.sum(q * q, axis=-1, keepdims=True))
    tall = 5.0 * q[..., 2:] ** 2 / r**2
    flat = -1.5 * j2 * MU_EARTH * EQUATORIAL_RADIUS_M**2 / r**5
    bulge = np.concatenate([(1.0 - tall) * q[..., :2], (3.0 - tall) * q[..., 2:]], axis=-1)
    return -MU_EARTH * q / r**3 + flat * bulge


def test_an_orbit_of_an_oblate_earth_is_the_integrated_one():
    orbit = ReferenceOrbit(ring(eccentricity=0.2, **INCLINED))
    times = np.linspace(0.0, 5.3 * orbit.period_s, 60)
    q, v = orbit.inertial_state(times)

    def derivative(_, x):
        return np.concatenate([x[3:], earth_pulls(x[:3], J2)])

    solution = solve_ivp(derivative, (0.0, times[-1]), [*q[0], *v[0]], "DOP853", t_eval=times,
                         rtol=1e-13, atol=1e-7)  # fmt: skip
    np.testing.assert_allclose(q, solution.y[:3].T, rtol=0.0, atol=2e-10 * 7e6)
    np.testing.assert_allclose(v, solution.y[3:].T, rtol=0.0, atol=2e-10 * 7e3)
    # Asked for the end alone, or for all, it is the same bit for bit.
    again = ReferenceOrbit(ring(eccentricity=0.2, **INCLINED)).state(times[-1:])
    np.testing.assert_array_equal(again[0][0], orbit.state(times)[0][-1])


@pytest.mark.parametrize("degrees", [5.0, 50.0, 63.4349488, 80.0, 120.0])
def test_node_and_perigee_move_as_they_should(degrees):
    """-(3/2) n J2 (Re/p)^2 cos i and (3/4) n J2 (Re/p)^2 (5 cos^2 i - 1), over ten orbits."""
    system = ring(eccentricity=0.1, j2=2e-5, inclination_deg=degrees, raan_deg=50.0,
                  argument_of_perigee_deg=80.0)  # fmt: skip
    orbit, names = ReferenceOrbit(system), ("raan_deg", "argument_of_perigee_deg")
    phases = np.arange(40) / 40.0
    mean = []
    for begin in (0.0, 10.0):
        q, v = orbit.inertial_state((begin + phases) * orbit.period_s)
        found = [orbit_elements(*state) for state in zip(q, v)]
        mean.append([np.mean([one[name] for one in found]) for name in names])
    node, perigee = np.radians(np.subtract(*mean[::-1])) / (10.0 * orbit.period_s)
    p = system.orbit_radius_m * 1.1
    unit = 2e-5 * system.mean_motion_rad_s * (EQUATORIAL_RADIUS_M / p) ** 2
    cosine = math.cos(math.radians(degrees))
    assert node / unit == pytest.approx(-1.5 * cosine, abs=2e-3)
    assert perigee / unit == pytest.approx(0.75 * (5.0 * cosine**2 - 1.0), abs=5e-3)
    assert orbit.node_rate_rad_s / unit == pytest.approx(-1.5 * cosine, rel=1e-12)
    assert orbit.perigee_rate_rad_s / unit == pytest.approx(
        0.75 * (5.0 * cosine**2 - 1.0), rel=1e-9, abs=1e-7
    )


# -- motions against an independent integration ----------------------------------------------------


class Inertial:
    """A formation in Earth-centred inertial axes by the printed formulas, tethers always taut.

    States hold the centre's own orbit, and what beads are away from it, so that nothing cancels.
    """

    def __init__(self, system):
        self.system, values = system, system.law_parameters
        self.j2 = values["j2"]
        self.drag, self.density = values["drag_m2_per_kg"], values["air_density_kg_m3"]
        self.scale = values["scale_height_m"]
        longitude, tilt = math.radians(values["sun_longitude_deg"]), math.radians(23.44)
        sun = [math.cos(longitude), math.sin(longitude) * math.cos(tilt),
               math.sin(longitude) * math.sin(tilt)]  # fmt: skip
        self.light = -4.56e-6 * values["solar_pressure_m2_per_kg"] * np.array(sun)
        self.centre = [x[0] for x in ReferenceOrbit(system).inertial_state(np.zeros(1))]

    def frame(self, q, v):
        """Axes of the orbit frame (rows), and its turning."""
        r, h = np.linalg.norm(q), np.cross(q, v)
        up, normal, size = q / r, h / np.linalg.norm(h), np.linalg.norm(h)
        pull = earth_pulls(q, self.j2) @ normal
        axes = np.array([np.cross(up, normal), up, normal])
        return axes, r / size * pull * up + size / r**2 * normal

    def start(self, r, v):
        """State vector of positions and velocities (n, 3) in the orbit frame at time 0."""
        axes, turning = self.frame(*self.centre)
        r = r @ axes
        v = v @ axes + np.cross(turning, r)
        return np.concatenate([*self.centre, r.ravel(), v.ravel()])

    def seen(self, x):
        """Positions and velocities in the orbit frame, of a real state vector."""
        axes, turning = self.frame(x[:3], x[3:6])
        r, v = x[6:].reshape(2, -1, 3)
        return r @ axes.T, (v - np.cross(turning, r)) @ axes.T

    def derivative(self, _, x):
        system = self.system
        q, u = x[:3], x[3:6]
        r, v = x[6:].reshape(2, -1, 3)
        centre = earth_pulls(q, self.j2)
        a = earth_pulls(q + r, self.j2) - centre + self.light
        if self.drag:
            place = q + r
            wind = EARTH_RATE_RAD_S * np.cross([0.0, 0.0, 1.0], place)
            against = u + v - wind
            height = np.sqrt(np.sum(place**2, axis=1)) - system.orbit_radius_m
            air = self.density * np.exp(-height / self.scale)
            speed = np.sqrt(np.sum(against**2, axis=1))
            a = a - 0.5 * self.drag * (air * speed)[:, None] * against
        for k, (i, j) in enumerate(system.tether_ends):
            e, w = r[i] - r[j], v[i] - v[j]
            length = np.sqrt(np.sum(e * e))
            rest = system.rest_length_m[k]
            pull = system.axial_stiffness_n[k] / rest * (length - rest)
            pull = pull + system.damping_n_s_per_m[k] * np.sum(e * w) / length
            a[i] -= pull / length * e / system.mass_kg[i]
            a[j] += pull / length * e / system.mass_kg[j]
        return np.concatenate([u, centre, v.ravel(), a.ravel()])

    def motion(self, x, times):
        """State vectors at some times."""
        solution = solve_ivp(
            self.derivative, (0.0, times[-1]), x, "DOP853", t_eval=times, rtol=3e-13, atol=1e-10
        )
        assert solution.success, solution.message
        return solution.y.T


def triangle(**laws):
    """Soft tethers that push as well, so that scipy is quick."""
    return ring(tether_length_m=1e4, satellite_mass_kg=100.0, axial_stiffness_n=2e3,
                damping_n_s_per_m=5.0, bilateral=True, **laws)  # fmt: skip


def tumbling(system, ratio=-3.0):
    """A start that leaves the plane."""
    state = disturbed(initial_state(system, ratio), 50.0, seed=4)
    return State(state.position_m, state.velocity_m_s + np.array([0.1, -0.2, 0.3]))


ORBITS = {
    "ellipse": ELLIPSE, "inclined, oblate": INCLINED, "sunlit circle": SUNLIT,
    "windy circle": {**BLOWN, "inclination_deg": 120.0}, "all at once": ALL,
}  # fmt: skip
on_all_orbits = pytest.mark.parametrize("laws", ORBITS.values(), ids=list(ORBITS))


@on_all_orbits
def test_motions_are_those_of_an_independent_integration(laws):
    system = triangle(**laws)
    state, seen = tumbling(system), Inertial(system)
    motion = Propagator(system, -3.0, state, rtol=1e-12)
    times = np.linspace(0.0, system.period_s(0.0), 5)
    r, v = motion.sample(times)
    expected = seen.motion(seen.start(state.position_m, state.velocity_m_s), times)
    speed = 3.0 * system.orbit_rate_rad_s * 1e4
    for k, x in enumerate(expected):
        place, velocity = seen.seen(x)
        np.testing.assert_allclose(r[k], place, rtol=0.0, atol=2e-9 * 1e4)
        np.testing.assert_allclose(v[k], velocity, rtol=0.0, atol=4e-9 * speed)


@on_all_orbits
def test_laws_change_what_an_independent_integration_says_they_do(laws):
    """So that the test before would see a law that is left out."""
    bare = triangle()
    state = tumbling(triangle(**laws))
    ends = [
        Propagator(system, -3.0, state, rtol=1e-10).sample(np.array([3000.0]))[0]
        for system in (bare, triangle(**laws))
    ]
    assert np.abs(ends[0] - ends[1]).max() > 1e-4 * 1e4


@pytest.mark.parametrize(
    "laws",
    [
        pytest.param(ELLIPSE, marks=pytest.mark.long, id="ellipse"),
        pytest.param(INCLINED, marks=pytest.mark.long, id="oblate"),
        pytest.param(ALL, id="all"),
    ],
)
def test_variations_are_those_of_an_independent_integration(laws):
    """By complex steps through the printed formulas, over the orbit."""
    system = triangle(**laws)
    integrator = Integrator(system, system.spin_rate_rad_s(-3.0), 1e-11, 5773.0)
    state, seen = tumbling(system), Inertial(system)
    rng, stop = np.random.default_rng(5), 0.5 * system.period_s(0.0)
    columns = rng.standard_normal((2, 3, 3, 3))  # velocities and positions, of three displacements
    orbit, rate = integrator.orbit, integrator.arrays.spin
    scaled = []
    for dv, dr in columns.transpose(3, 0, 1, 2):
        even = orbit.into_even_frame(dv, dr) - rate * np.cross([0.0, 0.0, 1.0], dr)
        scaled.append(integrator.scaled(even, dr))
    motion, carried = carry_displacements(integrator, integrator.begin(state), np.array(scaled).T,
                                          stop)  # fmt: skip
    settings, turn = integrator.settings, rate * stop
    c, s = math.cos(turn), math.sin(turn)
    q = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    x0 = seen.start(state.position_m, state.velocity_m_s)
    for k, (dv, dr) in enumerate(columns.transpose(3, 0, 1, 2)):
        v, r = carried[:, k].reshape(2, 3, 3)
        v, r = v * settings.speed, r * settings.length
        v, r = (v + rate * np.cross([0.0, 0.0, 1.0], r)) @ q.T, r @ q.T
        found_v, found_r = (x[0] for x in orbit.out_of_even_frame([stop], v[None], r[None]))
        # The map to a state vector is affine.
        direction = seen.start(state.position_m + dr, state.velocity_m_s + dv) - x0
        end = seen.motion(x0 + 1e-30j * direction, np.array([0.0, stop]))[-1]
        axes, turning = seen.frame(end[:3].real, end[3:6].real)
        r, v = end[6:].imag.reshape(2, 3, 3) / 1e-30
        expected_r, expected_v = r @ axes.T, (v - np.cross(turning, r)) @ axes.T
        scale = np.abs(expected_r).max()
        np.testing.assert_allclose(found_r, expected_r, rtol=0.0, atol=1e-8 * scale)
        np.testing.assert_allclose(found_v, expected_v, rtol=0.0, atol=1e-8 * scale * 0.1)


@on_all_orbits
def test_accelerations_in_the_orbit_frame_are_the_rates_of_velocities(laws):
    system = triangle(**laws)
    motion = Propagator(system, -3.0, tumbling(system), rtol=1e-12)
    taut = np.ones(system.m, dtype=bool)
    for time in (0.5, 5000.0):
        r, v = motion.sample(time + 0.25 * np.arange(-2, 3))
        a = ReferenceOrbit(system).relative_acceleration(time, taut, v[2], r[2])
        expected = (8.0 * (v[3] - v[1]) - (v[4] - v[0])) / 3.0
        np.testing.assert_allclose(a, expected, rtol=0.0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("laws", [ELLIPSE, INCLINED], ids=["ellipse", "oblate"])
def test_motions_do_not_depend_on_how_calls_are_cut(laws):
    """Nor on a restart from what the integrator remembers: bit for bit."""
    system = ring(damping_n_s_per_m=500.0, **laws)
    state = tumbling(system)
    times = np.linspace(0.0, 3.4 * system.period_s(0.0), 120)
    whole = Propagator(system, -3.0, state).sample(times)
    pieces, parts = Propagator(system, -3.0, state), []
    for k, part in enumerate(np.array_split(times, 17)):
        if k == 9:
            other = Propagator(system, -3.0, state)
            for kept, now in zip(other.integrator_state, pieces.integrator_state):
                kept[...] = now
            pieces = other
        parts.append(pieces.sample(part))
    for one, cut in zip(whole, zip(*parts)):
        np.testing.assert_array_equal(one, np.concatenate(cut))


@pytest.mark.parametrize("laws", [ELLIPSE, INCLINED], ids=["ellipse", "oblate"])
def test_the_ends_of_many_motions_are_those_of_each(laws):
    system = ring(damping_n_s_per_m=500.0, **laws)
    integrator = Integrator(system, system.spin_rate_rad_s(-3.0), 1e-11, 5773.0)
    start = initial_state(system, -3.0)
    states = [disturbed(start, size, seed=1) for size in (1.0, 2.0)]
    ends = integrator.ends(*(np.array([getattr(s, name) for s in states])
                             for name in ("position_m", "velocity_m_s")), 9000.0)  # fmt: skip
    for state, r, v in zip(states, ends.r, ends.v):
        motion = Propagator(system, -3.0, state, rtol=1e-11)
        expected = (x[0] for x in motion.sample(np.array([9000.0])))
        for found, true in zip((r, v), expected):
            np.testing.assert_allclose(found, true, rtol=0.0, atol=1e-7 * np.abs(true).max())


# -- drag and sunlight -----------------------------------------------------------------------------


def inertial_samples(system, motion, times):
    """Places and velocities of the beads in Earth-centred inertial axes, (k, n, 3) each."""
    orbit = ReferenceOrbit(system)
    (q, u), (axes, turning) = orbit.state(times), orbit.frame(times)
    r, v = motion.sample(times)
    r, v = (np.einsum("kji,knj->kni", axes, x) for x in (r, v))
    v = v + np.cross(turning[:, None], r)
    return (q[:, None] + r) @ orbit.axes.T, (u[:, None] + v) @ orbit.axes.T


def test_drag_brings_a_formation_down_as_it_should():
    """da/dt = -(Cd A/m) rho sqrt(mu a) of a circle, by air that turns with the Earth."""
    air = {"drag_m2_per_kg": 0.01, "air_density_kg_m3": 1e-12, "scale_height_m": 1e6}
    system = triangle(inclination_deg=70.0, **air)
    motion = Propagator(system, -3.0, initial_state(system, -3.0), rtol=1e-13)
    orbit = system.period_s(0.0)
    q, u = inertial_samples(system, motion, np.array([0.0, orbit]))
    centre, speed = q.mean(axis=1), u.mean(axis=1)
    a = 1.0 / (2.0 / np.linalg.norm(centre, axis=1) - np.sum(speed**2, axis=1) / MU_EARTH)
    radius, n = system.orbit_radius_m, system.mean_motion_rad_s
    wind = EARTH_RATE_RAD_S / n * math.cos(math.radians(70.0))
    expected = -0.01 * 1e-12 * math.sqrt(MU_EARTH * radius) * (1.0 - wind) ** 2
    assert (a[1] - a[0]) / orbit == pytest.approx(expected, rel=1e-2)


def test_sunlight_gives_the_momentum_that_its_force_says():
    """Angular momentum about the Earth's centre, of which gravity and tethers change nothing."""
    system = triangle(eccentricity=0.2, inclination_deg=30.0, **SUNLIT)
    motion = Propagator(system, -3.0, tumbling(system), rtol=1e-12)
    end = 4000.0
    nodes, weights = np.polynomial.legendre.leggauss(40)
    times = np.concatenate([[0.0], 0.5 * end * (1.0 + nodes), [end]])
    q, u = inertial_samples(system, motion, times)
    force = system.mass_kg[:, None] * Inertial(system).light
    torque = np.cross(q, force).sum(axis=1)
    momentum = np.cross(q, system.mass_kg[:, None] * u).sum(axis=1)
    change = 0.5 * end * weights @ torque[1:-1]
    np.testing.assert_allclose(momentum[-1] - momentum[0], change, rtol=0.0,
                               atol=1e-5 * np.abs(change).max())  # fmt: skip
    assert np.abs(change).max() > 1e-5 * np.abs(momentum[0]).max()


# -- Floquet on the ellipse ------------------------------------------------------------------------

#: PHYSICS 7: amplitude [deg] of the libration of a rigid dumbbell, and trace of its matrix.
LIBRATIONS = {0.05: (2.894, -0.24506), 0.1: (5.956, -0.30891), 0.2: (13.080, -0.62578),
              0.3: (22.029, -1.37508)}  # fmt: skip


@pytest.mark.parametrize("linear", [True, False])
@pytest.mark.parametrize("eccentricity", LIBRATIONS)
def test_a_hanging_dumbbell_librates_with_the_orbit(eccentricity, linear):
    amplitude, trace = LIBRATIONS[eccentricity]
    system = dumbbell(eccentricity=eccentricity, linear_gravity=linear)
    result = compute_floquet(system, 0.0)
    assert result.orbits == 1 and result.family.count("centre of mass") == 6
    motion = Propagator(system, 0.0, result.state, rtol=1e-11)
    r, _ = motion.sample(np.linspace(0.0, result.period_s, 2001))
    arm = r[:, 0] - r[:, 1]
    angle = np.degrees(np.arctan2(-arm[:, 0], arm[:, 1]))
    assert np.abs(angle).max() == pytest.approx(amplitude, abs=1e-3)
    assert angle[-1] == pytest.approx(angle[0], abs=1e-6)
    assert angle[0] == pytest.approx(0.0, abs=1e-3)  # odd
    swings = result.multiplier[np.array(result.family) == "libration"]
    turning = swings[np.abs(swings.imag) > 0.1]
    assert turning.sum().real == pytest.approx(trace, abs=2e-5 if linear else 2e-4)
    np.testing.assert_allclose(np.abs(turning), 1.0, atol=1e-6)
    assert result.largest_error < 1e-6
    # Out of the plane it swings twice in an orbit, and the ellipse drives that.
    assert result.verdict == "unstable"
    assert result.deciding_modulus == pytest.approx(1.0 + 7.0 * eccentricity**4, rel=0.02)


def test_a_hanging_dumbbell_tumbles_beyond_its_eccentricity():
    """Its trace passes -2 at e = 0.3533."""
    for eccentricity, stable in ((0.352, True), (0.3546, False)):
        result = compute_floquet(
            dumbbell(eccentricity=eccentricity, linear_gravity=True), 0.0, certify=False
        )
        swings = result.multiplier[np.array(result.family) == "libration"]
        flat = swings[swings.real < 0.0]
        assert (np.abs(flat).max() < 1.0 + 1e-5) == stable


def test_where_the_orbit_begins_does_not_change_multipliers():
    one, other = (
        compute_floquet(dumbbell(eccentricity=0.2, true_anomaly_deg=nu), 0.0, certify=False)
        for nu in (0.0, 130.0)
    )
    pairs = [np.sort_complex(r.multiplier[np.array(r.family) == "libration"]) for r in (one, other)]
    np.testing.assert_allclose(*pairs, atol=2e-5)


def test_a_formation_that_turns_with_the_orbit_has_multipliers_over_it():
    system = ring(damping_n_s_per_m=500.0, eccentricity=0.05)
    result = compute_floquet(system, -3.5)
    assert result.orbits == 2
    assert result.period_s == pytest.approx(2.0 * system.period_s(0.0), rel=1e-14)
    assert result.closure_residual < 1e-9 and result.largest_error < 1e-6
    counts = {name: result.family.count(name) for name in set(result.family)}
    assert counts == {"centre of mass": 6, "spin": 2, "axis tilt": 4, "shape": 6}
    assert 0.0 < result.spin_loss < 1e-3
    # The circle's, whose period is a turn: seven turns later they are as they are here, nearly.
    circle = compute_floquet(replace_orbit(system, 0.0), -3.5, certify=False)

    def tilts(r, power):
        rho = r.multiplier[np.array(r.family) == "axis tilt"] ** power
        return np.sort(np.abs(np.angle(rho)))

    np.testing.assert_allclose(tilts(result, 1), tilts(circle, 7), atol=0.1)


def replace_orbit(system, eccentricity):
    return replace(system, law_parameters={**system.law_parameters, "eccentricity": eccentricity})


def test_a_motion_over_whole_orbits_comes_back():
    system = dumbbell(5e4, 500.0, eccentricity=0.1, linear_gravity=True)
    result = compute_floquet(system, -3.0, certify=False)
    assert 0.0 < result.spin_loss < 1e-4
    spin = system.spin_rate_rad_s(-3.0)
    integrator = Integrator(system, spin, 1e-12, 5e3).driven(result.spin_loss)
    samples = integrator.samples(np.array([result.period_s]))
    integrator.advance(integrator.begin(result.state), result.period_s * 1.001, samples=samples)
    np.testing.assert_allclose(samples.r[0], result.state.position_m, atol=1e-6 * 5e3)
    np.testing.assert_allclose(
        samples.v[0], result.state.velocity_m_s, atol=1e-6 * 3.0 * system.orbit_rate_rad_s * 5e3
    )


NOT_PERIODIC = {
    "no ratio": ({"eccentricity": 0.05}, "l up to 12: the nearest are -28/11 and -5/2"),
    "oblate": (INCLINED, "j2 acts on an orbit that is inclined by 50 degrees"),
    "sunlit": (SUNLIT, "solar_pressure pushes the formation off its orbit"),
    "windy": ({**BLOWN, "inclination_deg": 30.0}, "drag pushes the formation off its orbit"),
}


@pytest.mark.parametrize("laws, reason", NOT_PERIODIC.values(), ids=list(NOT_PERIODIC))
def test_where_nothing_is_periodic_floquet_says_so_and_names_growth(laws, reason):
    result = compute_floquet(ring(**laws), -2.513)
    assert result.verdict == "none found" and result.multiplier.size == 0
    assert reason in result.message
    assert "lyapunov_exponents" in result.message


def test_what_needs_a_resting_orbit_frame_is_refused_elsewhere():
    system = ring(eccentricity=0.05)
    why = "the orbit is an ellipse of eccentricity 0.05"
    for asked, words in (
        (lambda: compute_floquet(system, -3.0, "frozen"), "method frozen"),
        (lambda: compute_floquet(system, -3.0, leading=4), "leading"),
        (lambda: find_critical_rates(system, -3.0, -2.0), "find_critical_rates"),
        (lambda: follow(system, "damping_n_s_per_m", 10.0, 20.0, spin_rate_ratio=-3.0), "family"),
        (lambda: follow(ring(), "eccentricity", 0.0, 0.1, spin_rate_ratio=-3.0), "family"),
        (lambda: Propagator(system, -3.0, initial_state(system, -3.0), integrator="taylor"),
         "integrator 'taylor'"),
        (lambda: compute_modes(system, compute_floquet(system, -3.0, certify=False)), "modes"),
    ):  # fmt: skip
        with pytest.raises(TssError, match=words) as error:
            asked()
        assert "rest in the orbit frame" in str(error.value)
    assert why in str(pytest.raises(TssError, find_critical_rates, system, -3.0, -2.0).value)


def test_an_equatorial_circle_of_an_oblate_earth_stays_autonomous():
    for inclination in (0.0, 180.0):
        system = ring(j2=J2, inclination_deg=inclination)
        assert system.autonomous and Integrator(system, -3e-3, 1e-9, 5e3).orbit is None
    assert not ring(j2=J2, inclination_deg=1.0).autonomous
    assert not ring(drag_m2_per_kg=0.01, inclination_deg=180.0).autonomous
    assert ring(drag_m2_per_kg=0.01).autonomous and ring(inclination_deg=50.0).autonomous


def test_a_formation_without_a_hanging_shape_is_told():
    with pytest.raises(NoSteadyState, match="no equilibrium found for spin_rate_ratio 0"):
        initial_state(ring(eccentricity=0.1), 0.0)


# -- growth ----------------------------------------------------------------------------------------


def test_growth_is_that_of_the_tilt_in_the_unstable_band():
    """PHYSICS 4: rho = 7.87221 a turn at w = -1.5."""
    system = ring(damping_n_s_per_m=0.0, bilateral=True, linear_gravity=True)
    result = lyapunov_exponents(system, -1.5, turns=40, count=3)
    assert result.verdict == "growing"
    exponent = math.log(7.87221) / result.turn_s
    assert result.exponent_per_s[0] == pytest.approx(exponent, abs=result.error_per_s[0])
    assert result.error_per_s[0] < 0.1 * exponent


def test_growth_along_a_periodic_motion_is_that_of_its_multipliers():
    system = dumbbell(eccentricity=0.3, linear_gravity=True)
    floquet = compute_floquet(system, 0.0, certify=False)
    result = lyapunov_exponents(system, 0.0, turns=200, state=floquet.state)
    expected = math.log(floquet.max_modulus_nontrivial) / floquet.period_s
    assert result.verdict == "growing"
    assert result.exponent_per_s[0] == pytest.approx(expected, abs=result.error_per_s[0])
    assert result.error_per_s[0] < 0.2 * expected


def test_growth_that_is_not_there_is_not_seen(tmp_path):
    """The drift of the centre of mass grows with time alone, which the error says."""
    system = ring(damping_n_s_per_m=500.0, **INCLINED)
    result = lyapunov_exponents(system, -3.5, turns=100)
    assert result.verdict == "no growth seen"
    assert result.exponent_per_s[0] < 3.0 * result.error_per_s[0]
    assert result.history_per_s.shape == (100, 2)
    result.save(tmp_path / "growth.npz")
    again = GrowthResult.load(tmp_path / "growth.npz")
    np.testing.assert_array_equal(again.history_per_s, result.history_per_s)
    assert again.verdict == result.verdict and "in 100 turns" in repr(again)
    assert result.plot().axes[0].get_ylabel().startswith("mean growth")
    assert len(result.to_pandas()) == 100
    for name, value in (("turns", 3), ("count", 0), ("count", 19)):
        with pytest.raises(TssError, match=name):
            lyapunov_exponents(system, -3.5, **{"turns": 16, name: value})


def test_the_altitude_is_that_of_the_perigee():
    system = ring(eccentricity=0.3)
    assert system.orbit_radius_m == RADIUS_EARTH_M + 1e6
    assert np.linalg.norm(ReferenceOrbit(system).state(np.zeros(1))[0]) == pytest.approx(
        system.orbit_radius_m, rel=1e-14
    )
