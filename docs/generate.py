"""Writes the parts of the documentation that the code itself can tell, into docs/_generated/.

`make docs` does so before Sphinx reads the pages, which include these parts. Nothing here is typed
twice: equations come from the citations in the core, parameters from the nodes' table, topics from
recording.yaml, interfaces from their files, commands from their --help, the tree from docstrings.

Run as ``python docs/generate.py`` in an activated shell to write them without Sphinx.
"""

import ast
import contextlib
import importlib
import io
import os
import re
import sys
import tokenize
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import yaml

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "tss_ros"
CORE = PACKAGE / "core"
INTERFACES = ROOT / "msg_configs" / "tss_interfaces"
SIMULATION_INTERFACES = ROOT / "msg_configs" / "simulation_interfaces"
OUTPUT = ROOT / "docs" / "_generated"

# ---------------------------------------------------------------- equations

#: What each numbered equation of the paper says.
EQUATIONS = {
    1: "Motion of a bead: mass times acceleration is the sum of all forces",
    2: "Gravity of the Earth",
    3: "Elastic tension of a tether",
    4: "Which beads a tether joins: a ring",
    5: "The switch: a tether acts only while it is longer than its rest length",
    6: "Damping of a tether",
    7: "Inertial force of the moving orbit frame",
    8: "The same, written out for a circular orbit",
    9: "The same, as a vector",
    10: "Coriolis force",
    11: "Coriolis force, as a vector",
    12: "Linear system with periodic coefficients",
    13: "Its fundamental solutions",
    14: "They start from the identity",
    15: "One period later they are combinations of themselves",
    16: "The coefficients are their values at T",
    17: "A solution that is multiplied by rho in a period",
    18: "That solution from the fundamental ones",
    19: "The same, one period later",
    20: "The condition on rho",
    21: "The condition as a matrix product",
    22: "Matrix of the fundamental solutions",
    23: "The second factor of the product",
    24: "The condition, row by row",
    25: "The eigenvalue problem",
    26: "Monodromy matrix: the fundamental solutions at T",
    27: "Its eigenvectors; stable if all |rho| < 1",
    28: "Motion as a first-order system",
    29: "Order of the state: velocities, then positions",
    30: "Right-hand side of the first-order system",
    31: "Velocities are the derivatives of positions",
    32: "Accelerations are the sum of all forces",
    33: "The point about which the motion is expanded",
    34: "Frozen method: variations with a constant matrix J_0",
    35: "J_0, the derivative of the right-hand side at that point",
    36: "The variations start from the identity",
    37: "Solutions from the eigenvectors of J_0",
    38: "The general solution",
    39: "Its constants at the start",
    40: "Matrix of eigenvectors",
    41: "The constants from it",
    42: "The solution that starts from the identity",
    43: "Solutions where J_0 has too few eigenvectors",
    44: "Generalised eigenvectors",
    45: "Their recurrence",
    46: "Frozen monodromy matrix",
    47: "Condition of stability: every |rho| < 1",
    48: "Example: three satellites, no tether beads",
    49: "Motion of the example, written out",
    50: "Start: a regular polygon that turns",
    51: "Radius R_1 of the polygon: satellite 1 is balanced",
    52: "Jacobian of the motion",
    53: "Relative deviation of a bead's distance from the centre",
    54: "Radii R_1 and R_2 of the ring with a bead on each tether",
}

_NUMBER = r"\(\d+\)"
_BETWEEN = r"\s*(?:-|–|,|to\b|and\b|or\b)\s*"
_CITATION = re.compile(rf"\bEqs?\.\s*({_NUMBER}(?:(?:{_BETWEEN})+{_NUMBER})*)")


@dataclass(frozen=True)
class Citation:
    """A place in the code that names an equation.

    Attributes
    ----------
    number : int
    path : Path
    line : int
    name : str
        Function, method or class around it; empty for a module's own docstring and comments.
    in_range : bool
        True for 13 in "Eqs. (12)-(16)": named with its neighbours, not by itself.
    """

    number: int
    path: Path
    line: int
    name: str
    in_range: bool


