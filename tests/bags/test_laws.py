"""Which tether law a recording is of, and how often taut tethers pushed; older bags included."""

import csv
import dataclasses
import json
import math

import numpy as np
import old_bag
import pyarrow.parquet
import pytest
from rerun.chunk import RrdReader
from small_bag import Bag

from tss_ros.bags import commands
from tss_ros.bags.recording import Recording, read_bag
from tss_ros.core import (
    LAW_PARAMETERS,
    TETHER_LAWS,
    Propagator,
    TssError,
    disturbed,
    initial_state,
    ring,
    tether_state,
)
from tss_ros.core.stability.law_words import law_in_words, laws_in_words
from tss_ros.messages.steps import States, StepMessages, system_description
from tss_ros.review import review

OPTIONS = {
    "scenario": "three_star",
    "publish_period_s": 10.0,
    "disturbance_m": 10.0,
    "disturbance_seed": 1,
}


def record(directory, system, turns=1.0):
    """A recording of a disturbed motion at -2.2 Omega, through a bag."""
    steady = initial_state(system, -2.2)
    start = disturbed(steady, 10.0, 1)
    turn_s = 2.0 * math.pi / abs(2.2 * system.orbit_rate_rad_s)
    t_s = np.arange(0.0, turns * turn_s, 10.0)
    position_m, velocity_m_s = Propagator(system, -2.2, start).sample(t_s)
    length_m, tension_n, taut = tether_state(system, position_m, velocity_m_s)
    bag = Bag(directory)
    radius_m = np.linalg.norm(steady.position_m, axis=1)
    described = system_description(system, -2.2, radius_m, OPTIONS)
    bag.write("system_description", described, 0)
    first = position_m[:1], velocity_m_s[:1]
    states = States.of(system, radius_m, np.zeros(1, int), *first)
    for name in ("bead_states", "tether_states"):
        row = StepMessages(system, np.ones(system.m)).rows(name, 0, states)[0]
        bag.write(name, row.tobytes(), 0)
    bag.writer.close()
    recording = read_bag(directory)
    return dataclasses.replace(
        recording,
        step=np.arange(len(t_s)),
        t_s=t_s,
        position_m=position_m,
        velocity_m_s=velocity_m_s,
        deviation=np.zeros((len(t_s), system.n)),
        length_m=length_m,
        tension_n=tension_n,
        taut=taut,
        rests_m=np.tile(system.rest_length_m, (len(t_s), 1)),
        rest_rates_m_s=np.zeros_like(length_m),
    )


def test_a_recording_has_the_law_and_every_parameter_of_laws(tmp_path):
    values = {p.name: p.maximum for p in LAW_PARAMETERS}
    gentle = {"drag_m2_per_kg": 1e-12, "rotation_damping_n_s_per_m": 1e-3,
              "shape_keeping_n_per_m": 1e-6, "eccentricity": 0.01,
              "solar_pressure_m2_per_kg": 1e-3, "reel_damping_n_s_per_m": 0.0}  # fmt: skip
    system = ring(tether_law="stiffening", **(values | gentle))
    recording = record(tmp_path / "bag", system, 0.01)
    assert recording.tether_law == "stiffening"
    assert recording.law_parameters == system.law_parameters
    built = recording.system
    for field in dataclasses.fields(system):
        if field.name != "layout_m":
            np.testing.assert_array_equal(getattr(built, field.name), getattr(system, field.name))
    assert built.orbit_rate_rad_s == recording.orbit_rate_rad_s


def test_the_share_of_pushing_is_that_of_the_samples_with_a_taut_tether(tmp_path):
    recording = record(tmp_path / "bag", ring(), 0.01)
    taut = np.array([[True, True, False], [True, False, False]])
    tension_n = np.array([[1.0, -1.0, 0.0], [-3.0, 0.0, 0.0]])
    counted = dataclasses.replace(recording, tension_n=tension_n, taut=taut)
    assert counted.pushing_share == pytest.approx(2 / 3)


@pytest.mark.parametrize("law", [law.name for law in TETHER_LAWS])
def test_the_summary_names_the_law_and_the_pushing_it_may_have(tmp_path, law):
    recording = record(tmp_path / "bag", ring(tether_law=law), 1.0)
    (line,) = (x for x in commands.describe(recording).splitlines() if x.startswith("tether law"))
    if law == "kelvin_voigt":
        pushed = np.sum(recording.tension_n < 0.0) / np.sum(recording.taut)
        assert 0.1 < pushed < 0.35
        words = f"{law}, taut tethers push {100 * pushed:.3g} % of the time"
        assert line.split(maxsplit=2)[2] == words
    else:
        assert line.split(maxsplit=2)[2] == law and recording.pushing_share == 0.0


def test_the_summary_names_the_laws_that_act_besides(tmp_path):
    system = ring(j2=1.08263e-3)
    text = commands.describe(record(tmp_path / "a", system, 0.01))
    assert "law           j2: j2 0.00108263\n" in text
    assert "law           " not in commands.describe(record(tmp_path / "b", ring(), 0.01))


