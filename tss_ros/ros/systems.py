"""Systems from parameters: a scenario's, and what a node or a request puts in their place."""

from collections.abc import Iterable, Sequence

import rcl_interfaces.msg
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python

from tss_ros.core import State, System, TssError
from tss_ros.core.errors import allowed_words
from tss_ros.ros import parameters
from tss_ros.scenarios import scenario
from tss_ros.scenarios.parameters import MAX_BEADS


def split_options(options: dict[str, object]) -> tuple[str, dict[str, object]]:
    """Scenario and overrides among the checked values of a node's parameters."""
    names = (parameter.name for parameter in parameters.OVERRIDES)
    return options["scenario"], {name: options[name] for name in names if name in options}


def without_scenario_values(options: dict[str, object]) -> dict[str, object]:
    """The same options but for those that have the scenario's value, and so follow the scenario."""
    own = scenario.load(options["scenario"]).values
    return {name: v for name, v in options.items() if name not in own or v != own[name]}


def declare_scenario_values(
    node: Node, table: Sequence[parameters.Parameter], options: dict[str, object]
) -> list[Parameter]:
    """Make a node's parameters those of its scenario.

    What the scenario has and the node has not is declared; what the scenario has not is taken away.

    Parameters
    ----------
    node : rclpy.node.Node
    table : sequence of Parameter
        The node's parameters.
    options : dict
        Checked values by name, those that follow the scenario left out.

    Returns
    -------
    list of rclpy.parameter.Parameter
        All parameters of the table with the values that they should have.
    """
    values = scenario.load(options["scenario"]).values | options
    for parameter in table:
        declared = node.has_parameter(parameter.name)
        if parameter.name in values and not declared:
            parameters.declare(node, parameter, values[parameter.name])
        elif declared and parameter.name not in values:
            node.undeclare_parameter(parameter.name)
    return [Parameter(p.name, value=values[p.name]) for p in table if p.name in values]


def read_overrides(messages: Iterable[rcl_interfaces.msg.Parameter]) -> dict[str, object]:
    """Check overrides that came with a request.

    Parameters
    ----------
    messages : sequence of rcl_interfaces.msg.Parameter

    Returns
    -------
    dict
        Values by name.

    Raises
    ------
    TssError
        If a name is unknown or given twice, or if a value does not fit.
    """
    table = {parameter.name: parameter for parameter in parameters.OVERRIDES}
    values = {}
    for message in messages:
        if message.name not in table:
            raise TssError(
                f"override {message.name!r:.80} is unknown{allowed_words(message.name, table)}"
            )
        if message.name in values:
            raise TssError(f"override {message.name!r} is given twice; allowed: once each")
        try:
            value = parameter_value_to_python(message.value)
        except RuntimeError:
            raise TssError(
                f"override {message.name!r} has type {message.value.type}; allowed: 1 to 9"
            ) from None
        values[message.name] = table[message.name].check(value)
    return values


def build_system(
    scenario_name: str, overrides: dict[str, object], max_beads: int = MAX_BEADS
) -> tuple[System, float, State | None]:
    """Make the system of a scenario with some of its parameters overridden.

    Parameters
    ----------
    scenario_name : str
        Shipped name or path.
    overrides : dict
        Checked values by parameter name.
    max_beads : int
        Largest number of satellites and tether beads together.

    Returns
    -------
    tuple of System, float and State or None
        The system, its spin rate ratio, and the start that the scenario's own velocities make.

    Raises
    ------
    TssError
        If the scenario cannot be read or the system is too large or not physical.
    """
    loaded = scenario.load(scenario_name)
    system = loaded.build(overrides)
    if system.n > max_beads:
        raise TssError(
            f"satellites and beads_per_tether make {system.n} satellites and beads; "
            f"allowed: at most {max_beads}"
        )
    ratio = overrides.get("spin_rate_ratio", loaded.spin_rate_ratio)
    return system, ratio, loaded.start(system)
