"""Forces of thrusters and tethers that fail: momentum, energy, and an independent integration."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tss_ros import core
from tss_ros.core import Commands, Propagator, TssError
from tss_ros.core.model.commands import FRAMES
from tss_ros.core.motion.state import IntegratorState

RING = core.ring(damping_n_s_per_m=100.0)
RATIO = -2.9
MU = 3.986e14
OMEGA = math.sqrt(MU / 7378e3**3)
START = core.disturbed(core.initial_state(RING, RATIO), 5.0, 2)
PUSH = Commands.of(
    RING,
    [("satellite_1", "orbit", (0.5, -0.2, 0.1)), ("satellite_2", "inertial", (0.3, 0.4, -0.2)),
     ("satellite_3", "spinning", (-0.4, 0.1, 0.3))],
)  # fmt: skip


def propagator(start=START, **options):
    return Propagator(RING, RATIO, start, **options)


def cross_z(rate, r):
    return rate * np.stack([-r[..., 1], r[..., 0], np.zeros_like(r[..., 0])], axis=-1)


def turned(angle, r):
    """Turned counter-clockwise about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * r[..., 0] - s * r[..., 1], s * r[..., 0] + c * r[..., 1], r[..., 2]], -1)


# -- an independent integration --------------------------------------------------------------------


def about(axis, angle, vector):
    """A vector turned about an axis, Rodrigues."""
    c, s = math.cos(angle), math.sin(angle)
    return c * vector + s * np.cross(axis, vector) + (1 - c) * axis * (axis @ vector)


def free_bodies(position_m, velocity_m_s, push_m_s2, times_s, e=0.0):
    """Bodies round the Earth, in axes fixed among the stars, and back in the orbit frame.

    `push_m_s2(t, axes)` gives the accelerations (n, 3) in these axes; the columns of `axes` are
    those of the orbit frame. The orbit begins at its perigee.
    """
    radius, n = 7378e3, len(position_m)
    speed = math.sqrt(MU * (1 + e) / radius)

    def frame(q, v):
        up, normal = q / np.linalg.norm(q), np.cross(q, v)
        normal /= np.linalg.norm(normal)
        return np.stack([np.cross(up, normal), up, normal], axis=1)

    centre_r, centre_v = np.array([0.0, radius, 0.0]), np.array([-speed, 0.0, 0.0])
    r0 = np.vstack([centre_r, centre_r + position_m])
    v0 = np.vstack([centre_v, centre_v + velocity_m_s + cross_z(speed / radius, position_m)])

    def rates(t, y):
        r, v = y.reshape(2, n + 1, 3)
        a = -MU * r / np.linalg.norm(r, axis=1)[:, None] ** 3
        a[1:] += push_m_s2(t, frame(r[0], v[0]))
        return np.concatenate([v.ravel(), a.ravel()])

    found = solve_ivp(
        rates, (0.0, times_s[-1]), np.concatenate([r0.ravel(), v0.ravel()]), "DOP853",
        t_eval=times_s, rtol=1e-13, atol=1e-7,
    )  # fmt: skip
    states = found.y.T.reshape(-1, 2, n + 1, 3)
    return np.stack([(r[1:] - r[0]) @ frame(r[0], v[0]) for r, v in states])


@pytest.mark.parametrize("eccentricity", [0.0, 0.1])
@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
@pytest.mark.parametrize("frame", FRAMES)
def test_a_force_on_satellites_that_have_come_free_agrees_with_dop853(frame, axis, eccentricity):
    pair = core.formation(
        shape="chain", satellites=2, eccentricity=eccentricity
    )  # fmt: skip
    pair, axis = replace(pair, spin_axis=np.array(axis)), np.array(axis)
    r, v = np.array([[3e3, 4e3, 500.0], [-2e3, -5e3, 100.0]]), np.array([[1.0, -2, 3], [0, 1, -1]])
    force, times = np.array([0.3, -0.5, 0.2]), np.linspace(0.0, 4000.0, 9)
    omega = pair.spin_rate_rad_s(2.0)

    def push(t, axes):
        along = {
            "orbit": axes @ force,
            "inertial": force,
            "spinning": axes @ about(axis, omega * t, force),
        }
        return np.stack([along[frame] / 100.0, np.zeros(3)])

    motion = Propagator(pair, 2.0, core.State(r, v), rtol=1e-12)
    motion.command([(0.0, Commands.of(pair, [("satellite_1", frame, force)], pair.tether_name))])
    found, _ = motion.sample(times)
    expected = free_bodies(r, v, push, times, eccentricity)
    size = np.abs(expected).max()
    unpushed = free_bodies(r, v, lambda t, axes: np.zeros((2, 3)), times, eccentricity)
    assert np.abs(expected - unpushed).max() > 0.1 * size
    assert np.abs(found - expected).max() < 1e-9 * size


