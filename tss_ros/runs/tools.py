"""Commands about the package itself: `compile`, `bench` and `completion`."""

import os
import runpy
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from tss_ros.command_line import Parser, say

#: Where the sources are; only a checkout has the benchmarks beside them.
CHECKOUT = Path(__file__).resolve().parents[2]
#: A line of progress comes at most so often [s].
SHOW_S = 1.0


def compile_kernels(argv: Sequence[str] | None = None) -> int:
    """Executable `compile`.

    Returns
    -------
    int
        Exit status, 0.
    """
    parser = Parser(
        prog="compile", description="Compile the numerical core ahead of its first use."
    )
    parser.parse_args(argv)
    from tss_ros.core import compile_cache

    begun, shown, terminal = time.monotonic(), 0.0, sys.stdout.isatty()

    def show(share: float) -> None:
        nonlocal shown
        if time.monotonic() - shown > SHOW_S:
            shown = time.monotonic()
            line = f"compiling: {100 * share:.0f} %"
            print(f"\r\033[K{line}" if terminal else line, end="" if terminal else "\n", flush=True)

    compiled = compile_cache.main(show)
    words = f"compiled in {time.monotonic() - begun:.0f} s" if compiled else "compiled already"
    print(f"\r\033[K{words}" if terminal else words)
    return 0


def bench(argv: Sequence[str] | None = None) -> int:
    """Executable `bench`: the benchmarks' own command line, in a checkout.

    Returns
    -------
    int
        Exit status: 0, or 1 where there are no benchmarks.
    """
    if not (CHECKOUT / "benchmarks" / "__main__.py").is_file():
        say("bench", "the benchmarks are in a checkout of the source only")
        return 1
    sys.argv[1:] = sys.argv[1:] if argv is None else argv
    sys.path.insert(0, str(CHECKOUT))
    runpy.run_module("benchmarks", run_name="__main__")
    return 0


def completion(argv: Sequence[str] | None = None) -> int:
    """Executable `completion`.

    Returns
    -------
    int
        Exit status, 0.
    """
    parser = Parser(
        prog="completion",
        description="Print what makes a shell complete the words of `tss`.",
        epilog='Give eval "$(tss completion bash)" in a shell, or write it into ~/.bashrc.',
    )
    shell = Path(os.environ.get("SHELL", "bash")).name
    parser.add_argument(
        "shell", nargs="?", choices=("bash", "zsh"), default=shell if shell == "zsh" else "bash"
    )
    options = parser.parse_args(argv)
    from argcomplete import shellcode

    print(shellcode(["tss"], shell=options.shell))
    return 0
