"""Pages of claims: what they are computed from, in order, and how they are written."""

import base64
import re
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt

from tss_ros.command_line import Parser
from tss_ros.core import Cancelled
from tss_ros.runs.processes import run_command

STYLE = """body{font:16px/1.5 sans-serif;max-width:70em;margin:2em auto;padding:0 1em}
table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #bbb;padding:.3em .6em;
text-align:left;vertical-align:top}img{max-width:100%}"""


def compute(
    work: Mapping[str, Callable[[Callable[[], bool]], Any]], stopped: Callable[[], bool]
) -> dict[str, Any]:
    """Results by name of what a page needs, one after another, with a line for each.

    Raises
    ------
    Cancelled
        If `stopped` said so.
    """
    found = {}
    for count, (name, part) in enumerate(work.items(), 1):
        begun = time.monotonic()
        print(f"[{count}/{len(work)}] {name} ...", end="", flush=True)
        found[name] = part(stopped)
        if stopped():
            raise Cancelled(f"stopped after {name}")
        print(f" {time.monotonic() - begun:.1f} s", flush=True)
    return found


def page_command(
    name: str,
    about: str,
    make: Callable[[Path, Callable[[], bool]], None],
    argv: Sequence[str] | None,
) -> int:
    """Run an executable that makes a page in a folder; returns its exit status."""
    parser = Parser(prog=name, description=about)
    parser.add_argument(
        "--output", type=Path, default=Path("runs") / name,
        help="folder for the page (default %(default)s)",
    )  # fmt: skip
    output = parser.parse_args(argv).output
    return run_command(name, lambda caught: make(output, lambda: bool(caught)))


def html(markdown_text: str, folder: Path) -> str:
    """One self-contained page under the text's heading, with the pictures that the text names."""

    title = markdown_text.splitlines()[0].lstrip("# ")

    def embed(match):
        content = base64.b64encode((folder / match[1]).read_bytes()).decode()
        return f'src="data:image/png;base64,{content}"'

    body = MarkdownIt().enable("table").render(markdown_text)
    body = re.sub(r'src="([^":]+\.png)"', embed, body)
    head = f"<meta charset=utf-8><title>{title}</title><style>{STYLE}</style>"
    return f"<!DOCTYPE html><html lang=en>{head}<body>\n{body}</body></html>\n"


def picture(name: str, words: str) -> str:
    """A picture of a page, in Markdown."""
    return f"![{words}]({name}.png)"


def table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""

    def line(row):
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"

    return "\n".join(map(line, (heading, ["---"] * len(heading), *rows)))
