"""Orbits of real satellites in scenario files: two-line elements, states, epochs."""

import math

import numpy as np
import pytest
import yaml

from tss_ros.core import ReferenceOrbit, TssError
from tss_ros.scenarios import orbits, scenario

#: The space station on 2008-09-20, the usual example of the format.
STATION = [
    "1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927",
    "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537",
]
CIRCLE = {
    "position_m": [0.0, 7378e3, 0.0],
    "velocity_m_s": [0.0, 0.0, math.sqrt(3.986e14 / 7378e3)],
}


@pytest.fixture
def load(tmp_path):
    def loaded(**content):
        file = tmp_path / "orbit.yaml"
        file.write_text(yaml.safe_dump({"spin_rate_ratio": -3.0, **content}))
        return scenario.load(file)

    return loaded


def test_two_line_elements_make_the_orbit_and_its_epoch(load):
    values = load(two_line_elements=STATION).parameters
    # Day 264.51782528 of a leap year.
    assert values["epoch"] == "2008-09-20T12:25:40.104192Z"
    # Osculating elements differ from the mean ones of the lines by what J2 does in an orbit.
    assert abs(values["inclination_deg"] - 51.6416) < 0.05
    assert abs(values["raan_deg"] - 247.4627) < 0.05
    assert abs(values["eccentricity"] - 0.0006703) < 1e-3
    latitude = values["argument_of_perigee_deg"] + values["true_anomaly_deg"]
    assert abs(latitude % 360.0 - (130.5360 + 325.0288) % 360.0) < 0.2
    assert load(two_line_elements=["ISS (ZARYA)", *STATION]).parameters == values


def test_the_orbit_of_two_lines_goes_through_the_place_that_their_theory_tells(load):
    """The theory itself says where the station is at the epoch."""
    sgp4 = pytest.importorskip("sgp4.api")
    satellite = sgp4.Satrec.twoline2rv(*STATION)
    _, place_km, velocity_km_s = satellite.sgp4(satellite.jdsatepoch, satellite.jdsatepochF)
    orbit = ReferenceOrbit(load(two_line_elements=STATION).build())
    q, v = (x[0] for x in orbit.inertial_state(np.zeros(1)))
    np.testing.assert_allclose(q, 1e3 * np.array(place_km), rtol=1e-11)
    np.testing.assert_allclose(v, 1e3 * np.array(velocity_km_s), rtol=1e-11)


def test_a_state_makes_the_orbit_through_it(load):
    values = load(orbit_state=CIRCLE).parameters
    assert abs(values["orbit_altitude_m"] - 1000e3) < 1e-2 and values["eccentricity"] == 0.0
    assert values["inclination_deg"] == pytest.approx(90.0)
    assert values["raan_deg"] == pytest.approx(90.0)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (
            {"two_line_elements": [STATION[0][:-1] + "3", STATION[1]]},
            "line 1 has checksum 3, not 7",
        ),
        ({"two_line_elements": STATION[::-1]}, "line 1 is '2 25544"),
        ({"two_line_elements": STATION[:1]}, "two_line_elements must be two lines"),
        ({"two_line_elements": 5}, "two_line_elements must be two lines"),
        ({"two_line_elements": STATION, "eccentricity": 0.1}, "two_line_elements and eccentricity"),
        ({"two_line_elements": STATION, "epoch": "2026-01-01"}, "two_line_elements and epoch"),
        ({"two_line_elements": STATION, "orbit_state": CIRCLE}, "both state the orbit"),
        ({"orbit_state": {"position_m": [7e6, 0, 0]}}, "orbit_state lacks velocity_m_s"),
        ({"orbit_state": {**CIRCLE, "speed": 3}}, "orbit_state has 'speed'"),
        (
            {"orbit_state": {**CIRCLE, "velocity_m_s": [0, 0, 11e3]}},
            "eccentricity below 1, got 1.2",
        ),
        ({"orbit_state": {**CIRCLE, "velocity_m_s": [0, 0, 6e3]}}, "perigee must lie above"),
        ({"orbit_state": {**CIRCLE, "velocity_m_s": "fast"}}, "velocity_m_s must be"),
        ({"epoch": "yesterday"}, "epoch is 'yesterday'; allowed: date and time as"),
        ({"eccentricity": 1.0}, "eccentricity must be at most 0.999, got 1"),
        ({"eccentricity": -0.1}, "eccentricity must be at least 0"),
        ({"orbit_altitude_m": -1.0}, "orbit_altitude_m must be at least 0"),
        ({"spin_axis": [0, 0, 0]}, "spin_axis must have a length above 0"),
        ({"spin_axis": [0, 1]}, "spin_axis must be three finite numbers"),
        ({"perturbations": ["j3"]}, "perturbations must be of j2, drag, solar_pressure, got 'j3'"),
        ({"perturbations": "j2"}, "perturbations must be a list of names"),
        ({"perturbations": ["j2"], "j2": 0.0}, "perturbations has 'j2', but j2 is 0"),
    ],
)
def test_what_is_no_orbit_is_refused_by_name(load, content, expected):
    with pytest.raises(TssError, match=expected):
        load(**content)


@pytest.mark.parametrize(
    ("given", "moment"),
    [
        ("2026-11-27T12:00:00Z", "2026-11-27T12:00:00Z"),
        ("2026-11-27T12:00:00.250+02:00", "2026-11-27T10:00:00.25Z"),
        ("2026-11-27", "2026-11-27T00:00:00Z"),
        ("2026-11-27T10:20:30", "2026-11-27T10:20:30Z"),
    ],
)
def test_an_epoch_is_kept_as_universal_time(load, given, moment):
    loaded = load(epoch=given)
    assert loaded.parameters["epoch"] == moment
    assert scenario.epoch_of(loaded.name, {}) == moment
    assert scenario.epoch_of(loaded.name, {"epoch": "2000-01-01"}) == "2000-01-01T00:00:00Z"
    assert orbits.epoch_text(orbits.read_epoch(moment)) == moment


def test_perturbations_that_are_named_act_with_typical_strengths(load):
    law = load(perturbations=["j2", "drag"]).build().law_parameters
    assert (law["j2"], law["drag_m2_per_kg"]) == (1.08263e-3, 0.01)
    law = load(perturbations=["drag"], drag_m2_per_kg=0.02).build().law_parameters
    assert (law["j2"], law["drag_m2_per_kg"]) == (0.0, 0.02)
    law = load().build({"perturbations": ["solar_pressure"]}).law_parameters
    assert law["solar_pressure_m2_per_kg"] > 0.0