def cited_numbers(text):
    """List (number, position in the text, whether inside a range) of every equation cited."""
    found = []
    for match in _CITATION.finditer(text):
        before = None
        end = 0
        for part in re.finditer(r"\((\d+)\)", match[1]):
            number, separator = int(part[1]), match[1][end : part.start()]
            if before is not None and re.search(r"-|–|to", separator):
                found.extend((n, match.start(), True) for n in range(before + 1, number))
            found.append((number, match.start(), False))
            before, end = number, part.end()
    return found


def _texts(source, tree):
    """Docstrings and comments, as (line, text); code and error messages do not count."""
    scopes = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in ast.walk(tree):
        if isinstance(node, scopes) and ast.get_docstring(node, clean=False) is not None:
            yield node.body[0].lineno, node.body[0].value.value
    comments = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            text, line = token.string.lstrip("#: "), token.start[0]
            if comments and comments[-1][1] == line - 1:
                first, _, before = comments.pop()
                comments.append((first, line, f"{before}\n{text}"))
            else:
                comments.append((line, line, text))
    for first, _, text in comments:
        yield first, text


def _name_around(tree, line):
    """Dotted name of the innermost function or class around a line."""
    names, nodes = [], tree.body
    while nodes:
        kinds = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
        inside = [n for n in nodes if isinstance(n, kinds) and n.lineno <= line <= n.end_lineno]
        names += [n.name for n in inside]
        nodes = inside[0].body if inside else []
    return ".".join(names)


