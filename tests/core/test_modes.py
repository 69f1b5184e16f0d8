"""Labels, frequencies, wave numbers and resonances against closed forms of rings and chains.

Frequencies are in units of the orbital rate: out-of-plane waves of a ring of n equal masses have
omega_k^2 = 1 + lambda_k kappa^2, lambda_k = sin^2(pi k / n) / sin^2(pi / n),
kappa^2 = w^2 + 2 w + 3/2.
"""

import math
from collections import Counter

import numpy as np
import pytest
from scipy.optimize import brentq

from tss_ros.core import (
    FAMILIES,
    TssError,
    compute_floquet,
    compute_modes,
    find_critical_rates,
    formation,
    initial_state,
    name_resonance,
    ring,
)
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.mean_model import mean_modes

#: Stiff tethers in linear gravity, as the closed forms have them.
IDEAL = {
    "damping_n_s_per_m": 0.0, "linear_gravity": True, "bilateral": True, "axial_stiffness_n": 5e6,
}  # fmt: skip


def kappa2(w):
    return w * w + 2 * w + 1.5


def wave(w, stiffness):
    """Frequency in orbital rates of an out-of-plane mode under mean tension."""
    return math.sqrt(1 + stiffness * kappa2(w))


def ring_stiffness(k, n):
    return (math.sin(math.pi * k / n) / math.sin(math.pi / n)) ** 2


def modes_at(system, w):
    result = compute_floquet(system, w, certify=False)
    return result, compute_modes(system, result)


@pytest.mark.parametrize("n", [3, 4, 5, 6, 7])
def test_out_of_plane_waves_of_a_ring_under_mean_tension(n):
    w = -4.5
    system = ring(satellites=n, **IDEAL)
    result = compute_floquet(system, w, certify=False)
    integrator = Integrator(system, result.spin_rate_rad_s, 1e-9, 1e4)
    mean = mean_modes(integrator, result.state)
    above = np.sum(np.abs(mean.vectors[2::3]) ** 2, axis=0) > 0.5
    found = Counter(
        (int(k), round(f * abs(w), 2))
        for k, f in zip(mean.wave_number[above], mean.frequency[above]) if f > 0.0
    )  # fmt: skip
    expected = Counter()
    for k in range(n):
        k = min(k, n - k)
        expected[k, round(wave(w, ring_stiffness(k, n)), 2)] += 1
    assert found == expected


@pytest.mark.parametrize("w", [-4.5, -6.0])
def test_multipliers_tell_the_frequency_of_their_mode(w):
    """The gravity gradient changes them by its share of the tension, 3 / (2 kappa^2)."""
    for n in (5, 6):
        _, modes = modes_at(ring(satellites=n, **IDEAL), w)
        for mode in modes:
            if mode.direction == "out of plane":
                mean = wave(w, ring_stiffness(mode.wave_number, n)) / abs(w)
                assert mode.frequency == pytest.approx(mean, abs=1.5 / kappa2(w))
                rho = np.exp(2j * math.pi * mode.frequency)
                distance = min(abs(mode.multiplier - rho), abs(mode.multiplier - rho.conjugate()))
                assert distance < 1e-6


@pytest.mark.parametrize(
    "system, counts",
    [
        (ring(), (6, 2, 4, 6, 0)),
        (ring(satellites=5), (6, 2, 4, 18, 0)),
        (formation("chain", 2), (6, 2, 2, 2, 0)),
        (formation("chain", 3), (6, 2, 2, 8, 0)),
        (formation("hub_and_spoke", 3), (6, 2, 4, 12, 0)),
        (ring(satellites=3, beads_per_tether=1), (6, 2, 4, 24, 0)),
    ],
    ids=["3-star", "pentagon", "pair", "chain of 3", "hub and spoke", "6 beads"],
)
def test_families_have_as_many_multipliers_as_motions(system, counts):
    result, modes = modes_at(system, -5.0)
    assert tuple(Counter(result.family)[name] for name in FAMILIES) == counts
    for mode in modes:
        if mode.family == "axis tilt":
            assert mode.direction == "out of plane"
        if mode.family == "spin":
            assert mode.direction == "in plane" and mode.frequency < 1e-2


@pytest.mark.parametrize("w", [-4.5, -5.0, 4.0])
def test_bending_of_a_chain_of_three_is_not_its_tilt_and_never_decays(w):
    """omega^2 = 1 + 3 kappa^2: the middle bead against both ends, out of the plane."""
    result, modes = modes_at(formation("chain", 3), w)
    (bending, *_) = [m for m in modes if m.family == "shape" and m.direction == "out of plane"]
    assert bending.frequency == pytest.approx(wave(w, 3.0) / abs(w), rel=0.03)
    height = bending.shape[:, 2].real
    np.testing.assert_allclose(height / height[0], [1.0, -2.0, 1.0], atol=1e-2)
    assert abs(bending.multiplier) == pytest.approx(1.0, abs=1e-6)
    assert result.verdict != "asymptotically stable"


