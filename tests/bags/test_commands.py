"""What the commands make of a bag: text, figures, tables, and the same run once more."""

import csv
import dataclasses

import numpy as np
import pyarrow.parquet
import pytest
import ros_harness
from ros_harness import START_S
from tss_interfaces.msg import FloquetResult, Mode

from tss_ros.bags import commands
from tss_ros.bags.recording import Recording, read_bag
from tss_ros.core import Propagator, disturbed, initial_state, ring, tether_state
from tss_ros.ros.topics import read_topics

PNG = b"\x89PNG\r\n\x1a\n"
SCENARIO = """
spin_rate_ratio: -3.1
orbit_altitude_m: 700000.0
bodies:
  - {name: a, mass_kg: 100.0, position_m: [0.0, 5000.1, 0.0]}
  - {name: b, mass_kg: 50.0, position_m: [0.0, -5000.3, 0.0]}
tethers:
  - {between: [a, b], length_m: 10000.0, axial_stiffness_n: 50000.0, damping_n_s_per_m: 1450.0,
     bead_mass_kg: [1.0]}
"""


def record(folder, bag, *arguments, results=(), **parameters):
    """A run of the real nodes; `results` are published meanwhile as a stability node would."""
    with ros_harness.processes(folder) as start, ros_harness.client_node() as (node, spin_until):
        topic = read_topics()["stability_results"]
        if results:
            publisher = node.create_publisher(topic.message_class, topic.name, topic.qos)
            for result in results:
                publisher.publish(result)
        logger = start("logger_node", output=bag)
        if results:
            spin_until(publisher.get_subscription_count, START_S, "the recorder")
        simulator = start("sim_node", *arguments, **parameters)
        spin_until(lambda: not simulator.running, START_S, "the end of the simulation")
        assert simulator.wait(0) == 0, simulator.stderr
        assert logger.stop() == 0, logger.stderr
    return read_bag(folder / bag)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A folder with `bag`, a run of a scenario of one's own that is then gone, and its content."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "mine.yaml").write_text(SCENARIO)
    results = [
        FloquetResult(
            spin_rate_ratio=rate, max_modulus=modulus, verdict=verdict, tether_law="tension_only"
        )
        for rate, modulus, verdict in ((-2.0, 1.5, "unstable"), (-3.0, 1.0, "neutral"))
    ]
    results[0].deciding_family, results[0].deciding_modulus = "axis tilt", 1.5
    turns = np.linspace(0.0, 1.0, 9)
    shape = 1.5**turns[:, None] * np.array([0.0, 0.0, 1.0, 0.0, 0.0, -1.0])
    position = np.tile([0.0, 5e3, 0.0, 0.0, -5e3, 0.0], 9)
    results[0].mode = [
        Mode(
            multiplier_real=1.5,
            in_words="axis tilt",
            tether_ends=[0, 1],
            turns=turns.tolist(),
            position_m=position.tolist(),
            shape_real=shape.ravel().tolist(),
            shape_imag=np.zeros(54).tolist(),
        )
    ]
    recording = record(
        folder,
        "bag",
        results=results,
        scenario="mine.yaml",
        time_scale=0.0,
        turns=0.3,
        publish_period_s=1.7,
        disturbance_m=3.0,
        disturbance_seed=5,
        orbit_altitude_m=712345.67890123456,
        wait_for_recorder=True,
    )
    (folder / "mine.yaml").unlink()
    return folder, recording


def test_a_bag_carries_what_it_takes_to_simulate_the_same_again(run):
    folder, first = run
    assert any(version.startswith("numpy ") for version in first.versions)
    assert first.parameters["disturbance_seed"] == 5 and first.scenario_yaml == SCENARIO
    assert commands.export([str(folder / "bag"), "--parameters", str(folder / "again")]) == 0
    file = str(folder / "again" / "parameters.yaml")
    again = record(folder, "again_bag", "--params-file", file)
    assert len(first.step) > 100
    for name in ("step", "t_s", "position_m", "velocity_m_s", "deviation", "length_m"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
    for name in ("tension_n", "taut", "mass_kg", "damping_n_s_per_m", "reference_radius_m"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))


def test_a_shipped_scenario_is_named_not_copied(run, tmp_path):
    _, recording = run
    parameters = {**recording.parameters, "scenario": "three_star"}
    text = commands.read_text("three_star")
    for scenario_yaml, copied in ((text, False), (text + "orbit_altitude_m: 1.0\n", True)):
        named = dataclasses.replace(
            recording,
            scenario="three_star",
            parameters=parameters,
            scenario_yaml=scenario_yaml,
        )
        commands.write_parameters(named, tmp_path / str(copied))
        assert (tmp_path / str(copied) / "scenario.yaml").exists() == copied


