"""What the parameters accept, and what they say about the rest."""

import math

import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter

from tss_ros.core import LAW_PARAMETERS, TETHER_LAWS, TssError
from tss_ros.ros import parameters, systems

SIMULATOR = (parameters.SIMULATOR,)


@pytest.fixture
def given():
    """A function that reads the simulator's parameters as if these had been given to it."""
    context = rclpy.Context()
    rclpy.init(context=context)
    nodes = []

    def read(**values):
        given = [Parameter(name, value=value) for name, value in values.items()]
        nodes.append(Node("sim_node", context=context, parameter_overrides=given))
        return parameters.read_parameters(nodes[-1], *SIMULATOR)

    yield read
    for node in nodes:
        node.destroy_node()
    context.try_shutdown()


def test_what_is_not_given_is_left_to_the_scenario(given):
    assert given() == {
        "scenario": "three_star",
        "time_scale": 100.0,
        "publish_period_s": 1.0,
        "turns": 0.0,
        "disturbance_m": 0.0,
        "command_timeout_s": 0.0,
        "command_limit_n": 0.0,
        "reel_rate_limit_m_s": 1.0,
        "reel_shortest_m": 1.0,
        "reel_longest_m": 0.0,
        "disturbance_seed": 0,
        "wait_for_recorder": False,
        "recorder_patience_s": 60.0,
        "start_paused": False,
        "service_folder": "service_files",
        "publish_clock": True,
        "publish_tf": False,
        "odometry": "",
        "sensor_period_s": 0.0,
        "sensor_seed": 0,
        "position_noise_m": 0.0,
        "position_bias_m": 0.0,
        "velocity_noise_m_s": 0.0,
        "velocity_bias_m_s": 0.0,
        "range_noise_m": 0.0,
        "range_bias_m": 0.0,
        "tension_noise_n": 0.0,
        "tension_bias_n": 0.0,
        "frame_prefix": "",
    }


def test_integers_do_for_numbers_and_one_value_for_all(given):
    values = given(satellite_mass_kg=50, tether_length_m=[1, 2, 3], beads_per_tether=1, turns=8)
    assert values["satellite_mass_kg"] == 50.0 and isinstance(values["satellite_mass_kg"], float)
    assert values["tether_length_m"] == [1.0, 2.0, 3.0]
    assert all(isinstance(value, float) for value in values["tether_length_m"])
    assert (values["beads_per_tether"], values["turns"]) == (1, 8.0)


def test_numbers_that_ros_tools_take_for_text_are_numbers(given):
    """`ros2 param load` and `ros2 param set` make text of 3e-15."""
    assert given(air_density_kg_m3="3e-15", j2="1.5E-3")["air_density_kg_m3"] == 3e-15
    for text in ("1", "3e", "e5", "1e400", "3e-15 "):
        with pytest.raises(TssError, match="air_density_kg_m3 is "):
            given(air_density_kg_m3=text)


@pytest.mark.parametrize("edge", ["minimum", "maximum"])
def test_ranges_include_their_ends(given, edge):
    tables = [parameter for table in SIMULATOR for parameter in table]
    ends = {p.name: p.type(getattr(p, edge)) for p in tables if p.minimum is not None}
    assert {name: value for name, value in given(**ends).items() if name in ends} == ends


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("satellites", 1_000_000, "satellites is 1000000; allowed: a whole number from 2 to 1000"),
        ("satellites", 3.5, "satellites is 3.5; allowed: a whole number"),
        ("satellites", True, "satellites is True; allowed: a whole number"),
        ("satellites", [3], "satellites is [3]; allowed: a whole number"),
        ("satellites", "three", "satellites is 'three'; allowed: a whole number"),
        ("satellite_mass_kg", -5.0, "satellite_mass_kg is -5.0; allowed: a number from 0.001"),
        ("satellite_mass_kg", [1.0, 0.0], "satellite_mass_kg[1] is 0.0; allowed: a number from"),
        ("satellite_mass_kg", ["a"], "satellite_mass_kg[0] is 'a'; allowed: a number"),
        ("satellite_mass_kg", [1.0] * 1001, "satellite_mass_kg has 1001 elements; allowed: 1 to"),
        ("tether_length_m", math.nan, "tether_length_m is nan; allowed: a number from 0.01"),
        ("tether_length_m", math.inf, "tether_length_m is inf; allowed: a number from 0.01"),
        ("time_scale", -1, "time_scale is -1; allowed: a number from 0 to 1000000"),
        ("publish_period_s", 0.0, "publish_period_s is 0.0; allowed: a number from 0.001"),
        ("disturbance_seed", 1.5, "disturbance_seed is 1.5; allowed: a whole number from 0"),
        ("wait_for_recorder", 3, "wait_for_recorder is 3; allowed: true or false"),
        ("scenario", 5, "scenario is 5; allowed: text"),
        (
            "tether_law",
            "tension",
            "tether_law is 'tension'; allowed: one of kelvin_voigt, tension_only, stiffening"
            "; did you mean 'tension_only'?",
        ),
        ("tether_law", 1.5, "tether_law is 1.5; allowed: one of kelvin_voigt"),
        ("j2", -0.1, "j2 is -0.1; allowed: a number from 0 to"),
        (
            "satelites",
            4,
            "'satelites' is not a parameter of sim_node; it has: scenario, satellites",
        ),
    ],
)
def test_what_does_not_fit_is_named_with_its_value_and_range(given, name, value, expected):
    with pytest.raises(TssError) as caught:
        given(**{name: value})
    assert str(caught.value).startswith(expected)


def test_every_parameter_of_a_law_is_one_of_the_nodes(given):
    values = {p.name: p.maximum for p in LAW_PARAMETERS} | {"tether_law": "stiffening"}
    read = given(**values)
    assert {name: read[name] for name in values} == values
    for table in (parameters.SIMULATOR, parameters.OVERRIDES):
        declared = {p.name: p.descriptor for p in table}
        for parameter in LAW_PARAMETERS:
            (limits,) = declared[parameter.name].floating_point_range
            assert (limits.from_value, limits.to_value) == (parameter.minimum, parameter.maximum)
            assert parameter.meaning in declared[parameter.name].description
        constraints = declared["tether_law"].additional_constraints
        assert constraints == f"one of {', '.join(law.name for law in TETHER_LAWS)}"


def test_parameters_of_the_other_nodes_may_stand_in_the_same_file(given):
    assert "output" not in given(output="bag", rerun=True)


def test_systems_too_large_are_not_built():
    systems.build_system("three_star", {"satellites": 10, "beads_per_tether": 9}, 100)
    with pytest.raises(TssError, match="make 110 satellites and beads; allowed: at most 100"):
        systems.build_system("three_star", {"satellites": 10, "beads_per_tether": 10}, 100)
    with pytest.raises(TssError, match="make 106 satellites and beads; allowed: at most 100"):
        systems.build_system("three_star", {"beads_per_tether": [1, 2, 100]}, 100)
