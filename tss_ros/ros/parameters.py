"""The nodes' parameters: one table for declaration, descriptors, checks and service overrides."""

import array
import math
import numbers
from dataclasses import dataclass, replace

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.parameter import parameter_value_to_python

from tss_ros.core import TssError
from tss_ros.scenarios import scenario

#: Largest system, in satellites and tether beads together, that a node builds.
MAX_BEADS = 1000
#: When a value that is set while the node runs applies, and how its description says so.
APPLIES = {
    "never": "Fixed when the node starts.",
    "reset": "A change applies with the next reset of the state.",
    "at once": "A change applies at once.",
}


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    Attributes
    ----------
    name : str
    type : type
        str, bool, int or float; an int is accepted where a float is meant.
    text : str
        What it is, with its unit.
    minimum, maximum : float, optional
        Allowed range, ends included.
    default : optional
        None leaves the value to the scenario.
    per_element : bool
        Accept a list with one value per element as well as one value for all.
    applies : str
        When a change applies, one of `APPLIES`.
    """

    name: str
    type: type
    text: str
    minimum: float = None
    maximum: float = None
    default: object = None
    per_element: bool = False
    applies: str = "never"

    @property
    def allowed_value(self):
        """What one value may be, in words."""
        kind = {str: "text", bool: "true or false", int: "a whole number", float: "a number"}[
            self.type
        ]
        return (
            kind
            if self.minimum is None
            else f"{kind} from {self.minimum:.12g} to {self.maximum:.12g}"
        )

    @property
    def allowed(self):
        """What is allowed, in words."""
        return self.allowed_value + (
            " for all, or a list with one for each" if self.per_element else ""
        )

    @property
    def descriptor(self):
        """ROS descriptor; with dynamic typing, so that `check` says what is wrong with a value."""
        unset = "" if self.default is not None else " Not set: the scenario's value."
        descriptor = ParameterDescriptor(
            name=self.name,
            description=f"{self.text} {APPLIES[self.applies]}{unset}",
            additional_constraints=self.allowed,
            read_only=self.applies == "never",
            dynamic_typing=True,
        )
        if self.minimum is not None and not self.per_element:
            if self.type is int:
                limits = IntegerRange(from_value=self.minimum, to_value=self.maximum)
                descriptor.integer_range = [limits]
            else:
                limits = FloatingPointRange(from_value=self.minimum, to_value=self.maximum)
                descriptor.floating_point_range = [limits]
        return descriptor

    def check(self, value):
        """Return `value` as this parameter's type, or a list of it.

        Raises
        ------
        TssError
            Naming the parameter, the value and what is allowed.
        """
        if not (self.per_element and isinstance(value, (list, array.array))):
            return self._check_one(self.name, value)
        if not 1 <= len(value) <= MAX_BEADS:
            raise TssError(f"{self.name} has {len(value)} elements; allowed: 1 to {MAX_BEADS}")
        return [self._check_one(f"{self.name}[{i}]", element) for i, element in enumerate(value)]

    def _check_one(self, name, value):
        if self.type in (int, float):
            base = numbers.Integral if self.type is int else numbers.Real
            fits = isinstance(value, base) and not isinstance(value, bool) and math.isfinite(value)
            fits = fits and (self.minimum is None or self.minimum <= value <= self.maximum)
        else:
            fits = isinstance(value, self.type)
        if not fits:
            shown = "nothing" if value is None else f"{value!r:.80}"
            allowed = self.allowed if name == self.name else self.allowed_value
            raise TssError(f"{name} is {shown}; allowed: {allowed}")
        return self.type(value)


SCENARIO = Parameter(
    "scenario", str, "Name of a shipped scenario or path of a scenario file.", default="three_star"
)

OVERRIDES = (
    Parameter("satellites", int, "Number of satellites.", 2, MAX_BEADS),
    Parameter(
        "satellite_mass_kg", float, "Mass of the satellites [kg].", 1e-3, 1e9, per_element=True
    ),
    Parameter(
        "tether_length_m",
        float,
        "Unstretched length of the tethers [m].",
        1e-2,
        1e7,
        per_element=True,
    ),
    Parameter("axial_stiffness_n", float, "EA of the tethers [N].", 1e-3, 1e12, per_element=True),
    Parameter("damping_n_s_per_m", float, "C of the tethers [N s/m].", 0.0, 1e9, per_element=True),
    Parameter(
        "beads_per_tether", int, "Number of beads on each tether.", 0, MAX_BEADS, per_element=True
    ),
    Parameter("bead_mass_kg", float, "Mass of the tether beads [kg].", 1e-6, 1e9, per_element=True),
    Parameter("orbit_altitude_m", float, "Height of the circular orbit [m].", 0.0, 1e9),
    Parameter(
        "spin_rate_ratio",
        float,
        "Spin rate over orbital rate in the orbit frame [-], not zero; negative: clockwise.",
        -1e4,
        1e4,
    ),
)

SIMULATOR = (
    *(replace(parameter, applies="reset") for parameter in (SCENARIO, *OVERRIDES)),
    Parameter(
        "publish_period_s",
        float,
        "Simulated time between steps [s].",
        1e-3,
        1e5,
        default=1.0,
        applies="reset",
    ),
    Parameter(
        "disturbance_m",
        float,
        "Norm over all beads of random offsets added to the initial positions [m].",
        0.0,
        1e5,
        default=0.0,
        applies="reset",
    ),
    Parameter(
        "disturbance_seed",
        int,
        "Seed of these offsets.",
        0,
        2**31 - 1,
        default=0,
        applies="reset",
    ),
    Parameter(
        "time_scale",
        float,
        "Simulated seconds per wall second; 0: as fast as a recorder can take it, losing nothing.",
        0.0,
        1e6,
        default=100.0,
        applies="at once",
    ),
    Parameter(
        "turns",
        float,
        "Spin turns after which the simulator ends; 0: endless.",
        0.0,
        1e6,
        default=0.0,
    ),
    Parameter(
        "wait_for_recorder",
        bool,
        "Publish nothing until a recorder is recording and receives every recorded topic.",
        default=False,
    ),
    Parameter("start_paused", bool, "Publish the initial state and pause there.", default=False),
    Parameter(
        "publish_clock",
        bool,
        "Publish /clock; of several simulators in one graph only one may.",
        default=True,
    ),
    Parameter(
        "publish_tf",
        bool,
        "Publish the frames of the orbit and of every bead on /tf; needs tf2_msgs.",
        default=False,
    ),
    Parameter(
        "frame_prefix",
        str,
        "Put before the name of every frame, to tell several simulators apart.",
        default="",
    ),
)

STABILITY = (
    Parameter("scheduler", str, "Dask cluster to sweep on; empty: this machine.", default=""),
)

LOGGER = (
    Parameter(
        "output",
        str,
        "Directory of the bag, to be made. Empty: bag_<date>_<time> where the node runs.",
        default="",
    ),
    Parameter(
        "split_size_mb",
        float,
        "Size of a file of the bag at which the next one is begun [MB]; 0: any size.",
        0.0,
        1e9,
        default=1000.0,
    ),
    Parameter(
        "split_duration_s",
        float,
        "Wall time after which the next file of the bag is begun [s]; 0: never.",
        0.0,
        1e9,
        default=3600.0,
    ),
    Parameter(
        "rerun", bool, "Show the motion in a Rerun viewer while it is recorded.", default=False
    ),
)

#: A parameters file may serve several nodes, so each knows the names of all, and ROS's own.
_KNOWN_NAMES = {p.name for p in (*SIMULATOR, *STABILITY, *LOGGER)} | {
    "use_sim_time",
    "start_type_description_service",
    "qos_overrides",
}


def read_parameters(node, *tables):
    """Declare the parameters of `tables` on `node` and return their checked values.

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
        node.declare_parameter(parameter.name, parameter.default, parameter.descriptor)
    return values


def check_changes(table, values, given):
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
            raise TssError(f"{own.name} is fixed when the node starts")
        if parameter.value is None and own.default is None:
            changed.pop(own.name, None)
        else:
            changed[own.name] = own.check(parameter.value)
    return changed


def read_overrides(messages):
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
    table = {parameter.name: parameter for parameter in OVERRIDES}
    values = {}
    for message in messages:
        if message.name not in table:
            raise TssError(f"override {message.name!r:.80} is unknown; allowed: {', '.join(table)}")
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


def build_system(scenario_name, overrides, max_beads=MAX_BEADS):
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
    tuple of System and float
        The system and its spin rate ratio.

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
    return system, overrides.get("spin_rate_ratio", loaded.spin_rate_ratio)
