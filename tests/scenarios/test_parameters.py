"""The one list of a scenario's parameters agrees with all that takes them."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from tss_interfaces.msg import SystemDescription

from tss_ros.core import LAW_PARAMETERS, TETHER_LAWS, System, TssError, formation
from tss_ros.scenarios import parameters, reels, scenario
from tss_ros.scenarios.parameters import FORMATION, GRAPH, HEADING, SCENARIO, names, read_assignment
from tss_ros.sweeps.command import main as sweep

#: Of `formation`, but not for scenarios: the shape, and switches for closed-form checks.
OTHERS = {"shape", "linear_gravity", "bilateral", "law_parameters"}
#: Parameters that one tether law uses: the others refuse them.
OF_LAW = {p.name: law.name for law in TETHER_LAWS for p in law.parameters}
#: What scenarios have that spell out their bodies.
BODIES = ("bodies", "tethers")
#: What the description of a run says of beads and segments, where it has another name.
IN_MESSAGE = {"satellite_mass_kg": "mass_kg", "tether_length_m": "rest_length_m"}


def test_it_has_the_parameters_and_defaults_of_a_formation():
    signature = inspect.signature(formation).parameters
    expected = {name: p.default for name, p in signature.items() if name not in OTHERS}
    expected |= {p.name: p.default for p in LAW_PARAMETERS}
    lists = {p.name: list(expected[p.name]) for p in FORMATION if p.elements}
    assert {p.name: p.default for p in FORMATION} == expected | lists
    assert names(FORMATION) == tuple(expected)


def with_law(parameter, value):
    """Arguments that give a parameter a value, and the tether law that uses it."""
    law = {"tether_law": OF_LAW[parameter.name]} if parameter.name in OF_LAW else {}
    return {**law, parameter.name: value}


@pytest.mark.parametrize("parameter", FORMATION, ids=lambda p: p.name)
def test_the_core_builds_what_it_allows(parameter):
    ends = (parameter.minimum, parameter.maximum) if not parameter.choices else parameter.choices
    if parameter.name == "spin_axis":
        allowed = ([1e-3, 0, 0], [0, 0, -1e9], (1.0, 2.0, 3.0))
    else:
        allowed = [[end] for end in ends] if parameter.elements else map(parameter.type, ends)
    for value in allowed:
        system = formation("chain", **with_law(parameter, value))
        assert system.n >= 2
        if parameter.name in system.law_parameters:
            assert system.law_parameters[parameter.name] == value


def test_every_parameter_of_a_law_is_one_of_scenarios_and_of_graphs():
    for law_parameter in LAW_PARAMETERS:
        (parameter,) = (p for p in SCENARIO if p.name == law_parameter.name)
        assert parameter in GRAPH and parameter in parameters.VARIED
        for name in ("meaning", "unit", "minimum", "maximum", "default", "note"):
            assert getattr(parameter, name) == getattr(law_parameter, name)
    (chosen,) = (p for p in SCENARIO if p.name == "tether_law")
    assert chosen.choices == tuple(law.name for law in TETHER_LAWS)
    assert all(f"{law.name}: {law.meaning}" in chosen.text for law in TETHER_LAWS)


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        ("tension-only", "'tension-only'; allowed: one of kelvin_voigt, tension_only, stiffening"),
        ("kelvin", "'kelvin'"),
        (3, "3; allowed: one of kelvin_voigt"),
        (None, "nothing; allowed: one of kelvin_voigt"),
    ],
)
def test_a_text_that_is_not_among_its_choices_is_refused_with_the_nearest(value, shown):
    (chosen,) = (p for p in SCENARIO if p.name == "tether_law")
    with pytest.raises(TssError) as caught:
        chosen.check(value)
    assert str(caught.value).startswith(f"tether_law is {shown}")
    near = {"tension-only": "tension_only", "kelvin": "kelvin_voigt"}.get(value)
    assert str(caught.value).endswith(f"; did you mean {near!r}?") == (near is not None)
    assert chosen.check("tension_only") == "tension_only"


@pytest.mark.parametrize("parameter", FORMATION, ids=lambda p: p.name)
def test_a_list_is_allowed_where_the_core_takes_one(parameter):
    # Three satellites on a line, two tethers of two segments and one bead each.
    elements = {"satellite": 3, "tether": 2, "tether or segment": 4, "tether or bead": 2, "": 1}
    given = {"satellites": 3, "beads_per_tether": 1}
    if parameter.elements:
        formation("chain", **{**given, parameter.name: parameter.default})
        with pytest.raises(ValueError, match=parameter.name):
            formation("chain", **{**given, parameter.name: [1.0]})
        return
    value = [parameter.default] * elements[parameter.per_element]
    if parameter.per_element:
        formation("chain", **{**given, parameter.name: value})
    else:
        with pytest.raises(ValueError, match=parameter.name):
            formation("chain", **{**given, parameter.name: value})


@pytest.mark.parametrize("parameter", SCENARIO, ids=lambda p: p.name)
def test_messages_give_the_same_quantity_in_the_same_unit(parameter):
    name = IN_MESSAGE.get(parameter.name, parameter.name)
    fields = SystemDescription.get_fields_and_field_types()
    if name in {p.name for p in LAW_PARAMETERS}:
        # Those have their names and values in lists of their own.
        return
    if name in ("tether_law", "epoch"):
        assert fields[name] == "string"
        return
    if name == "perturbations":
        # Those that act are told by their own parameters.
        return
    if name not in fields:
        # How many there are follows from the lists of names.
        assert parameter.type is int or parameter.name == "bead_mass_kg"
        return
    folder = Path(get_package_share_directory("tss_interfaces")) / "msg"
    definition = (folder / "SystemDescription.msg").read_text()
    (unit,) = re.findall(rf"^float64(?:\[3?\])? {name} +# \[([^]]+)\]", definition, re.MULTILINE)
    assert unit == parameter.unit
    several = "double[3]" if parameter.elements else "sequence<double>"
    assert fields[name] == (several if parameter.elements or parameter.per_element else "double")
    assert name == "spin_rate_ratio" or name in System.__dataclass_fields__


def test_shipped_scenarios_have_no_other_parameters():
    folder = Path(scenario.__file__).parent
    for path in folder.glob("*.yaml"):
        content = yaml.safe_load(path.read_text())
        about = {"description", "formation", "failures", *reels.KEYS}
        assert content.keys() <= {*about, *BODIES, *names(SCENARIO)}, path


def test_a_scenario_of_bodies_and_tethers_has_only_those_of_orbit_and_spin(tmp_path):
    file = tmp_path / "two.yaml"
    tether = "{between: [a, b], length_m: 10.0, axial_stiffness_n: 1.0, damping_n_s_per_m: 0.0}"
    file.write_text(
        "bodies: [{name: a, mass_kg: 1.0, position_m: [0, 5, 0]},"
        f" {{name: b, mass_kg: 1.0, position_m: [0, -5, 0]}}]\ntethers: [{tether}]\n"
        "spin_rate_ratio: -2\n"
    )
    loaded = scenario.load(file)
    every = ("orbit_altitude_m", "tether_law", "spin_axis", "perturbations")
    laws = (p.name for p in LAW_PARAMETERS)
    assert names(GRAPH) == (*every, *laws, "spin_rate_ratio", "epoch")
    assert loaded.build().orbit_altitude_m == 1e6
    assert loaded.build({"orbit_altitude_m": 400e3}).orbit_altitude_m == 400e3
    assert loaded.build({"tether_law": "tension_only"}).tether_law == "tension_only"
    assert loaded.build({"j2": 1e-3}).law_parameters["j2"] == 1e-3
    file.write_text(file.read_text() + "tether_law: stiffening\nstiffening: 2.0\n")
    built = scenario.load(file).build()
    assert (built.tether_law, built.law_parameters["stiffening"]) == ("stiffening", 2.0)
    for name in set(names(SCENARIO)) - set(names(GRAPH)):
        with pytest.raises(ValueError, match=f"^{name} is not a parameter of scenario"):
            loaded.build({name: 1})


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("tether_law: tension_onyl", "tether_law must be one of .*'tension_only'"),
        ("tether_law: [tension_only]", "tether_law must be one of"),
        ("formation: hub_and_spok", "formation must be .*; did you mean 'hub_and_spoke'?"),
        ("j2: much", "j2 must be a number, got 'much'"),
        ("j2: -1.0", "j2 must be at least"),
        ("stiffening: 2.0", "stiffening is 2, which only tether_law stiffening uses"),
        ("tether_low: tension_only", "'tether_low' is not known.*did you mean 'tether_law'"),
    ],
)
def test_a_wrong_law_in_a_file_is_named(tmp_path, line, expected):
    file = tmp_path / "ring.yaml"
    file.write_text(f"spin_rate_ratio: -2\n{line}\n")
    with pytest.raises(TssError, match=expected):
        scenario.load(file)


def test_the_help_of_a_sweep_names_what_it_varies(capsys):
    with pytest.raises(SystemExit):
        sweep(["--help"])
    shown = capsys.readouterr().out.split("parameter to vary:")[1].split("--values")[0]
    assert shown.replace(",", " ").split() == list(names(parameters.VARIED))


def test_tables_have_a_text_for_every_column():
    for parameter in SCENARIO:
        row = dict(zip(HEADING, parameter.row, strict=True))
        assert row["parameter"] == parameter.name and row["unit"] == parameter.unit
        assert row["meaning"].startswith(parameter.meaning) and "[" not in row["meaning"]
        assert all(row[title] for title in ("type", "allowed", "meaning"))
        if parameter.elements:
            assert yaml.safe_load(row["default"]) == parameter.default
        elif parameter.default is not None:
            assert parameter.type(row["default"]) == parameter.default


RELEASED = """
spin_rate_ratio: -3.0
bodies:
  - {name: a, mass_kg: 1.0, position_m: [0, 6, 0], velocity_m_s: [2.0, 0.0, 0.4]}
  - {name: b, mass_kg: 1.0, position_m: [0, -6, 0], velocity_m_s: [-1.0, 0.0, -0.2]}
