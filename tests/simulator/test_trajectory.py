"""A motion that begins anew in the middle of an orbit goes on where the orbit is by then."""

import numpy as np
import pytest

from tss_ros.core import Propagator, State, initial_state, ring
from tss_ros.simulator.trajectory import begun_at


@pytest.mark.parametrize(
    "orbit",
    [
        {"eccentricity": 0.1, "true_anomaly_deg": 40.0},
        {"inclination_deg": 50.0, "raan_deg": 20.0, "perturbations": ["j2"]},
        {"eccentricity": 0.3, "inclination_deg": 98.0, "perturbations": ["j2"]},
        {"perturbations": ["solar_pressure"], "inclination_deg": 30.0},
        {},
    ],
)
def test_a_motion_cut_in_two_is_the_same(orbit):
    system, cut_s, more_s = ring(**orbit), 2000.0, 2500.0
    whole = Propagator(system, -3.0, initial_state(system, -3.0))
    (position, after), (velocity, also) = whole.sample([cut_s, cut_s + more_s])
    later = begun_at(system, cut_s)
    ratio = -3.0 * system.orbit_rate_rad_s / later.orbit_rate_rad_s
    (r,), (v,) = Propagator(later, ratio, State(position, velocity)).sample([more_s])
    np.testing.assert_allclose(r, after, atol=1e-5)
    np.testing.assert_allclose(v, also, atol=1e-8)
    if not orbit:
        assert later is system
