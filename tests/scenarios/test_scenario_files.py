"""Scenario files as people write them: slips are named, doubtful values are warned of."""

import subprocess
import sys
import warnings

import numpy as np
import pytest
import yaml

from tss_ros.core import FORMATIONS, Propagator, TssError, initial_state
from tss_ros.scenarios import scenario
from tss_ros.scenarios.doubts import ImplausibleValue

PAIR = """
spin_rate_ratio: -3.0
orbit_altitude_m: 400000.0
bodies:
  - {name: a, mass_kg: 100.0, position_m: [0.0, 500.0, 0.0]}
  - {name: b, mass_kg: 50.0, position_m: [0.0, -500.0, 0.0]}
tethers:
  - {between: [a, b], length_m: 1000.0, axial_stiffness_n: 50000.0, damping_n_s_per_m: 500.0}
"""
RING = "formation: ring\nspin_rate_ratio: -3.0\n"
MOVING = PAIR.replace("0.0]}", "0.0], velocity_m_s: [1.5, 0.0, 0.4]}")


def load(folder, text):
    path = folder / "my.yaml"
    path.write_text(text)
    return scenario.load(path)


@pytest.mark.parametrize(
    ("text", "named", "meant"),
    [
        (PAIR.replace("a, mass_kg", "a, mass"), "bodies[0] has 'mass'", "mass_kg"),
        (PAIR.replace("length_m", "lenght_m"), "tethers[0] has 'lenght_m'", "length_m"),
        (PAIR.replace("damping_n_s_per_m", "damp"), "tethers[0] has 'damp'", "damping_n_s_per_m"),
        (PAIR.replace("name: a", "name: hub").replace("[a,", "[hib,"), "named 'hib'", "hub"),
        (RING + "mass: 100.0\n", "'mass' is not known", "satellite_mass_kg"),
        (RING + "Altitude: 4.0e5\n", "'Altitude' is not known", "orbit_altitude_m"),
        (RING + "tether_lenght_m: 1e3\n", "'tether_lenght_m' is not known", "tether_length_m"),
    ],
)
def test_slips_are_named_with_what_was_meant(tmp_path, text, named, meant):
    with pytest.raises(TssError) as error:
        load(tmp_path, text)
    assert named in str(error.value)
    assert f"; did you mean {meant!r}?" in str(error.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (PAIR.replace("name: b", "name: a"), "duplicate name 'a' of bodies[0] and bodies[1]"),
        (RING + "satellites: 3\nsatellites: 4\n", "duplicate key 'satellites' in line 4"),
        (PAIR.replace("mass_kg", "mass_kg: 1.0, mass_kg"), "duplicate key 'mass_kg' in line 5"),
    ],
)
def test_duplicates_are_called_so(tmp_path, text, expected):
    with pytest.raises(TssError) as error:
        load(tmp_path, text)
    assert expected in str(error.value)


def test_tethers_of_the_same_name_are_duplicates(tmp_path):
    tether = yaml.safe_load(PAIR)["tethers"][0] | {"name": "t"}
    text = yaml.safe_dump(yaml.safe_load(PAIR) | {"tethers": [tether, tether]})
    with pytest.raises(TssError, match=r"duplicate name 't' of tethers\[0\] and tethers\[1\]"):
        load(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (PAIR.replace("500.0, 0.0]}", "5000.0, 0.0]}").replace("1000.0", "10.0"),
         "tether 'tether_1' is 10 m long, and 'a' and 'b' are 10000 m apart"),
        (PAIR.replace("1000.0", "1e6"), "is 1e.06 m long, and 'a' and 'b' are 1000 m apart"),
        (PAIR.replace("400000.0", "1000.0"), "orbit_altitude_m is 1000, .*120000 and more"),
        (RING + "orbit_altitude_m: 400\n", "orbit_altitude_m is 400, "),
        (RING + "reel_stiffness_n_per_m: 0.5\n",
         "reel_stiffness_n_per_m is 0.5, which .* unless reel_damping_n_s_per_m is not 0"),
        (RING + "sun_longitude_deg: 9\n", "_deg is 9, .* unless solar_pressure_m2_per_kg is not 0"),
        (RING + "thrust_limit_n: 1e0\n", "rotation_damping_n_s_per_m or shape_keeping_n_per_m is"),
        (MOVING.replace("1.5", "7350.0", 1), "velocity_m_s of 'a' is 7350 m/s; .* orbit frame"),
    ],
)  # fmt: skip
def test_what_is_probably_not_meant_is_warned_of(tmp_path, text, expected):
    with pytest.warns(ImplausibleValue, match=expected):
        load(tmp_path, text)


def test_what_is_replaced_is_warned_of_too():
    ring = scenario.load("three_star")
    with pytest.warns(ImplausibleValue, match="scenario 'three_star': bead_mass_kg has no effect"):
        ring.build({"bead_mass_kg": 3.0})
    with pytest.warns(ImplausibleValue, match="'three_star': reel_mass_kg is 3, which has no "):
        system = ring.build({"reel_mass_kg": 3.0})
    assert "reel_mass_kg" not in system._facts()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        system = ring.build({"reel_mass_kg": 3.0, "reel_damping_n_s_per_m": 100.0})
    assert system._facts()["reel_mass_kg"] == "3"


@pytest.mark.parametrize("value", ["'100'", "true"])
def test_neither_texts_nor_truth_values_are_numbers(tmp_path, value):
    for text in (RING + f"tether_length_m: {value}\n", PAIR.replace("1000.0", value)):
        with pytest.raises(TssError, match=f"length_m must be a number, got {value.title()}"):
            load(tmp_path, text)


def test_a_number_needs_neither_point_nor_sign(tmp_path):
    system = load(tmp_path, RING + "tether_length_m: [1e3, 1E+3, 1.e3]\nj2: 2e-3\n").build()
    assert set(system.rest_length_m) == {1000.0} and system.law_parameters["j2"] == 0.002


def test_what_is_meant_is_not_warned_of(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in scenario.shipped():
            scenario.load(name)
        for text in (PAIR, MOVING, RING):
            load(tmp_path, text)


SIMULATED = "--ros-args -p scenario:=low.yaml -p turns:=0.1 -p time_scale:=0.0"


@pytest.mark.parametrize(
    ("name", "words"), [("sweep", "low.yaml --rates -3 -3 1"), ("sim", SIMULATED)]
)
def test_a_command_warns_in_one_line(tmp_path, name, words):
    (tmp_path / "low.yaml").write_text(RING + "orbit_altitude_m: 1000\n")
    command = [sys.executable, "-m", "tss_ros", name, *words.split()]
    shown = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert shown.returncode == 0, shown.stderr
    (line,) = [line for line in shown.stderr.splitlines() if "warning" in line]
    assert "warning: scenario 'low.yaml': orbit_altitude_m is 1000" in line


def test_a_scenario_of_every_shape_is_shipped_and_moves():
    shapes = {}
    for name in scenario.shipped():
        of = scenario.load(name)
        shapes.setdefault(of.formation, of)
    assert shapes.keys() == {*FORMATIONS, "graph"}
    for shape, of in shapes.items():
        system = of.build()
        start = initial_state(system, of.spin_rate_ratio)
        turn_s = system.period_s(of.spin_rate_ratio)
        position, _ = Propagator(system, of.spin_rate_ratio, start).sample([0.0, turn_s])
        before, after = np.linalg.norm(position, axis=2)
        assert np.allclose(after, before, atol=0.05 * before.max()), shape
