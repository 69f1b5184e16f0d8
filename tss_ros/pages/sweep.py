"""A page about the folder of a sweep, an ensemble, or whatever keeps its tables like them."""

import json
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from tss_ros.core import TssError, in_words
from tss_ros.core.presentation import SPIN_RATE_LABEL
from tss_ros.pages import html
from tss_ros.pages.bag import moduli
from tss_ros.sweeps.ensemble import MOTIONS, probabilities
from tss_ros.sweeps.jobs import CRITICAL_RATES, FAMILIES, MULTIPLIERS, SIMULATIONS, SPECIAL_POINTS
from tss_ros.sweeps.store import MANIFEST

#: The table of an ensemble.
#: What of a question is no fact for readers.
HIDDEN = ("scenario ", "version of ")
#: Columns shown of a table, those that it has; of one not named here, all short ones.
COLUMNS = {
    MULTIPLIERS: (
        "spin_rate_ratio", "method", "verdict", "decided by", "max_modulus", "closure_residual",
        "switches", "tether_law", "pushing_share", "error",
    ),
    CRITICAL_RATES: (
        "spin_rate_ratio", "uncertainty", "cause", "resonance", "stable_side", "tether_law",
        "pushing_share", "error",
    ),
    SIMULATIONS: (
        "critical_rate", "spin_rate_ratio", "verdict", "decided by", "simulated_held",
        "simulated_growth_per_turn", "agrees", "error",
    ),
    SPECIAL_POINTS: ("kind", "parameter", "uncertainty", "family"),
}  # fmt: skip
TITLES = {
    MULTIPLIERS: "Verdicts", CRITICAL_RATES: "Critical rates", SIMULATIONS: "Simulations beside",
    FAMILIES: "Families", SPECIAL_POINTS: "Special points", MOTIONS: "Disturbed motions",
}  # fmt: skip


def parts(folder: Path) -> Iterator[str]:
    """The parts of the page.

    Parameters
    ----------
    folder : Path

    Yields
    ------
    str

    Raises
    ------
    TssError
        If the manifest or a table cannot be read, or if there is nothing yet.
    """
    question, done, failures = _manifest(folder)
    tables = _tables(folder)
    if not tables:
        raise TssError(f"{str(folder)!r} holds no results yet: {done} jobs are done")
    asked = {
        k: v for k, v in question.items() if not k.startswith(HIDDEN) and v not in (None, "", [])
    }
    yield html.facts(
        [
            *((name.replace("_", " "), _short(value)) for name, value in asked.items()),
            ("jobs done", f"{done}, of which {len(failures)} failed"),
        ]
    )
    parameter = question.get("parameter") or ""
    yield from _charts(tables, parameter)
    for name in [*TITLES, *sorted(tables.keys() - TITLES.keys())]:
        if name in tables and name not in (FAMILIES, MOTIONS):
            yield html.heading(TITLES.get(name, name))
            yield _as_table(tables[name], COLUMNS.get(name), parameter)
    if failures:
        yield html.heading("Failed jobs")
        yield html.table(("job", "error"), failures)


def _manifest(folder):
    """What was asked, how many jobs are done, and the errors of those that failed."""
    try:
        path = (folder / MANIFEST).absolute().as_uri()
        database = sqlite3.connect(f"{path}?mode=ro", uri=True)
        try:
            rows = database.execute("SELECT name, value FROM question").fetchall()
            (done,) = database.execute("SELECT count(*) FROM job").fetchone()
            failed = "SELECT id, error FROM job WHERE error IS NOT NULL ORDER BY id"
            failures = database.execute(failed).fetchall()
        finally:
            database.close()
    except sqlite3.Error as error:
        raise TssError(f"{str(folder / MANIFEST)!r} cannot be read: {error}") from error
    return {name: json.loads(value) for name, value in rows}, done, failures


def _tables(folder):
    found = {}
    for path in sorted(folder.iterdir()):
        if path.is_dir() and any(path.glob("part-*.parquet")):
            try:
                found[path.name] = pa.parquet.read_table(path)
            except (pa.ArrowInvalid, OSError) as error:
                raise TssError(f"{str(path)!r} cannot be read: {error}") from error
    return found


def _charts(tables, parameter):
    critical = _rows(tables.get(CRITICAL_RATES), "spin_rate_ratio")
    rows = _rows(tables.get(MULTIPLIERS), "verdict")
    if rows:
        own = min({row["method"] for row in rows}, key=lambda method: method == "frozen")
        rows = sorted(
            (row for row in rows if row["method"] == own), key=lambda row: row["spin_rate_ratio"]
        )
    if rows or critical:
        yield html.heading("Verdicts and critical rates")
        systems = sorted({_system(row, parameter) for row in (*rows, *critical)})
        if len(systems) > 1 or not rows:
            yield html.chart(_map(rows, critical, parameter), "map")
        else:
            lines = [(row["spin_rate_ratio"], row["cause"]) for row in critical]
            yield html.chart(moduli(rows, lines), "moduli")
    if family := _rows(tables.get(FAMILIES), "parameter"):
        yield html.heading("Families")
        yield html.chart(_families(family, parameter), "families")
    if MOTIONS in tables:
        yield html.heading("How probably the formation holds")
        yield from _probabilities(tables[MOTIONS])


def _rows(table, needed):
    """Rows of a table that have a value in a column; none where there is no such table."""
    if table is None or needed not in table.column_names:
        return []
    return [row for row in table.to_pylist() if row[needed] not in (None, "")]


def _system(row, parameter):
    value = row.get(parameter)
    if value is None:
        return row.get("scenario", "")
    shown = f"{value:g}" if isinstance(value, float) else value
    return f"{row.get('scenario', '')} {parameter}={shown}"


