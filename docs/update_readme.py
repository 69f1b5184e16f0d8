"""Puts what `make demo` printed into README.md, between its two markers.

Run ``make demo | tee demo.log``, then ``python docs/update_readme.py demo.log``.
"""

import sys
import textwrap
from pathlib import Path

README = Path(__file__).resolve().parent.parent / "README.md"
BEGIN, END = "<!-- make demo prints -->", "<!-- end -->"


def results(log):
    """The lines of the demo's table and of its summary, without the progress before them.

    Parameters
    ----------
    log : str
        All that `make demo` printed.

    Returns
    -------
    list of str
        None longer than 110 characters.
    """
    lines = log.splitlines()
    first = next(i for i, line in enumerate(lines) if line.lstrip().startswith("rate/Omega"))
    end = lines.index("", first)
    last = lines.index("", end + 1)
    summary = [part for line in lines[end + 1 : last] for part in textwrap.wrap(line, 110)]
    return [*lines[first:end], "", *summary]


def main():
    """Rewrite the README's block from the log that is named on the command line."""
    lines = results(Path(sys.argv[1]).read_text(encoding="utf-8"))
    block = "\n".join(f"    {line}".rstrip() for line in lines)
    text = README.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    after = rest.partition(END)[2]
    README.write_text(f"{before}{BEGIN}\n\n{block}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
