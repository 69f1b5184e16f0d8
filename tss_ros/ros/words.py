"""The words on a node's command line: parameters follow --ros-args, and there is little else."""

import sys
from collections.abc import Sequence
from pathlib import Path

from tss_ros.command_line import SHOWN_AS, Parser, without_ros_arguments
from tss_ros.ros.parameters import Parameter


def check_words(
    name: str, about: str, *tables: Sequence[Parameter], argv: Sequence[str] | None = None
) -> None:
    """Answer --help and --version, and refuse every other word that is not ROS's.

    Parameters
    ----------
    name : str
        Of the executable.
    about : str
        What it does.
    *tables : sequence of Parameter
        Its parameters.
    argv : sequence of str, optional
        The command line without the executable.
    """
    known = [parameter for table in tables for parameter in table]
    called = SHOWN_AS.get(name, f"ros2 run tss_ros {name}")
    parser = Parser(
        prog=name,
        usage=f"{called} [--help] [--version] [--ros-args -p PARAMETER:=VALUE ...]",
        description=about,
        epilog=f"parameters: {', '.join(parameter.name for parameter in known)}. "
        f"`ros2 param describe /{name} PARAMETER` tells about one while the node runs.",
    )
    argv = sys.argv[1:] if argv is None else argv
    for word, file in zip(argv, argv[1:]):
        if word == "--params-file" and Path(file).exists() and not Path(file).is_file():
            # ROS would wait for a pipe without an end.
            parser.error(f"--params-file is {file!r:.200}; allowed: a file")
    words = without_ros_arguments(argv)
    _, unknown = parser.parse_known_args(words)
    if unknown:
        names = [parameter.name for parameter in known]
        parser.refuse(unknown[0], names, "; parameters go after --ros-args, as -p name:=value")