tethers:
  - {between: [a, b], length_m: 12.0, axial_stiffness_n: 1.0, damping_n_s_per_m: 0.0,
     bead_mass_kg: [0.1, 0.1]}
"""


def test_velocities_of_bodies_make_a_start(tmp_path):
    file = tmp_path / "released.yaml"
    file.write_text(RELEASED)
    loaded = scenario.load(file)
    system = loaded.build()
    start = loaded.start(system)
    names_in_line = ("a", "tether_1_bead_1", "tether_1_bead_2", "b")
    order = [system.bead_name.index(name) for name in names_in_line]
    assert start.position_m[order].tolist() == [[0, 6, 0], [0, 2, 0], [0, -2, 0], [0, -6, 0]]
    # Beads at thirds of the tether have the velocity at thirds between its ends.
    expected = [[2, 0, 0.4], [1, 0, 0.2], [0, 0, 0], [-1, 0, -0.2]]
    assert start.velocity_m_s[order] == pytest.approx(np.array(expected))
    assert scenario.load("three_star").start(scenario.load("three_star").build()) is None


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (", velocity_m_s: [2.0, 0.0, 0.4]", "", r"bodies\[1\] has velocity_m_s and bodies\[0\]"),
        ("[2.0, 0.0, 0.4]", "[2.0, 0.0]", r"bodies\[0\].velocity_m_s must be \[x, y, z\]"),
        ("[2.0, 0.0, 0.4]", "[2.0, .nan, 0.4]", r"bodies\[0\].velocity_m_s must be .*nan"),
        ("velocity_m_s: [2", "velocity: [2", r"bodies\[0\] has 'velocity'; .*velocity_m_s"),
    ],
)
def test_wrong_velocities_are_named(tmp_path, old, new, expected):
    file = tmp_path / "released.yaml"
    file.write_text(RELEASED.replace(old, new))
    with pytest.raises(TssError, match=expected):
        scenario.load(file)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("satellites=3", ("satellites", 3)),
        ("j2=1e-3", ("j2", 1e-3)),
        ("satellite_mass_kg=[50,60.5]", ("satellite_mass_kg", [50.0, 60.5])),
        ("tether_law=tension_only", ("tether_law", "tension_only")),
    ],
)
def test_assignments_on_command_lines_are_read(text, expected):
    name, value = read_assignment(text)
    assert (name, value) == expected and type(value) is type(expected[1])