@pytest.mark.parametrize("w", [-2.5, -3.0])
def test_overdamped_stretch_of_the_ring_is_shape_not_spin(w):
    """It relaxes at the rate EA / (C L), to which its three modes come."""
    damping = 1e7
    result = compute_floquet(ring(damping_n_s_per_m=damping), w, certify=False)
    slow = math.exp(-5e4 / (1e4 * damping) * result.period_s)
    assert result.verdict in ("asymptotically stable", "neutral")
    shape = [abs(m) for m, f in zip(result.multiplier, result.family) if f == "shape"]
    np.testing.assert_allclose(shape[:3], slow, rtol=1e-5)
    assert max(shape[3:]) < 1e-10
    assert (result.deciding_family, result.deciding_modulus) == ("shape", shape[0])


@pytest.mark.parametrize(
    "system, waves, rate",
    [
        (ring(satellites=5), (1, 2), -4.2031),
        (ring(satellites=6), (1, 3), -2.8148),
        (formation("hub_and_spoke", 3), (1, 0), -2.8148),
    ],
    ids=["pentagon", "hexagon", "hub's umbrella"],
)
def test_combination_resonances_of_the_tilt_are_named_alike(system, waves, rate):
    (found,) = find_critical_rates(system, rate - 0.03, rate + 0.03, spacing=0.03)
    assert found.spin_rate_ratio == pytest.approx(rate, abs=3e-3)
    assert found.cause == "axis tilt"
    first, second = waves
    assert f"axis tilt (k = {first}, " in found.resonance
    assert f"out-of-plane shape (k = {second}, " in found.resonance
    assert found.resonance.endswith("frequencies add up to twice the spin")


@pytest.mark.long
def test_tilts_resonate_with_each_other_in_the_middle_of_their_band():
    """omega_1 = |w| at w = -5/4: there the tilt grows the most in time."""
    assert brentq(lambda w: wave(w, 1.0) + w, -3.0, -1.0) == pytest.approx(-1.25)
    for w in (-1.9, -1.25, -0.6):
        result = compute_floquet(ring(**IDEAL), w, certify=False)
        words = name_resonance(ring(**IDEAL), result)
        assert words == "axis tilt (k = 1, 1.000 a turn): twice its frequency is twice the spin"


def test_bending_of_a_chain_in_its_plane_resonates_at_minus_three():
    """omega^2 = 2 kappa^2 under mean tension, which is w^2 at w = -3.

    The straight chain is another family there: the own one turns round at -4.271.
    """
    system = formation("chain", 3)
    result = compute_floquet(system, -3.0, state=initial_state(system, -3.0), certify=False)
    modes = compute_modes(system, result)
    assert result.verdict == "unstable" and result.deciding_family == "shape"
    assert modes[result.deciding].frequency == pytest.approx(1.0, abs=1e-6)
    assert name_resonance(system, result) == (
        "in-plane shape (1.000 a turn): twice its frequency is twice the spin"
    )
    assert compute_floquet(system, -5.0, certify=False).verdict == "neutral"


def test_verdicts_show_the_number_that_decided():
    unstable = compute_floquet(ring(damping_n_s_per_m=3000.0), -1.9, certify=False)
    assert unstable.verdict == "unstable"
    assert unstable.decided_by == f"axis tilt {unstable.max_modulus:.6f}"
    assert unstable.deciding_modulus > 1.5
    for system, w in ((ring(), -2.1356), (ring(), -2.5), (ring(satellites=5), -4.5)):
        result = compute_floquet(system, w, certify=False)
        if result.verdict == "unstable":
            assert result.deciding_modulus > 1.001
        elif result.verdict == "asymptotically stable":
            assert result.deciding_family == "shape" and result.deciding_modulus < 1.0
        else:
            assert result.deciding_modulus == pytest.approx(1.0, abs=1e-4)
        assert abs(result.multiplier[result.deciding]) == result.deciding_modulus
    lost = compute_floquet(ring(), -1.5, certify=False)
    assert (lost.deciding, lost.deciding_family) == (-1, "")
    assert lost.decided_by == ""
    assert name_resonance(ring(), lost) == ""


def test_modes_of_another_system_are_refused():
    result = compute_floquet(ring(), -2.5, certify=False)
    with pytest.raises(TssError, match="vectors of 3 beads and reels that yield, the system has 4"):
        compute_modes(ring(satellites=4), result)