@pytest.mark.parametrize("law", [law.name for law in TETHER_LAWS])
def test_the_energy_is_that_of_the_law(tmp_path, law):
    """Without damping nothing is lost, whatever the law."""
    more = {"stiffening": 500.0} if law == "stiffening" else {}
    system = ring(damping_n_s_per_m=0.0, tether_law=law, **more)
    recording = record(tmp_path / "bag", system, 0.5)
    swing_j = np.ptp(0.5 * (recording.velocity_m_s**2).sum(axis=2) @ system.mass_kg)
    assert np.ptp(recording.energy_j) < 1e-6 * swing_j


def test_tables_say_of_which_law_the_run_is(tmp_path):
    system = ring(tether_law="stiffening", stiffening=3.0)
    recording = record(tmp_path / "bag", system, 0.01)
    (row,) = commands.tables(recording)["run"].to_pylist()
    assert (row["tether_law"], row["stiffening"], row["pushing_share"]) == ("stiffening", 3.0, 0.0)
    assert row.keys() >= {p.name for p in LAW_PARAMETERS} and row["scenario"] == "three_star"


def test_a_run_is_simulated_again_with_its_law_whatever_the_default(tmp_path):
    recording = record(tmp_path / "bag", ring(tether_law="tension_only", j2=1e-3), 0.01)
    text = "spin_rate_ratio: -2"
    recording = dataclasses.replace(recording, parameters=OPTIONS, scenario_yaml=text)
    commands.write_parameters(recording, tmp_path)
    written = json.loads((tmp_path / "parameters.yaml").read_text())["/**"]["ros__parameters"]
    assert (written["tether_law"], written["j2"]) == ("tension_only", 1e-3)
    assert written["disturbance_m"] == 10.0
    assert written["scenario"] == str(tmp_path / "scenario.yaml")


def test_a_law_of_a_newer_version_is_named(tmp_path):
    recording = record(tmp_path / "bag", ring(), 0.01)
    with pytest.raises(TssError, match="tether_law must be one of .*'memory'"):
        dataclasses.replace(recording, tether_law="memory").energy_j  # noqa: B018


# --- bags made before


@pytest.fixture
def old(tmp_path):
    """The folder of a bag made before bags named the law, and what it holds."""
    bag = old_bag.make(tmp_path / "old", 5)
    return bag.writer.directory, read_bag(bag.writer.directory)


def test_a_bag_made_before_is_of_the_papers_law(old):
    _, recording = old
    assert recording.tether_law == "kelvin_voigt" and recording.law_parameters == {}
    assert set(recording.system.law_parameters.values()) == {p.default for p in LAW_PARAMETERS}
    assert recording.damping_n_s_per_m.tolist() == [30.0]
    (result,) = recording.stability
    assert result.tether_law == "kelvin_voigt" and math.isnan(result.pushing_share)
    assert (result.verdict, result.switches, result.confirmation[0].switches) == ("neutral", 3, 7)
    assert isinstance(recording, Recording) and np.isfinite(recording.energy_j).all()
    assert (recording.rests_m == 10.0).all() and not recording.rest_rates_m_s.any()


def test_commands_read_a_bag_made_before(old, tmp_path, capsys):
    folder, _ = old
    assert commands.summary([str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("tether law    kelvin_voigt") for line in lines)
    assert "stability     -2 Omega: neutral, max |rho| 1.250000, kelvin_voigt" in lines
    for option in ("--csv", "--parquet"):
        assert commands.export([str(folder), option, str(tmp_path)]) == 0
    with (tmp_path / "stability.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["tether_law"] == "kelvin_voigt"
    (row,) = pyarrow.parquet.read_table(tmp_path / "run.parquet").to_pylist()
    assert row["tether_law"] == "kelvin_voigt"
    assert commands.plot([str(folder), "--output", str(tmp_path)]) == 0
    assert review.main([str(folder), "--save", str(tmp_path / "old.rrd")]) == 0
    chunks = [chunk.to_record_batch() for chunk in RrdReader(tmp_path / "old.rrd").stream()]
    text = "".join(str(c.to_pydict()) for c in chunks if "TextDocument:text" in c.schema.names)
    assert "| neutral | kelvin_voigt |" in text


# --- in words


@pytest.mark.parametrize(
    ("law", "share", "words"),
    [
        ("kelvin_voigt", 0.1308, "kelvin_voigt, taut tethers push 13.1 % of the time"),
        ("kelvin_voigt", 0.0, "kelvin_voigt, taut tethers push 0 % of the time"),
        ("kelvin_voigt", 1.0, "kelvin_voigt, taut tethers push 100 % of the time"),
        ("kelvin_voigt", math.nan, "kelvin_voigt"),
        (
            "kelvin_voigt",
            [0.22, math.nan, 0.0],
            "kelvin_voigt, taut tethers push 0 to 22 % of the time",
        ),
        ("kelvin_voigt", [], "kelvin_voigt"),
        ("tension_only", 0.0, "tension_only"),
    ],
)
def test_a_law_in_words(law, share, words):
    assert law_in_words(law, share) == words


def test_several_laws_in_words():
    motions = [("kelvin_voigt", 0.1), ("tension_only", 0.0), ("kelvin_voigt", 0.2)]
    words = "kelvin_voigt, taut tethers push 10 to 20 % of the time; tension_only"
    assert laws_in_words(motions) == words and laws_in_words([]) == ""
