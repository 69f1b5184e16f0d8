"""The nodes' parameters: one table for declaration, descriptors, checks and service overrides."""

import dataclasses
import re
from collections.abc import Iterable, Sequence

import rclpy.parameter
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from tss_ros.core import TssError
from tss_ros.scenarios import parameters as scenario_parameters

#: When a value that is set while the node runs applies, and how its description says so.
APPLIES = {
    "never": "Fixed when the node starts.",
    "reset": "A change applies with the next reset of the state.",
    "at once": "A change applies at once.",
}
#: Titles of the columns that `Parameter.row` fills.
HEADING = ("parameter", "type", "unit", "default", "changes apply", "allowed", "meaning")
#: Types of values, as ROS calls them.
_ROS_TYPES = {str: "string", bool: "bool", int: "integer", float: "double"}
_EXPONENT = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+")


@dataclasses.dataclass(frozen=True)
class Parameter(scenario_parameters.Parameter):
    """One parameter of a node; a default of None leaves the value to the scenario.

    Attributes
    ----------
    applies : str
        When a change applies, one of `APPLIES`.
    """

    applies: str = "never"

    def check(self, value: object) -> object:
        """As of a scenario; a number like 3e-15, which ROS's tools take for text, fits too."""
        if self.elements and value is None:
            value = []  # what ROS makes of an empty list in a file
        if self.type is float and isinstance(value, str) and _EXPONENT.fullmatch(value):
            value = float(value)
        return super().check(value)

    @property
    def descriptor(self) -> ParameterDescriptor:
        """ROS descriptor; only what may be a number or a list of them is typed dynamically."""
        unset = "" if self.default is not None else " Not given: the scenario's value."
        descriptor = ParameterDescriptor(
            name=self.name,
            description=f"{self.text} {APPLIES[self.applies]}{unset}",
            additional_constraints=self.allowed,
            read_only=self.applies == "never",
            dynamic_typing=bool(self.per_element or self.elements),
        )
        if self.minimum is not None and not self.per_element:
            if self.type is int:
                limits = IntegerRange(from_value=self.minimum, to_value=self.maximum)
                descriptor.integer_range = [limits]
            else:
                limits = FloatingPointRange(from_value=self.minimum, to_value=self.maximum)
                descriptor.floating_point_range = [limits]
        return descriptor

    @property
    def row(self) -> tuple[str, ...]:
        """What a table says of it: texts for the columns of `HEADING`."""
        name, _, unit, default, allowed, meaning = super().row
        kind = _ROS_TYPES[self.type]
        if self.per_element:
            kind = f"{kind}, or {kind}[]: one per {self.per_element}"
        elif self.elements:
            kind = f"{kind}[]: {self.elements}"
        if self.default is None:
            default = "the scenario's"
        return name, kind, unit, default, self.applies, allowed, meaning


def _of_scenario(applies):
    """The scenario's parameters as those of a node, which needs none of them given."""
    return tuple(
        Parameter(**(vars(parameter) | {"default": None, "applies": applies}))
        for parameter in scenario_parameters.SCENARIO
    )


SCENARIO = Parameter(
    "scenario", str, "Name of a shipped scenario or path of a scenario file", default="three_star"
)

#: What a request may override.
OVERRIDES = _of_scenario("never")

SIMULATOR = scenario_parameters.distinct((
    dataclasses.replace(SCENARIO, applies="reset"),
    *_of_scenario("reset"),
    *(
        Parameter(**vars(p), applies="reset")
        for p in (scenario_parameters.PUBLISH_PERIOD, *scenario_parameters.DISTURBANCE)
    ),
    Parameter(
        "time_scale", float, "Simulated seconds per wall second", "-",
        minimum=0.0, maximum=1e6, default=100.0, applies="at once",
        note="0: as fast as a recorder can take it, losing nothing",
    ),
    Parameter(**(vars(scenario_parameters.TURNS) | {"note": "0: endless"})),
    Parameter(
        "wait_for_recorder", bool,
        "Publish nothing until a recorder is recording and receives every recorded topic",
        default=False,
    ),
    Parameter(
        "recorder_patience_s", float,
        "How long a recorder that gets no further may hold the simulator", "s",
        minimum=0.0, maximum=1e6, default=60.0, note="0: it waits for no recorder",
    ),
    Parameter("start_paused", bool, "Publish the initial state and pause there", default=False),
    Parameter(
        "service_folder", str, "Folder of the snapshots and scenarios that services may name",
        default="service_files", note="/: any file of this user",
    ),
    Parameter(
        "publish_clock", bool, "Publish /clock", default=True,
        note="of several simulators in one graph only one may",
    ),
    Parameter(
        "publish_tf", bool, "Publish the frames of the orbit and of every bead on /tf",
        default=False, note="needs tf2_msgs",
    ),
    Parameter(
        "odometry", str,
        "Publish odometry of every satellite relative to the satellite of this name, or to"
        " centre_of_mass", default="", applies="reset", note="empty: none",
    ),
    Parameter(
        "command_timeout_s", float,
        "Simulated time after which a force or a reel's rate ends that is not commanded anew", "s",
        minimum=0.0, maximum=1e9, default=0.0, applies="at once", note="0: never",
    ),
    Parameter(
        "command_limit_n", float, "Largest force commanded; larger ones are scaled back", "N",
        minimum=0.0, maximum=1e6, default=0.0, applies="at once", note="0: no limit",
    ),
    *(Parameter(**vars(p), applies="at once") for p in scenario_parameters.REEL_LIMITS),
    Parameter(
        "sensor_period_s", float,
        "Simulated time between measurements; each is of the first step at or after its time", "s",
        minimum=0.0, maximum=1e9, default=0.0, applies="reset", note="0: there are no sensors",
    ),
    Parameter(
        "sensor_seed", int, "Seed of the sensors' noise and constant errors",
        minimum=0, maximum=2**31 - 1, default=0, applies="reset",
    ),
    *(
        Parameter(
            f"{quantity}_{kind}_{unit}", float, f"Standard deviation of {meaning} of the {what}",
            symbol, minimum=0.0, maximum=1e9, default=0.0, applies="reset",
        )
        for quantity, unit, symbol, what in (
            ("position", "m", "m", "measured relative position, in each axis"),
            ("velocity", "m_s", "m/s", "measured relative velocity, in each axis"),
            ("range", "m", "m", "measured range along a tether"),
            ("tension", "n", "N", "measured tension"),
        )
        for kind, meaning in (
            ("noise", "the noise"),
            ("bias", "the constant error"),
        )
    ),
    Parameter(
        "frame_prefix", str,
        "Put before the name of every frame, to tell several simulators apart", default="",
    ),
))  # fmt: skip