# -- what is conserved -----------------------------------------------------------------------------


def test_momentum_changes_by_the_thrust_and_by_gravity():
    motion, edge, end = propagator(), 400.0, 1000.0
    motion.command([(edge, PUSH)])
    nodes, weights = np.polynomial.legendre.leggauss(60)
    times = 0.5 * (end - edge) * (nodes + 1) + edge
    r, v = motion.sample(np.concatenate([[edge], times, [end]]))
    at = np.concatenate([[edge], times, [end]])[:, None]
    force = np.broadcast_to(PUSH.force_n[:, None], (3, len(at), 3, 3))
    fixed = turned(OMEGA * at, r + [0.0, 7378e3, 0.0])
    momentum = 100.0 * turned(OMEGA * at, v + cross_z(OMEGA, r + [0.0, 7378e3, 0.0])).sum(axis=1)
    gravity = -MU * 100.0 * fixed / np.linalg.norm(fixed, axis=-1)[..., None] ** 3
    thrust = turned(OMEGA * at, force[0]) + force[1] + turned((1 + RATIO) * OMEGA * at, force[2])
    share = (0.5 * (end - edge) * weights[:, None] * (gravity + thrust).sum(axis=1)[1:-1]).sum(0)
    of_thrust = 0.5 * (end - edge) * weights @ thrust.sum(axis=1)[1:-1]
    assert np.linalg.norm(of_thrust) > 100.0
    np.testing.assert_allclose(momentum[-1] - momentum[0], share, atol=1e-5)


def energy(r, v):
    """Jacobi's integral [J], with the energy of the tethers."""
    q = r + [0.0, 7378e3, 0.0]
    kinetic = 0.5 * (v**2).sum(-1) - 0.5 * OMEGA**2 * (q[..., 0] ** 2 + q[..., 1] ** 2)
    gravity = -MU / np.linalg.norm(q, axis=-1)
    return 100.0 * (kinetic + gravity).sum(-1) + core.elastic_energy(RING, r, v)


def test_energy_changes_by_the_work_of_thrust_and_by_damping():
    force = Commands.of(
        RING,
        [("satellite_1", "orbit", (2.0, -1.0, 0.5)), ("satellite_2", "spinning", (0.0, 3.0, 0.0))],
    )
    start = core.disturbed(core.initial_state(RING, RATIO), 0.01, 2)
    motion, edge, end = propagator(start, rtol=1e-12), 300.0, 900.0
    motion.command([(edge, force)])
    pieces = np.linspace(edge, end, 2001)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    half = 0.5 * np.diff(pieces)
    times = (pieces[:-1, None] + half[:, None] * (nodes + 1)).ravel()
    r, v = motion.sample(np.sort(np.concatenate([[edge], times, [end]])))
    assert motion.switches == 0, "the tethers stay taut, so that the integrands are smooth"
    spinning = np.broadcast_to(force.force_n[2], (times.size, 3, 3))
    thrust = force.force_n[0] + turned(RATIO * OMEGA * times[:, None], spinning)
    power = (thrust * v[1:-1]).sum(axis=(1, 2))
    first, second = RING.tether_ends.T
    e, w = r[:, first] - r[:, second], v[:, first] - v[:, second]
    growth = (e * w).sum(-1) / np.linalg.norm(e, axis=-1)
    loss = 100.0 * (growth[1:-1] ** 2).sum(axis=-1)
    weights = (half[:, None] * weights).ravel()
    change = energy(r, v)[[0, -1]]
    work, lost = weights @ power, weights @ loss
    assert abs(work) > 1e3 and lost > 0.1
    assert change[1] - change[0] == pytest.approx(work - lost, abs=1e-3 * lost)


# -- times and bits --------------------------------------------------------------------------------


def plan():
    """Edges within steps, two of them within one; forces, a cut, and a force that ends."""
    cut = PUSH._replace(cut=np.array([False, True, False]))
    return [
        (100.5, PUSH),
        (103.25, PUSH._replace(force_n=-2.0 * PUSH.force_n)),
        (400.0, PUSH),
        (650.125, cut),
        (800.0, cut._replace(force_n=np.zeros_like(PUSH.force_n))),
    ]


TIMES = np.arange(0.0, 1200.0, 1.0)


