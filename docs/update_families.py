"""Draws the pictures of docs/families.md and renews its tables, by the commands that stand in it.

Run as ``python docs/update_families.py [NAME ...]`` in an activated shell; names are those of the
pictures, all if none is given.
"""

import contextlib
import io
import re
import shlex
import sys
from pathlib import Path

from tss_ros.sweeps.following import main as follow

PAGE = Path(__file__).resolve().parent / "families.md"
#: A command with the name of its picture, what stands between, and the table.
SECTION = re.compile(
    r"(?<=    ros2 run tss_ros follow )(?P<arguments>[^\n]*) --plot (?P<name>\w+)\.png\n"
    r"(?P<between>.*?```text\n)(?P<table>.*?)(?=```)",
    re.S,
)


def renewed(section, names):
    """A section with the table that its command prints today; its picture is drawn."""
    name = section["name"]
    if names and name not in names:
        return section[0]
    picture = str(PAGE.parent / "families" / f"{name}.png")
    with contextlib.redirect_stdout(io.StringIO()) as out:
        follow([*shlex.split(section["arguments"]), "--plot", picture, "--overwrite"])
    return f"{section['arguments']} --plot {name}.png\n{section['between']}{out.getvalue()}"


if __name__ == "__main__":
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(SECTION.sub(lambda m: renewed(m, sys.argv[1:]), text), encoding="utf-8")