def citations(folder=CORE):
    """Find every equation that a docstring or comment in `folder` names as "Eq. (n)".

    Parameters
    ----------
    folder : Path

    Returns
    -------
    list of Citation
        By number, then by file and line.
    """
    found = []
    for path in sorted(folder.rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        tree = ast.parse(source)
        for first_line, text in _texts(source, tree):
            for number, position, in_range in cited_numbers(text):
                line = first_line + text.count("\n", 0, position)
                found.append(Citation(number, path, line, _name_around(tree, line), in_range))
    return sorted(found, key=lambda c: (c.number, c.path, c.line))


def equations():
    """Table of the paper's equations and where each is computed."""
    by_number = {}
    for citation in citations():
        by_number.setdefault(citation.number, []).append(citation)
    lines = ["| Eq. | what it says | named by itself in | named in a range in |"]
    lines.append("|---:|---|---|---|")
    for number, text in EQUATIONS.items():
        cells = []
        for in_range in (False, True):
            places = {}
            for c in by_number.get(number, []):
                if c.in_range == in_range:
                    names = places.setdefault(c.path.relative_to(CORE).as_posix(), [])
                    if c.name and c.name not in names:
                        names.append(c.name)
            cells.append(
                "; ".join(
                    f"`{path}`" + (": " + ", ".join(f"`{n}`" for n in names) if names else "")
                    for path, names in places.items()
                )
            )
        if not any(cells):
            cells[0] = "*not named in the code*"
        lines.append(f"| ({number}) | {_cell(text)} | {cells[0]} | {cells[1]} |")
    return "\n".join(lines) + "\n"


# ---------------------------------------------------------------- parameters, topics, interfaces


def _cell(text):
    """Text that fits into a cell of a table."""
    return " ".join(str(text).split()).replace("|", "\\|")


def parameters():
    """Tables of the nodes' parameters, from the table the nodes declare them from."""
    from tss_ros.ros import parameters as table

    kinds = {str: "string", bool: "bool", int: "integer", float: "double"}
    nodes = {
        "sim_node": table.SIMULATOR,
        "stability_node": (table.SCENARIO, *table.OVERRIDES, *table.STABILITY),
        "logger_node": table.LOGGER,
    }
    text = ""
    for node, entries in nodes.items():
        text += f"\n## {node}\n\n| parameter | meaning | type, range | default | changes |\n"
        text += "|---|---|---|---|---|\n"
        for p in entries:
            kind = kinds[p.type] + ("(s)" if p.per_element else "[]" if p.elements else "")
            kind += "" if p.minimum is None else f", {p.minimum:g} to {p.maximum:g}"
            kind += f": {', '.join(f'`{choice}`' for choice in p.choices)}" if p.choices else ""
            default = "scenario's" if p.default is None else f"`{p.default!r}`"
            cells = (f"`{p.name}`", p.text, kind, default, p.applies)
            text += "| " + " | ".join(map(_cell, cells)) + " |\n"
    return text


#: Whether a topic is recorded, from its fields `recorded` and `optional`.
_RECORDED = {
    (True, False): "yes",
    (True, True): "where published",
    (False, False): "no",
    (False, True): "no",
}
#: What the topics carry whose message type belongs to another package and so says nothing of it.
_FOREIGN_TOPICS = {
    "markers": "Beads and tethers, for RViz and Foxglove.",
    "bead_cloud": "Beads as points: x, y, z [m], deviation [-], speed [m/s].",
    "tether_lengths": "Tethers as joints: length [m], its rate [m/s] as velocity, tension [N] as"
    " effort.",
    "/clock": "Simulation time, 10 to 200 times a second of wall time, also while paused.",
    "/diagnostics": "Once a second: the motion, slack tethers, recorders.",
    "{satellite}/odom": "With `odometry`: position [m] and velocity [m/s] of a satellite relative"
    " to another or to the centre of mass, along the axes of the orbit frame.",
    "~/{satellite}/cmd_wrench": "Force on a satellite [N], until the next one: see"
    " [Push satellites](../howto/control.md).",
    "~/cmd_tether": "Rates [m/s] and target lengths [m] of reels, by names of whole tethers: see"
    " [Move reels](../howto/control.md).",
    "~/cmd_tether_trajectory": "Profiles of lengths [m] that reels fly: see"
    " [Move reels](../howto/control.md).",
    "/tf": "With `publish_tf`: `inertial` > `orbit` > every bead [m], at most 50 times a second"
    " of wall time.",
}


def topics():
    """Table of topics, from recording.yaml and the first lines of the message files."""
    entries = yaml.safe_load((ROOT / "msg_configs" / "recording.yaml").read_text(encoding="utf-8"))
    lines = ["| topic | node | type | recorded | QoS | what |"]
    lines.append("|---|---|---|---|---|---|")
    for name, entry in entries.items():
        package, _, kind = entry["type"].split("/")
        if package == "tss_interfaces":
            shown, what = _type(kind), about(INTERFACES / "msg" / f"{kind}.msg")
        else:
            shown, what = f"{package}/ {kind}", _FOREIGN_TOPICS[name]
        cells = (
            f"`{name}`",
            f"`{entry.get('publisher', 'sim_node')}`",
            shown,
            _RECORDED[entry["recorded"], entry.get("optional", False)],
            f"{'latched' if entry['durability'] == 'transient_local' else 'volatile'},"
            f" {entry['depth']}",
            what,
        )
        lines.append("| " + " | ".join(map(_cell, cells)) + " |")
    return "\n".join(lines) + "\n"


def _type(name):
    """A type of tss_interfaces, with a link to its file among the interfaces."""
    return f"[{name}](interfaces.md#{name.lower()})"


def about(path):
    """The comment lines that a message, service or action file begins with."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# "))
    return " ".join(lines)


_OFFERED_BY = {
    "simulator": "sim_node",
    "stability_service": "stability_node",
    "recorder": "logger_node",
}


def offered(kind):
    """List (node, name, file) of the services ("srv") or actions ("action") that nodes offer."""
    found = []
    for path in sorted((ROOT / "msg_configs").glob(f"*/{kind}/*.{kind}")):
        name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", path.stem).lower()
        pattern = re.compile(rf'"(?:~/)?{name}"')
        for folder, node in _OFFERED_BY.items():
            sources = (PACKAGE / folder).rglob("*.py")
            if any(pattern.search(source.read_text(encoding="utf-8")) for source in sources):
                found.append((node, name, path))
                break
        else:
            raise ValueError(f"no node offers {path.name}")
    return sorted(found)


def services():
    """Table of services."""
    return _offers("srv", "service")


def actions():
    """Table of actions."""
    return _offers("action", "action")


def _offers(kind, word):
    lines = [f"| node | {word} | what it does |", "|---|---|---|"]
    for node, name, path in offered(kind):
        page = "interfaces" if path.is_relative_to(INTERFACES) else "simulation_interfaces"
        link = f"[`~/{name}`]({page}.md#{path.stem.lower()})"
        lines.append(f"| `{node}` | {link} | {_cell(about(path))} |")
    return "\n".join(lines) + "\n"


def interfaces():
    """Every message, service and action file, as it stands."""
    text = ""
    for kind, title in (("msg", "Messages"), ("srv", "Services"), ("action", "Actions")):
        text += f"\n## {title}\n"
        for path in sorted((INTERFACES / kind).glob(f"*.{kind}")):
            body = path.read_text(encoding="utf-8").strip()
            text += f"\n### {path.stem}\n\n```text\n{body}\n```\n"
    return text


#: What the sections of a file are, by its ending.
_SECTIONS = {"msg": ("",), "srv": ("request", "response"), "action": ("goal", "result", "feedback")}


def fields(path):
    """List (section, declaration, comment) of the fields and constants of an interface file."""
    sections, found = iter(_SECTIONS[path.suffix[1:]]), []
    section = next(sections)
    for line in path.read_text(encoding="utf-8").splitlines():
        declaration, _, comment = line.partition("#")
        if line.startswith("---"):
            section = next(sections)
        elif declaration.strip():
            found.append((section, " ".join(declaration.split()), comment.strip()))
    return found


def simulation_interfaces():
    """Tables of the served types of simulation_interfaces: what each field means here."""
    text = ""
    for kind, title in (("srv", "Services"), ("action", "Actions"), ("msg", "Messages")):
        text += f"\n## {title}\n"
        for path in sorted((SIMULATION_INTERFACES / kind).glob(f"*.{kind}")):
            first = "" if kind == "msg" else "| part "
            text += f"\n### {path.stem}\n\n{about(path)}\n\n{first}| field or constant | here |\n"
            text += f"{first and '|---'}|---|---|\n"
            for section, declaration, comment in fields(path):
                cells = (f"`{declaration}`", _cell(comment))
                text += "| " + " | ".join((section, *cells) if first else cells) + " |\n"
    return text


# ---------------------------------------------------------------- commands, scenarios


def commands():
    """What each command prints for --help; nodes have pages of their own."""
    from tss_ros import command_line
    from tss_ros.__main__ import COMMANDS
    from tss_ros.executables import EXECUTABLES

    text = ""
    for group, entries in COMMANDS.items():
        text += f"\n## {group}\n"
        for name, (executable, about) in entries.items():
            if executable.endswith("_node"):
                text += f"\n### tss {name}\n\nRuns [{executable}](nodes.md): {about}.\n"
                continue
            module, function = EXECUTABLES[executable].split(":")
            main = getattr(importlib.import_module(f"tss_ros.{module}"), function)
            shown_as = {executable: f"tss {name}"}
            with (
                mock.patch.object(sys, "argv", [name, "--help"]),
                mock.patch.dict(os.environ, COLUMNS="84", NO_COLOR="1"),
                mock.patch.dict(command_line.SHOWN_AS, shown_as),
                contextlib.redirect_stdout(io.StringIO()) as out,
                contextlib.suppress(SystemExit),
            ):
                main()
            if not out.getvalue().startswith(f"usage: tss {name}"):
                raise ValueError(f"{name} --help says nothing")
            text += f"\n### tss {name}\n\n```text\n{out.getvalue()}```\n"
    return text


def scenarios():
    """Table of the scenarios that come with the package."""
    lines = ["| scenario | formation | satellites | spin rate / Omega | description |"]
    lines.append("|---|---|---:|---:|---|")
    for path in sorted((PACKAGE / "scenarios").glob("*.yaml")):
        entry = yaml.safe_load(path.read_text(encoding="utf-8"))
        cells = [f"`{path.stem}`"]
        cells += [entry.get(k, "") for k in ("formation", "satellites", "spin_rate_ratio")]
        cells.append(entry.get("description", ""))
        lines.append("| " + " | ".join(map(_cell, cells)) + " |")
    return "\n".join(lines) + "\n"


# ---------------------------------------------------------------- the tree


def first_sentence(path):
    """The first sentence of a module's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    # An abbreviation is no end: "Eq. (3)", "Eqs. (2)-(4)", an initial as in "Y. Saad".
    end = r"(?<!Eq\.)(?<!Eqs\.)(?<!\b[A-Z]\.)(?<=\.)\s"
    return re.split(end, " ".join(text.split()), maxsplit=1)[0]


def tree():
    """One line for each package and each of its modules, from their docstrings."""
    text = ""
    for init in sorted(PACKAGE.rglob("__init__.py")):
        folder = init.parent
        if folder == PACKAGE:
            continue
        title = folder.relative_to(ROOT).as_posix()
        text += f"\n### `{title}`\n\n{first_sentence(init)}\n\n"
        modules = [path for path in sorted(folder.glob("*.py")) if path != init]
        if modules:
            text += "| module | what it holds |\n|---|---|\n"
        for path in modules:
            text += f"| `{path.name}` | {_cell(first_sentence(path))} |\n"
    return text


# ---------------------------------------------------------------- Python interface


def python_api():
    """Page of everything in `tss_ros.core.__all__`, for autosummary, in reStructuredText."""
    core = importlib.import_module("tss_ros.core")
    groups = {"Functions": [], "Classes": [], "Errors": [], "Constants": []}
    for name in core.__all__:
        thing = getattr(core, name)
        if not isinstance(thing, type):
            groups["Functions" if callable(thing) else "Constants"].append(name)
        else:
            groups["Errors" if issubclass(thing, BaseException) else "Classes"].append(name)
    title = "Python interface: ``tss_ros.core``"
    text = f"{title}\n{'=' * len(title)}\n\n{core.__doc__.strip()}\n\n"
    text += ".. currentmodule:: tss_ros.core\n"
    for group, names in groups.items():
        text += f"\n{group}\n{'-' * len(group)}\n\n"
        if group == "Constants":
            for name in sorted(names):
                values = ", ".join(
                    f"``{getattr(value, 'name', value)!r}``" for value in getattr(core, name)
                )
                text += f".. data:: {name}\n\n   {values}\n\n"
            continue
        text += ".. autosummary::\n   :toctree: api\n   :nosignatures:\n\n"
        text += "".join(f"   {name}\n" for name in sorted(names, key=str.lower))
    return text


# ---------------------------------------------------------------- gallery


class GalleryOrder:
    """Sorts examples for sphinx-gallery: those a newcomer wants first, then the others by name."""

    FIRST = ("plot_paper_ring.py", "plot_multipliers.py", "plot_frozen_against_true.py")

    def __init__(self, folder):
        self.folder = folder

    def __repr__(self):
        return "GalleryOrder"

    def __call__(self, file_name):
        """Key of one example."""
        first = self.FIRST
        return (first.index(file_name) if file_name in first else len(first), file_name)


PARTS = {
    "equations.md": equations,
    "parameters.md": parameters,
    "topics.md": topics,
    "services.md": services,
    "actions.md": actions,
    "interfaces.md": interfaces,
    "simulation_interfaces.md": simulation_interfaces,
    "commands.md": commands,
    "scenarios.md": scenarios,
    "tree.md": tree,
    "python_api.rst": python_api,
}


def write(output=OUTPUT):
    """Write every part; a file that would not change is left alone, so that Sphinx is quick."""
    output.mkdir(parents=True, exist_ok=True)
    for name, make in PARTS.items():
        path, text = output / name, make()
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write()
