"""How results show themselves: a line in a shell, a table in a notebook, figures, data frames.

What draws, saves or makes data frames is no part of the core. It is found by its name when it is
asked for, and may be missing.
"""

import importlib
from collections.abc import Iterable, Mapping
from html import escape
from types import ModuleType
from typing import Any

from tss_ros.extras import advice

#: What an axis of spin rates is called.
SPIN_RATE_LABEL = "spin rate over orbital rate, ω/Ω [-]"
_CELL = "text-align:left;vertical-align:top;padding:1px 12px 1px 0"


class Presented:
    """A result that says in a line and in a table what it is."""

    def _headline(self) -> str:
        """What the result is, in a line."""
        raise NotImplementedError

    def _facts(self) -> dict[str, object]:
        """What there is to say of it, by name."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._headline()}>"

    def _repr_html_(self) -> str:
        return html_table(f"{type(self).__name__} {self._headline()}", self._facts().items())


def html_table(title: str, rows: Iterable[Iterable[object]], head: Iterable[str] = ()) -> str:
    """A small table for a notebook.

    Parameters
    ----------
    title : str
    rows : iterable of iterables
        Cells; the first of each row is its name where there is no head.
    head : iterable of str
        Names of the columns, if there are any.

    Returns
    -------
    str
    """
    head = [f'<th style="{_CELL}">{escape(name)}</th>' for name in head]
    lines = [f"<tr>{''.join(head)}</tr>"] if head else []
    for row in rows:
        first, *others = (escape(str(cell)) for cell in row)
        tag = "td" if head else "th"
        cells = [f'<{tag} style="{_CELL}">{first}</{tag}>']
        cells += [f'<td style="{_CELL}">{cell}</td>' for cell in others]
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return f"<div><b>{escape(title)}</b><table>{''.join(lines)}</table></div>"


def turn_in_words(spin_rate_ratio: float) -> str:
    """What a formation's turns are called: "turn", or "orbit" if it hangs."""
    return "turn" if spin_rate_ratio else "orbit"


def a_turn(spin_rate_ratio: float) -> str:
    """How often something happens: "a turn", or "an orbit" if the formation hangs."""
    return f"{'a' if spin_rate_ratio else 'an'} {turn_in_words(spin_rate_ratio)}"


def found(module: str, what: str) -> ModuleType:
    """A module outside the core, by its name.

    Parameters
    ----------
    module : str
    what : str
        Needs it, for the error.

    Returns
    -------
    module

    Raises
    ------
    ModuleNotFoundError
        If it or what it needs is not installed; the text names the extra that has it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if words := advice(error):
            raise ModuleNotFoundError(f"{what} {words}", name=error.name) from None
        raise


def data_frame(columns: Mapping[str, Any]) -> Any:
    """Columns as a pandas.DataFrame."""
    return found("pandas", "to_pandas").DataFrame(columns)
