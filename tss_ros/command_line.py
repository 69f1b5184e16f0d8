"""What all command lines have in common: --help, --version, and no word that is not known."""

import argparse
import difflib
import math
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn, TextIO

#: What an executable is called in its help where it is a command of `tss`.
SHOWN_AS: dict[str, str] = {}
#: Endings of figures.
FIGURES = (".png", ".pdf", ".svg")
_CODES = {"bold": "1", "red": "31", "cyan": "36"}


def painted(text: str, colour: str, stream: TextIO | None = None) -> str:
    """A text in a colour, or bold, where a terminal shows it and nobody has set NO_COLOR."""
    stream = stream or sys.stdout
    plain = not stream.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return text if plain else f"\033[{_CODES[colour]}m{text}\033[0m"


def say(name: str, text: object) -> None:
    """Write a line to the standard error that begins with what an executable is called."""
    print(f"{SHOWN_AS.get(name, name)}: {text}", file=sys.stderr)


def why_not_written(path: Path, endings: Sequence[str] = (), overwrite: bool = False) -> str:
    """Why an output cannot be written, or must not.

    Parameters
    ----------
    path : Path
    endings : sequence of str
        Of which a file's name has one; without any, the output is a folder, which may exist.
    overwrite : bool
        Whether a file that exists may be replaced.

    Returns
    -------
    str
        What to say of it; "" if it can be written.
    """
    if not endings:
        there = next(p for p in (path, *path.absolute().parents) if os.path.lexists(p))
        if not there.is_dir():
            return f"{str(there)!r} is no folder"
        return "" if os.access(there, os.W_OK) else f"folder {str(there)!r} cannot be written to"
    if path.suffix.lower() not in endings:
        return f"{str(path)!r} has no known ending; allowed: {', '.join(endings)}"
    if path.is_dir():
        return f"{str(path)!r} is a folder"
    if path.is_file() and not overwrite:
        return f"{str(path)!r} exists already; give another name, or --overwrite"
    if not path.parent.is_dir():
        return f"{str(path)!r} cannot be written: there is no folder {str(path.parent)!r}"
    writable = os.access(path if path.exists() else path.parent, os.W_OK)
    return "" if writable else f"{str(path)!r} cannot be written: permission denied"


#: How often [s] a line that shows progress is renewed.
PROGRESS_S = 0.2


def show_progress(text: str) -> None:
    """Say on a terminal, in a line that the next one replaces, how far things are; "" ends it."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


class ProgressLine:
    """The line on a terminal that says how far long work is, renewed a few times a second.

    Attributes
    ----------
    begun : float
        When the work began [s], by `time.monotonic`.
    """

    def __init__(self) -> None:
        self.begun, self._shown = time.monotonic(), -math.inf

    @property
    def due(self) -> bool:
        """Whether it is time to show how far the work is."""
        return sys.stderr.isatty() and time.monotonic() - self._shown >= PROGRESS_S

    def show(self, text: str) -> None:
        """Put this in place of what the line said."""
        if sys.stderr.isatty():
            self._shown = time.monotonic()
            show_progress(text)

    def end(self) -> None:
        """Leave the line, if there is one."""
        if self._shown > -math.inf:
            print(file=sys.stderr)


class _ShowVersion(argparse.Action):
    def __init__(self, **options):
        super().__init__(nargs=0, help="show the package's version and exit", **options)

    def __call__(self, parser, *_):
        print(f"tss_ros {version('tss_ros')}")
        parser.exit()


class Parser(argparse.ArgumentParser):
    """An argument parser that knows --version, and names the nearest word where one is wrong.

    Where a shell asks what a word may go on to, it answers that.
    """

    def __init__(self, *, prog: str, **options: Any) -> None:
        super().__init__(prog=SHOWN_AS.get(prog, prog), **options)
        self._completing, self._outputs, self._parameters = False, [], ()
        self.add_argument("--version", action=_ShowVersion, dest=argparse.SUPPRESS)

    def add_override(self, names: Sequence[str], kind: Callable[[str], Any], text: str) -> None:
        """Add --override, which takes `NAME=VALUE` of parameters, as often as one likes.

        Parameters
        ----------
        names : sequence of str
            Of the parameters: one that is given as an option is answered with how to write it.
        kind : callable
            Makes of a word what is kept.
        text : str
            What --help says.
        """
        self._parameters = names
        self.add_argument(
            "--override", nargs="+", action="extend", default=[], type=kind, metavar="NAME=VALUE",
            help=text,
        )  # fmt: skip

    def add_output(
        self, flag: str, endings: Sequence[str] = (), group: Any = None, **options: Any
    ) -> None:
        """Add an option for a file or folder to be written, which parsing checks.

        Parameters
        ----------
        flag : str
        endings : sequence of str
            Of which a file's name has one; without any, it is a folder.
        group : optional
            Of this parser, for the option to belong to.
        **options
            For `add_argument`.
        """
        if not self._outputs:
            self.add_argument(
                "--overwrite", action="store_true", help="replace files that exist already"
            )
        added = (group or self).add_argument(flag, type=Path, **options)
        self._outputs.append((flag, added.dest, endings))

    def parse_args(
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> argparse.Namespace:
        """Parse; exit with status 2 and one line why where a word is not known."""
        return self._checked(*self.parse_known_args(args, namespace))

    def parse_intermixed_args(
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> argparse.Namespace:
        """The same where options stand between what has no name."""
        return self._checked(*self.parse_known_intermixed_args(args, namespace))

    def parse_known_args(
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse what is known, and list the rest."""
        if "_ARGCOMPLETE" in os.environ and not self._completing:
            import argcomplete

            self._completing = True
            argcomplete.autocomplete(self)
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Exit with status 2 and a line that says what is wrong."""
        self.print_usage(sys.stderr)
        self.exit(2, f"{painted(f'{self.prog}: error:', 'red', sys.stderr)} {message}\n")

    def _checked(self, options, unknown):
        if unknown:
            self.refuse(unknown[0])
        for flag, name, endings in self._outputs:
            path = getattr(options, name)
            if path and (why := why_not_written(path, endings, options.overwrite)):
                self.error(f"{flag}: {why}")
        return options

    def refuse(self, word: str, others: Iterable[str] = (), advice: str = "") -> NoReturn:
        """Exit with status 2, and say that a word is not known.

        Parameters
        ----------
        word : str
        others : iterable of str
            What is known besides the options.
        advice : str
            What else to say.
        """
        name = re.split(":?=", word)[0].lstrip("-").replace("-", "_")
        if name in self._parameters:
            self.error(f"{word!r:.80} is a parameter: --override {name}=VALUE")
        options = [option for action in self._actions for option in action.option_strings]
        near = difflib.get_close_matches(re.split(":?=", word)[0], [*options, *others], 1)
        meant = f"; did you mean {near[0]!r}?" if near else ""
        self.error(f"{word!r:.80} is not known{meant}{advice}")


def without_ros_arguments(words: Sequence[str]) -> list[str]:
    """The words of a command line that are not between --ros-args and --, or the end."""
    kept, of_ros = [], False
    for word in words:
        if word == "--ros-args":
            of_ros = True
        elif of_ros and word == "--":
            of_ros = False
        elif not of_ros:
            kept.append(word)
    return kept
