"""The parts of a page: charts by plotly, tables, and the document around them."""

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from tss_ros.plots.style import COLOURS, INK

#: Most points of a chart, and of one of its curves.
MOST_POINTS, MOST_OF_CURVE = 60_000, 5000
#: Most curves of a chart, and rows of a table.
MOST_CURVES, MOST_ROWS = 40, 2000
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
#: Symbols and colours of verdicts, as in the figures.
VERDICTS = {
    "asymptotically stable": ("circle", "#0072B2"),
    "neutral": ("square", "#009E73"),
    "unstable": ("x", "#D55E00"),
    "none found": ("triangle-down", "#555555"),
    "undecided": ("diamond", "#CC79A7"),
}
STYLE = """body{font:16px/1.5 sans-serif;max-width:75em;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0;font-size:14px}.rows{max-height:32em;overflow:auto}
td,th{border-bottom:1px solid #ddd;padding:.25em .7em;text-align:left;vertical-align:top}
th{background:#f4f4f4;position:sticky;top:0}p.note{color:#555;font-size:14px}h2{margin-top:1.6em}
.pair{display:grid;grid-template-columns:1fr 1fr}@media(max-width:60em){.pair{display:block}}"""


def document(title: str, parts: Iterable[str]) -> str:
    """A page that needs nothing else: the library for its charts is in it."""
    head = f"<meta charset=utf-8><title>{escape(title)}</title><style>{STYLE}</style>"
    script = f"<script>{get_plotlyjs()}</script>"
    body = "\n".join(parts)
    return (
        f"<!DOCTYPE html>\n<html lang=en><head>{head}{script}</head>"
        f"<body><h1>{escape(title)}</h1>\n{body}\n</body></html>\n"
    )


def heading(text: str) -> str:
    """A heading of a part of the page."""
    return f"<h2>{escape(text)}</h2>"


def note(text: str) -> str:
    """A remark below a chart."""
    return f'<p class="note">{escape(text)}</p>'


def table(names: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table; of more than `MOST_ROWS` rows it shows the first and says how many there are."""
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    cells = ("".join(f"<td>{escape(str(cell))}</td>" for cell in row) for row in rows[:MOST_ROWS])
    body = "".join(f"<tr>{row}</tr>" for row in cells)
    text = f'<div class="rows"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'
    left = f"The first {MOST_ROWS} of {len(rows)} rows." if len(rows) > MOST_ROWS else ""
    return f"{text}</div>{note(left) if left else ''}"


def facts(pairs: Iterable[tuple[str, str]]) -> str:
    """Names and what they are, as a table."""
    rows = "".join(f"<tr><th>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in pairs)
    return f"<table>{rows}</table>"


def figure(title: str, x: str, y: str, height: int = 380) -> go.Figure:
    """An empty chart."""
    return go.Figure(
        layout={
            "template": "plotly_white",
            "title": {"text": escape(title), "font": {"size": 16, "color": INK}},
            "xaxis": {"title": x, "showline": True},
            "yaxis": {"title": y, "showline": True, "exponentformat": "none"},
            "height": height,
            "margin": {"l": 70, "r": 20, "t": 60, "b": 50},
            "hovermode": "closest",
        }
    )


def chart(drawn: go.Figure, name: str) -> str:
    """A chart as a part of the page, under a name of its own."""
    return drawn.to_html(
        full_html=False,
        include_plotlyjs=False,
        div_id=name,
        config={"displaylogo": False, "responsive": True},
    )


def line(i: int, **more: object) -> dict[str, object]:
    """Colour and dashes of the i-th curve."""
    return {
        "color": COLOURS[i % len(COLOURS)],
        "dash": DASHES[i % len(DASHES)],
        "width": 1.4,
    } | more


def curves(drawn: go.Figure, turns: np.ndarray, values: np.ndarray, names: Sequence[str]) -> str:
    """Draw curves that keep every extreme, and say what was left out.

    Parameters
    ----------
    drawn : plotly.graph_objects.Figure
    turns : ndarray, shape (k,)
    values : ndarray, shape (k, n)
    names : sequence of str (n)

    Returns
    -------
    str
        What to say below the chart; "" if everything is drawn.
    """
    said, chosen = [], np.arange(len(names))
    if len(names) > MOST_CURVES:
        swing = np.nan_to_num(np.nanmax(values, axis=0) - np.nanmin(values, axis=0))
        chosen = np.sort(np.argsort(-swing, kind="stable")[:MOST_CURVES])
        said.append(f"The {MOST_CURVES} of {len(names)} curves that swing the most.")
    most = min(MOST_OF_CURVE, MOST_POINTS // len(chosen))
    per_part = 1
    for i in chosen:
        x, y, per_part = envelope(turns, values[:, i], most)
        drawn.add_scatter(x=x, y=y, name=names[i], mode="lines", line=line(i))
    if per_part > 1:
        said.append(
            f"Of each {per_part} steps in a row every curve shows the smallest and the largest"
            f" value ({len(turns)} steps in all)."
        )
    return " ".join(said)


def envelope(x: np.ndarray, y: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray, int]:
    """A curve by its extremes: the smallest and the largest of each so many points in a row.

    Parameters
    ----------
    x, y : ndarray, shape (k,)
    most : int
        Points to be left, at least 2.

    Returns
    -------
    tuple of ndarray, ndarray and int
        Points, in their order, and how many of the given ones two of them stand for; 1 where all
        are left. A value that is not finite is kept as the gap that it is.
    """
    if len(x) <= most:
        return x, y, 1
    per_part = -(-len(x) // (most // 2))
    kept = []
    for first in range(0, len(x), per_part):
        part = y[first : first + per_part]
        finite = np.flatnonzero(np.isfinite(part))
        if finite.size < len(part):
            kept.append(first + int(np.argmin(np.isfinite(part))))
        if finite.size:
            low, high = finite[np.argmin(part[finite])], finite[np.argmax(part[finite])]
            kept += [first + int(low), first + int(high)]
    kept = np.unique(kept)
    return x[kept], y[kept], per_part