def _map(rows, critical, parameter):
    """Verdicts and critical rates over the systems or the parameter's values."""
    scenarios = {row["scenario"] for row in (*rows, *critical)}
    values = [row.get(parameter) for row in (*rows, *critical)]
    by_value = len(scenarios) == 1 and all(isinstance(value, float) for value in values)
    found = [row for row in rows if row["verdict"] != "none found"]
    stable = sum(row["verdict"] == "asymptotically stable" for row in found)
    words = [f"{stable} of {len(found)} motions are asymptotically stable"]
    if len(found) < len(rows):
        words.append(f"none found at {len(rows) - len(found)} points")
    drawn = html.figure(
        "; ".join([*words, f"{len(critical)} critical rates"]),
        parameter if by_value else "system", SPIN_RATE_LABEL, 520,
    )  # fmt: skip

    def place(row):
        return row[parameter] if by_value else _system(row, parameter)

    for name, (symbol, colour) in html.VERDICTS.items():
        if here := [row for row in rows if row["verdict"] == name]:
            drawn.add_scatter(
                x=[place(row) for row in here], y=[row["spin_rate_ratio"] for row in here],
                mode="markers", name=name, marker={"symbol": symbol, "color": colour, "size": 7},
                text=[_decided(row) for row in here],
            )  # fmt: skip
    for i, cause in enumerate(sorted({row["cause"] for row in critical})):
        here = [row for row in critical if row["cause"] == cause]
        drawn.add_scatter(
            x=[place(row) for row in here], y=[row["spin_rate_ratio"] for row in here],
            error_y={"array": [row["uncertainty"] for row in here]}, mode="markers",
            name=f"critical: {cause}", text=[row["resonance"] or "" for row in here],
            marker={
                "symbol": ("circle-open", "square-open", "diamond-open", "star-open")[i % 4],
                "color": "#333333", "size": 12, "line": {"width": 2},
            },
        )  # fmt: skip
    if by_value and min(values) > 0 and max(values) >= 20 * min(values):
        drawn.update_xaxes(type="log")
    return drawn


def _families(rows, parameter):
    drawn = html.figure("What decides, along each family", "parameter", "modulus |ρ| [-]", 430)
    systems = {}
    for row in rows:
        systems.setdefault(_system(row, parameter), []).append(row)
    for i, (name, points) in enumerate(systems.items()):
        drawn.add_scatter(
            x=[row["parameter"] for row in points], y=[row["deciding_modulus"] for row in points],
            name=name, mode="lines+markers", line=html.line(i), text=[_decided(r) for r in points],
        )  # fmt: skip
    drawn.add_hline(1.0, line={"color": "#333333", "dash": "dash", "width": 1})
    drawn.update_yaxes(type="log", exponentformat="power")
    return drawn


def _probabilities(motions):
    """How probably disturbed motions hold, push by push, with intervals of confidence."""
    order = [("spin_rate_ratio", "ascending"), ("disturbance_m", "ascending")]
    found = probabilities(motions.sort_by(order))
    title = "Share of disturbed motions that held"
    drawn = html.figure(title, SPIN_RATE_LABEL, "share held [-]", 430)
    for i, push in enumerate(sorted({point.disturbance_m for point in found})):
        points = [point for point in found if point.disturbance_m == push]
        share = [point.probability for point in points]
        drawn.add_scatter(
            x=[point.spin_rate_ratio for point in points], y=share,
            error_y={
                "type": "data", "symmetric": False, "thickness": 1,
                "array": [point.high - point.probability for point in points],
                "arrayminus": [point.probability - point.low for point in points],
            },
            text=[f"{point.held} of {point.held + point.lost} held" for point in points],
            mode="lines+markers", name=f"push {push:g} m", line=html.line(i),
        )  # fmt: skip
    drawn.update_yaxes(range=[-0.03, 1.03])
    yield html.chart(drawn, "held")
    yield html.table(
        ("rate", "push [m]", "held", "lost", "failed", "95 % interval"),
        [
            (
                f"{point.spin_rate_ratio:g}", f"{point.disturbance_m:g}",
                point.held, point.lost, point.failed, f"{point.low:.2%} to {point.high:.2%}",
            )
            for point in found
        ],
    )  # fmt: skip


def _as_table(table, chosen, parameter):
    """Rows of a table; numbers short, what decided in words."""
    short = [field.name for field in table.schema if not pa.types.is_list(field.type)]
    first = ["scenario", *[parameter] * bool(parameter)]
    names = [n for n in (*first, *(chosen or short)) if n in short or n == "decided by"]
    names = list(dict.fromkeys(names))
    if "method" in short:  # the motion's own multipliers before the paper's frozen ones
        table = table.sort_by([("method", "descending")])
    rows = table.slice(0, html.MOST_ROWS + 1).to_pylist()
    cells = [[_cell(row, name) for name in names] for row in rows]
    shown = html.table([name.replace("_", " ") for name in names], cells[: html.MOST_ROWS])
    if len(rows) > html.MOST_ROWS:
        shown += html.note(f"The first {html.MOST_ROWS} of {table.num_rows} rows.")
    return shown


def _decided(row: dict[str, Any]) -> str:
    family, modulus = row.get("deciding_family"), row.get("deciding_modulus")
    if family is None or modulus is None:
        return ""
    closure = row.get("closure_residual")
    return in_words(family, modulus, float("nan") if closure is None else closure)


def _cell(row, name):
    if name == "decided by":
        return _decided(row)
    value = row[name]
    if name == "stable_side" and value:
        return "above" if value > 0 else "below"
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _short(value):
    words = value if isinstance(value, str) else json.dumps(value)
    return words if len(words) <= 200 else f"{words[:200]}..."