def test_summary_tells_what_happened(run, capsys):
    folder, recording = run
    assert commands.summary([str(folder / "bag")]) == 0
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert "2 satellites, 3 beads in all, 2 tethers, 151 kg" in lines["scenario"]
    assert lines["disturbance"] == "3 m, seed 5"
    assert "0 missing in between; messages lost: 0" in lines["steps"]
    assert lines["stability"] == "-3 Omega: neutral, max |rho| 1.000000, tension_only"
    assert lines["tether"].startswith("law    kelvin_voigt, taut tethers push 0 % of the time")
    assert len(lines) < 20


def test_plot_draws_the_standard_figures(run, tmp_path, capsys):
    folder, _ = run
    assert commands.plot([str(folder / "bag"), "--output", str(tmp_path)]) == 0
    drawn = ("trajectories", "deviation", "tethers", "balance", "stability", "mode_-2")
    files = [f"{name}.png" for name in drawn] + ["mode_-2.gif"]
    assert capsys.readouterr().out.splitlines() == [str(tmp_path / name) for name in files]
    assert (tmp_path / "mode_-2.gif").read_bytes().startswith(b"GIF89a")
    for name in drawn:
        assert (tmp_path / f"{name}.png").read_bytes().startswith(PNG)


def test_tables_hold_every_number(run, tmp_path):
    folder, r = run
    bag = str(folder / "bag")
    assert commands.export([bag, "--csv", str(tmp_path)]) == 0
    assert commands.export([bag, "--parquet", str(tmp_path)]) == 0
    with (tmp_path / "beads.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    table = pyarrow.parquet.read_table(tmp_path / "beads.parquet").to_pydict()
    for place in ([float(row["y_m"]) for row in rows], table["y_m"]):
        np.testing.assert_array_equal(np.reshape(place, r.deviation.shape), r.position_m[..., 1])
    assert [row["bead"] for row in rows[:3]] == table["bead"][:3] == list(r.bead_name)
    tethers = pyarrow.parquet.read_table(tmp_path / "tethers.parquet").to_pydict()
    np.testing.assert_array_equal(np.reshape(tethers["tension_n"], r.taut.shape), r.tension_n)
    with (tmp_path / "stability.csv").open(newline="") as file:
        assert [row["verdict"] for row in csv.DictReader(file)] == ["unstable", "neutral"]


@pytest.mark.parametrize("command", ["summary", "plot"])
def test_what_is_no_bag_gets_one_line(command, tmp_path, capsys):
    assert getattr(commands, command)([str(tmp_path / "missing")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"{command}: ") and "missing" in line


def test_energy_changes_by_damping_only():
    """Against the motion itself, which knows nothing of energies."""
    system = ring(damping_n_s_per_m=0.0, beads_per_tether=1)
    start = disturbed(initial_state(system, -2.5), 20.0, 1)
    t_s = np.linspace(0.0, 2000.0, 50)
    position_m, velocity_m_s = Propagator(system, -2.5, start).sample(t_s)
    length_m, _, taut = tether_state(system, position_m, velocity_m_s)
    energy_j = energy(system, t_s, position_m, velocity_m_s, length_m, taut)
    swing_j = np.ptp(0.5 * (velocity_m_s**2).sum(axis=2) @ system.mass_kg)
    assert np.ptp(energy_j) < 1e-6 * swing_j


def energy(system, t_s, position_m, velocity_m_s, length_m, taut):
    """Energy of a motion as a recording of it gives it."""
    names = ("mass_kg", "rest_length_m", "axial_stiffness_n", "damping_n_s_per_m")
    names += ("orbit_altitude_m", "orbit_rate_rad_s", "tether_ends", "is_satellite")
    names += ("bead_name", "tether_name", "tether_law", "law_parameters")
    return Recording(
        **{name: getattr(system, name) for name in names},
        **dict.fromkeys(("scenario", "reference_radius_m", "disturbance_m", "disturbance_seed")),
        **dict.fromkeys(("publish_period_s", "deviation", "tension_n", "spin_rate_ratio", "step")),
        t_s=t_s,
        position_m=position_m,
        velocity_m_s=velocity_m_s,
        length_m=length_m,
        taut=taut,
        rests_m=np.tile(system.rest_length_m, (len(t_s), 1)),
        rest_rates_m_s=np.zeros_like(length_m),
    ).energy_j
