"""Executable `page`: one self-contained page of charts that sums up a bag or a sweep."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tss_ros.bags.commands import told_of_damage
from tss_ros.bags.recording import read_bag
from tss_ros.bags.records import one_line
from tss_ros.command_line import Parser, say, show_progress, why_not_written
from tss_ros.core import TssError
from tss_ros.pages import bag, html, sweep
from tss_ros.sweeps.store import MANIFEST


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `page`.

    Returns
    -------
    int
        Exit status: 0, 1 with one line why, 2 for a wrong command line.
    """
    parser = Parser(
        prog="page",
        description="Sum up a bag or a sweep in one page of interactive charts, which needs"
        " nothing else and opens offline.",
    )
    parser.add_argument(
        "source", type=Path, help="bag directory, .mcap file, or folder of a sweep or an ensemble"
    )
    parser.add_argument("--run", type=int, help="which run of a bag with several; default the last")
    parser.add_output(
        "--output", (".html",), metavar="FILE.html", help="default: named after the source, here"
    )
    options = parser.parse_args(argv)
    name = options.source.resolve().name.removesuffix(".mcap")
    output = options.output or Path(f"{name}.html")
    if why := why_not_written(output, (".html",), options.overwrite):
        parser.error(f"--output: {why}")
    status = 0
    try:
        if (options.source / MANIFEST).is_file():
            if options.run is not None:
                raise TssError(f"{str(options.source)!r} is a sweep; --run is for bags")
            kind = "Ensemble" if (options.source / sweep.MOTIONS).is_dir() else "Sweep"
            text = html.document(f"{kind} {name}", sweep.parts(options.source))
        else:
            show_progress("reading")
            recording = read_bag(options.source, options.run, damaged=True)
            status = told_of_damage("page", options.source, recording)
            show_progress("drawing")
            with np.errstate(all="ignore"):  # numbers that are not finite are named
                text = html.document(f"Recording {name}", bag.parts(recording))
        output.write_text(text, encoding="utf-8")
    except TssError as error:
        say("page", one_line(error))
        return 1
    except OSError as error:
        say("page", f"{str(output)!r} cannot be written: {error.strerror}")
        return 1
    finally:
        show_progress("")
    print(output)
    return status
