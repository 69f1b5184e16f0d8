"""Reels that follow tension: against fixed tethers, sampled commands, and mirror symmetry."""

import numpy as np
import pytest

from tss_ros import core
from tss_ros.core import Commands, Propagator, ReelControl, State, TssError, compute_reel_control
from tss_ros.core.model.reels import reels
from tss_ros.core.stability import reel_control

STAR = core.ring(damping_n_s_per_m=0.0)
PENTAGON = core.ring(satellites=5, damping_n_s_per_m=0.0)


def test_a_reel_that_hardly_moves_is_a_fixed_tether():
    fixed = core.compute_floquet(STAR, -2.9)
    found = compute_reel_control(STAR, -2.9, ReelControl(1e10, 1e3))
    for rho in fixed.multiplier[np.abs(fixed.multiplier - 1.0) > 1e-2]:
        assert np.min(np.abs(found.multiplier - rho)) < 1e-4
    # What a reel adds: its rest length comes back with k / c.
    rest = np.exp(-1e3 / 1e10 * found.period_s)
    assert np.count_nonzero(np.abs(found.multiplier - rest) < 1e-4) >= 3


def test_reels_damp_what_stretches_and_nothing_out_of_the_plane():
    """Out of the plane tethers are not stretched to first order: mirror images pull alike."""
    found = compute_reel_control(PENTAGON, -4.5, ReelControl(1e3, 1.0))
    assert found.closure_residual < 1e-8
    assert found.largest("shape", True) == pytest.approx(0.999284, abs=1e-5)
    assert found.largest("shape", False) == pytest.approx(1.0, abs=1e-6)
    assert found.verdict == "neutral"


def test_reels_make_an_undamped_star_asymptotically_stable():
    assert core.compute_floquet(STAR, -2.9).verdict == "neutral"
    found = compute_reel_control(STAR, -2.9, ReelControl(1000.0, 1.0))
    assert found.verdict == "asymptotically stable"
    assert found.deciding_modulus == pytest.approx(0.113645, abs=1e-5)
    assert 0.1 < np.max(found.stroke_m) < 1.0


def test_commands_at_short_intervals_come_to_the_loop():
    control = ReelControl(1000.0, 1.0)
    loop = reel_control._Loop(STAR, -2.9, control, None, None)
    end_s, names = 60.0, [reel.name for reel in reels(STAR)]
    x = loop.close()[0]
    x[9] += 2e-6
    times = np.linspace(0.0, end_s, 61)
    expected, begun = loop.turn(x, 0.0, times=times)[2][:, -1], loop.unit[18:] * x[18:]
    missed = []
    for count in (120, 480):
        state, edges = loop.state(x), np.linspace(0.0, end_s, count + 1)
        plan = [(0.0, Commands.of(STAR, reel={n: (0.0, a) for n, a in zip(names, begun)}))]
        motion = Propagator(STAR, -2.9, State(state.position_m, state.velocity_m_s), plan=plan)
        rest = 1.0 * begun
        for begin, end in zip(edges, edges[1:]):
            position_m, velocity_m_s = motion.sample(np.array([begin]))
            rests = rest[None], np.zeros((1, 3))
            tension = core.tether_state(STAR, position_m, velocity_m_s, rests)[1][0]
            rate = (tension - loop.law[:, 2] - (rest - 10e3)) / 1000.0
            reel = {name: (begin, a, b) for name, a, b in zip(names, rest, rate)}
            motion.command([(begin, Commands.of(STAR, reel=reel))])
            rest = rest + rate * (end - begin)
        position_m, _ = motion.sample(np.array([end_s]))
        missed.append(np.max(np.abs(position_m[0].ravel() - expected[9:18])))
    assert missed[1] < 0.35 * missed[0]
    assert missed[1] < 2e-3


@pytest.mark.parametrize(
    "change, words",
    [
        ({"spin_rate_ratio": 0.0}, "spin_rate_ratio is 0"),
        ({"tethers": ["tether_9"]}, "allowed: tether_1, tether_2, tether_3"),
    ],
)
def test_what_cannot_be_asked_is_refused(change, words):
    options = {"spin_rate_ratio": -2.9, "tethers": None} | change
    with pytest.raises(TssError, match=words):
        compute_reel_control(
            STAR, options["spin_rate_ratio"], ReelControl(1e3, 1.0), tethers=options["tethers"]
        )
    with pytest.raises(TssError, match="damping_n_s_per_m must be greater than 0"):
        ReelControl(0.0, 1.0)
