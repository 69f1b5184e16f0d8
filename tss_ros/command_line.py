"""What all command lines have in common: --help, --version, and no word that is not known."""

import argparse
import difflib
import re
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from typing import Any, NoReturn


class _ShowVersion(argparse.Action):
    def __init__(self, **options):
        super().__init__(nargs=0, help="show the package's version and exit", **options)

    def __call__(self, parser, *_):
        print(f"tss_ros {version('tss_ros')}")
        parser.exit()


class Parser(argparse.ArgumentParser):
    """An argument parser that knows --version, and names the nearest word where one is wrong."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.add_argument("--version", action=_ShowVersion, dest=argparse.SUPPRESS)

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

    def _checked(self, options, unknown):
        if unknown:
            self.refuse(unknown[0])
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