STABILITY = (
    Parameter("scheduler", str, "Dask cluster to sweep on", default="", note="empty: this machine"),
)

LOGGER = (
    Parameter(
        "output", str, "Directory of the bag, to be made", default="",
        note="empty: bag_<date>_<time> where the node runs",
    ),
    Parameter(
        "split_size_mb", float, "Size of a file of the bag at which the next one is begun", "MB",
        minimum=0.0, maximum=1e9, default=1000.0, note="0: any size",
    ),
    Parameter(
        "split_duration_s", float, "Wall time after which the next file of the bag is begun", "s",
        minimum=0.0, maximum=1e9, default=3600.0, note="0: never",
    ),
    Parameter(
        "in_bulk", bool, "Take many steps in one message, which is quicker", default=False,
        note="the simulator then sends the topic step_blocks",
    ),
    Parameter(
        "rerun", bool, "Show the motion in a Rerun viewer while it is recorded", default=False
    ),
    Parameter(
        "earth", bool, "Show the Earth in that viewer, where it is and in its size", default=False
    ),
)  # fmt: skip

#: A parameters file may serve several nodes, so each knows the names of all, and ROS's own.
_KNOWN_NAMES = {p.name for p in (*SIMULATOR, *STABILITY, *LOGGER)} | {
    "use_sim_time",
    "start_type_description_service",
    "qos_overrides",
}


def read_parameters(node: Node, *tables: Sequence[Parameter]) -> dict[str, object]:
    """Declare the parameters of `tables` on `node` and return their checked values.

    What is left to a scenario is not declared.

    Parameters
    ----------
    node : rclpy.node.Node
    *tables : sequence of Parameter

    Returns
    -------
    dict
        Values by name; those left to the scenario are missing.

    Raises
    ------
    TssError
        If a value does not fit, or if a parameter was given that none of the nodes has.
    """
    # rclpy has no public way to list what was given for parameters that are not declared (yet).
    given = node._parameter_overrides
    for name in given:
        if name.split(".")[0] not in _KNOWN_NAMES:
            known = ", ".join(p.name for table in tables for p in table)
            raise TssError(f"{name!r} is not a parameter of {node.get_name()}; it has: {known}")
    values = {}
    for parameter in (p for table in tables for p in table):
        if parameter.name in given:
            values[parameter.name] = parameter.check(given[parameter.name].value)
        elif parameter.default is not None:
            values[parameter.name] = parameter.default
        if parameter.name in values:
            declare(node, parameter, values[parameter.name])
    return values


def declare(node: Node, parameter: Parameter, value: object) -> None:
    """Declare a parameter with a checked value, which may be a whole number where a double is."""
    node.declare_parameter(parameter.name, value, parameter.descriptor, ignore_override=True)


def check_changes(
    table: Sequence[Parameter],
    values: dict[str, object],
    given: Iterable[rclpy.parameter.Parameter],
) -> dict[str, object]:
    """Check what is to be set while a node runs.

    Parameters
    ----------
    table : sequence of Parameter
    values : dict
        Checked values by name, as they are.
    given : sequence of rclpy.parameter.Parameter
        What is to be set; a value of None takes a parameter back to the scenario's value.

    Returns
    -------
    dict
        Checked values by name, as they would be.

    Raises
    ------
    TssError
        Naming the parameter, the value and what is allowed.
    """
    known = {parameter.name: parameter for parameter in table}
    changed = dict(values)
    for parameter in (p for p in given if p.name in known):
        own = known[parameter.name]
        if own.applies == "never":
            if parameter.value is None or own.check(parameter.value) != values[own.name]:
                raise TssError(f"{own.name} is fixed when the node starts")
        elif parameter.value is None and own.default is None:
            changed.pop(own.name, None)
        else:
            changed[own.name] = own.check(parameter.value)
    return changed