@pytest.mark.parametrize("integrator", ["auto", "radau"])
def test_states_do_not_depend_on_how_a_run_is_sliced_or_when_it_is_told(integrator):
    whole = propagator(integrator=integrator)
    whole.command(plan())
    expected = np.stack(whole.sample(TIMES))
    sliced, found = propagator(integrator=integrator), []
    sliced.command(plan())
    for first in range(0, len(TIMES), 37):
        found.append(np.stack(sliced.sample(TIMES[first : first + 37])))
    np.testing.assert_array_equal(np.concatenate(found, axis=1), expected)
    # Each command is told when the last state before it is known.
    told, found, first, waiting = propagator(integrator=integrator), [], 0, plan()
    for edge, commands in waiting:
        last = int(np.searchsorted(TIMES, edge, side="right"))
        found.append(np.stack(told.sample(TIMES[first:last])))
        told.command([(edge, commands)])
        first = last
    found.append(np.stack(told.sample(TIMES[first:])))
    np.testing.assert_array_equal(np.concatenate(found, axis=1), expected)
    for name in IntegratorState._fields:
        if name not in ("progress", "x_v", "x_r"):
            np.testing.assert_array_equal(
                getattr(told.integrator_state, name), getattr(whole.integrator_state, name)
            )


def test_states_up_to_a_command_are_those_without_it():
    free, pushed = propagator(), propagator()
    pushed.command([(400.5, PUSH)])
    before = TIMES <= 400.5
    expected, found = free.sample(TIMES)[0], pushed.sample(TIMES)[0]
    np.testing.assert_array_equal(found[before], expected[before])
    after = np.linalg.norm(found - expected, axis=-1)[~before]
    assert (after > 0.0).all() and after[:5].max() < 0.1 and after[-1].max() > 100.0


def test_commands_that_change_nothing_change_no_bit():
    free, told = propagator(), propagator()
    told.command([(100.5, Commands.none(RING)), (300.0, Commands.none(RING))])
    np.testing.assert_array_equal(told.sample(TIMES), free.sample(TIMES))
    assert told.steps == free.steps


def test_a_motion_goes_on_after_a_force_as_one_that_starts_there():
    """What an edge does to the state itself is below what the integrator is asked for."""
    motion = propagator(rtol=1e-12)
    motion.command([(100.5, PUSH), (200.5, Commands.none(RING))])
    r, v = motion.sample(np.array([200.5, 260.5]))
    again = Propagator(RING, RATIO, core.State(r[0], v[0]), rtol=1e-12)
    expected, _ = again.sample(np.array([60.0]))
    assert np.abs(r[1] - expected[0]).max() < 1e-11 * 1e4


@pytest.mark.parametrize("law", ["kelvin_voigt", "tension_only"])
def test_a_tether_that_is_cut_pulls_no_longer_and_stays_so(law):
    system = replace(RING, tether_law=law)
    motion = Propagator(system, RATIO, START)
    motion.command([(50.0, Commands.of(system, cut=["tether_1"]))])
    r, v = motion.sample(TIMES)
    first, second = system.tether_ends[0]
    apart = np.linalg.norm(r[:, first] - r[:, second], axis=-1)
    assert apart[-1] > 1.5 * system.rest_length_m[0] and not motion.integrator_state.taut[0]
    # The other two still hold: nobody is further from satellite_3 than they allow.
    for k in (1, 2):
        i, j = system.tether_ends[k]
        assert np.linalg.norm(r[:, i] - r[:, j], axis=-1).max() < 1.01 * system.rest_length_m[k]


# -- refusals --------------------------------------------------------------------------------------


def test_wrong_commands_are_refused():
    motion = propagator()
    motion.sample(np.array([500.0]))
    begun = motion.integrator_state.progress["step_start"][0]
    for given, said in (
        ([(begun - 1.0, PUSH)], "must not lie before"),
        ([(math.nan, PUSH)], "finite and increase"),
        ([(900.0, PUSH), (900.0, PUSH)], "finite and increase"),
        ([(900.0, PUSH._replace(force_n=PUSH.force_n * math.nan))], "finite"),
        ([(900.0, PUSH._replace(force_n=PUSH.force_n[:2]))], r"shape \(3, 3, 3\)"),
    ):
        with pytest.raises(TssError, match=said):
            motion.command(given)
    assert motion.plan == []
    with pytest.raises(TssError, match="'taylor' bears no forces"):
        propagator(integrator="taylor").command([(1.0, PUSH)])
    cut = Commands.of(RING, cut=["tether_2"])
    taylor = propagator(integrator="taylor")
    taylor.command([(1.0, cut)])
    assert np.isfinite(taylor.sample(np.array([50.0]))[0]).all()
    for forces, cut, said in (
        ([("satellite_9", "orbit", (0, 0, 1))], (), "bead is 'satellite_9'; allowed: satellite_1"),
        (
            [("satellite_1", "body", (0, 0, 1))],
            (),
            "frame is 'body'; allowed: orbit, inertial, spinning",
        ),
        ([("satellite_1", "orbit", (0, 1))], (), "x, y, z"),
        ([], ("rope",), "tether is 'rope'; allowed: tether_1"),
    ):
        with pytest.raises(TssError, match=said):
            Commands.of(RING, forces, cut)
