"""One command for everything: `tss`, or `python -m tss_ros`."""

import os
import sys
from collections.abc import Sequence

from tss_ros import command_line, executables
from tss_ros.command_line import Parser, painted

#: Commands in the order of the help, each with its executable and what it does.
COMMANDS = {
    "Run": {
        "demo": ("demo", "simulate, record, analyse and draw the paper's ring"),
        "sim": ("simulate", "simulate straight into a bag; alone or with --ros-args, as a node"),
        "logger": ("logger_node", "record what a simulator publishes"),
        "stability_node": ("stability_node", "answer questions about stability"),
        "reproduce": ("reproduce", "redo the paper's figures and judge its claims"),
        "literature": ("literature", "judge what other papers claim of other formations"),
        "feedback": ("feedback", "try feedback by thrusters on the paper's rings"),
    },
    "Stability": {
        "stability": ("stability", "ask a running stability node about spin rates"),
        "sweep": ("sweep", "stability over spin rates, scenarios and a parameter's values"),
        "follow": ("follow", "follow a family of motions in the spin rate or a parameter"),
        "ensemble": ("ensemble", "disturb a formation thousands of times: how probably it holds"),
    },
    "Recordings": {
        "summary": ("summary", "say what a bag holds"),
        "plot": ("plot", "draw a bag"),
        "review": ("review", "look at bags in the Rerun viewer, or save pictures"),
        "page": ("page", "sum up a bag or a sweep in one page of interactive charts"),
        "export": ("export", "write a bag as CSV or Parquet"),
        "play": ("play", "publish a bag again"),
        "verify": ("verify", "check whether bags are whole"),
        "recover": ("recover", "mend bags after a fault"),
    },
    "Package": {
        "compile": ("compile", "compile the numerical core ahead of its first use"),
        "bench": ("bench", "measure beside public solvers, in a checkout"),
        "completion": ("completion", "print what makes bash or zsh complete commands"),
    },
}
_EXECUTABLES = {name: entry[0] for group in COMMANDS.values() for name, entry in group.items()}


def _help():
    text = ""
    for group, commands in COMMANDS.items():
        text += f"\n{painted(group, 'bold')}\n"
        for name, (_, about) in commands.items():
            text += f"  {painted(name.ljust(15), 'cyan')} {about}\n"
    return text + "\n`tss COMMAND --help` says more about each."


class _Parser(Parser):
    def format_help(self):
        """The usage, the commands by group, and the options."""
        usage = self.format_usage()
        return f"{usage}\n{self.description}\n{_help()}\n"


def _completed_command():
    """The command whose words a shell wants completed, "" if it is the command itself."""
    from argcomplete import split_line

    line = os.environ["COMP_LINE"][: int(os.environ["COMP_POINT"])]
    start = int(os.environ["_ARGCOMPLETE"])
    words = split_line(line)[3][start:]
    if not words or words[0] not in _EXECUTABLES:
        return ""
    os.environ["_ARGCOMPLETE"] = str(start + 1)
    return words[0]


def main(argv: Sequence[str] | None = None) -> int:
    """Command `tss`.

    Returns
    -------
    int
        Exit status of the command that was asked for; 2 if there is no such command.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    name = _completed_command() if "_ARGCOMPLETE" in os.environ else (words or [""])[0]
    if name in _EXECUTABLES:
        executable = _EXECUTABLES[name]
        if name == "sim" and not command_line.without_ros_arguments(words[1:]):
            executable = "sim_node"
        command_line.SHOWN_AS[executable] = f"tss {name}"
        sys.argv[:] = [sys.argv[0], *words[1:]]
        return executables.run(executable)
    parser = _Parser(
        prog="tss",
        usage="tss COMMAND ... | tss --help | tss --version",
        description="Spinning tethered satellite formations: simulation and Floquet stability.",
    )
    parser.add_argument("command", nargs="?", choices=tuple(_EXECUTABLES))
    if words and not words[0].startswith("-") and "_ARGCOMPLETE" not in os.environ:
        parser.refuse(words[0], _EXECUTABLES, advice=" (`tss --help` lists the commands)")
    parser.parse_args(words)
    parser.print_help()
    return 0


if __name__ == "__main__":
    sys.exit(main())
