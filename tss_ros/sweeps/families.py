"""Families of motions on disk, and curves of special points.

The points are a Parquet table; what else there is to say is in its metadata.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from tss_ros.core import (
    CurvePoint,
    Family,
    FamilyPoint,
    SpecialCurve,
    SpecialPoint,
    State,
    TssError,
)
from tss_ros.core.model.configurations import InitialState
from tss_ros.core.stability.branches import BRANCH_KINDS
from tss_ros.sweeps.jobs import cells_of, columns_of, kinds_of
from tss_ros.sweeps.store import TYPES

#: Metadata of files, and what is in their rows.
_KEYS = {Family: b"tss_ros.family", SpecialCurve: b"tss_ros.special_curve"}
_ROWS = {Family: FamilyPoint, SpecialCurve: CurvePoint}


def save(
    found: Family | SpecialCurve, path: str | Path, about: Mapping[str, Any] | None = None
) -> None:
    """Write a family or a curve to a file that any reader of Parquet opens; it appears as a whole.

    Parameters
    ----------
    found : Family or SpecialCurve
    path : str or Path
    about : mapping, optional
        What else there is to say, as JSON can; `load_about` gives it back.
    """
    made = type(found)
    schema = pa.schema([(name, TYPES[kind]) for name, kind in columns_of(_ROWS[made]).items()])
    told = {f.name: getattr(found, f.name) for f in fields(found) if f.name != "points"}
    if made is Family:
        told["special"] = [
            {name: None if value != value else value for name, value in cells_of(point).items()}
            for point in found.special
        ]
    told["about"] = dict(about or {})
    table = pa.Table.from_pylist(
        [cells_of(point) for point in found.points],
        schema.with_metadata({_KEYS[made]: json.dumps(told).encode()}),
    )
    path = Path(path)
    new = path.with_name(f".{path.name}.new")
    try:
        pa.parquet.write_table(table, new, compression="zstd")
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)


def load(path: str | Path) -> Family:
    """A family that was saved.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Family

    Raises
    ------
    TssError
        If there is no such file, or it holds no family.
    """
    points, told = _loaded(path, Family)
    special = tuple(_made(SpecialPoint, row) for row in told["special"])
    return Family(told["parameter"], points, special, told["ended"], told.get("turns", 1))


def load_curve(path: str | Path) -> SpecialCurve:
    """A curve of special points that was saved; errors as for `load`."""
    points, told = _loaded(path, SpecialCurve)
    return SpecialCurve(told["kind"], told["parameter"], told["second"], points, told["ended"])


def load_about(path: str | Path) -> dict[str, Any]:
    """What else was said of a family or a curve when it was saved; errors as for `load`."""
    return _read(path)[1]["about"]


def branch_from(path: str | Path, parameter: str, value: float) -> SpecialPoint:
    """The point of a saved family where another one crosses, next to a value of its parameter.

    Parameters
    ----------
    path : str or Path
    parameter : str
        The family's own.
    value : float

    Returns
    -------
    SpecialPoint

    Raises
    ------
    TssError
        As for `load`, or if the family has no such point or was followed in another parameter.
    """
    family = load(path)
    if parameter != family.parameter:
        raise TssError(
            f"start {str(path)!r} was followed in {family.parameter}, so its branches are not"
            f" followed in {parameter}"
        )
    points = [point for point in family.special if point.kind in BRANCH_KINDS]
    if not points:
        raise TssError(f"start {str(path)!r} holds no {' and no '.join(BRANCH_KINDS)}")
    return min(points, key=lambda point: abs(point.parameter - value))


def start_from(path: str | Path, parameter: str, value: float) -> State:
    """The motion of a saved family next to a value of its parameter.

    Parameters
    ----------
    path : str or Path
    parameter : str
        The family's own is meant, or "spin_rate_ratio".
    value : float

    Returns
    -------
    State

    Raises
    ------
    TssError
        As for `load`, or if the family has no points or was followed in another parameter.
    """
    family = load(path)
    if parameter not in (family.parameter, "spin_rate_ratio"):
        raise TssError(
            f"start {str(path)!r} was followed in {family.parameter}, which says nothing of"
            f" {parameter}"
        )
    if not family.points:
        raise TssError(f"start {str(path)!r} holds no motion")
    name = "parameter" if parameter == family.parameter else parameter
    near = min(family.points, key=lambda point: abs(getattr(point, name) - value))
    state = near.state
    return InitialState(state.position_m, state.velocity_m_s, str(path))


def _read(path):
    try:
        with Path(path).open("rb") as file:
            table = pa.parquet.read_table(file)
    except (OSError, pa.ArrowException) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise TssError(f"family {str(path)!r} cannot be read: {reason}") from None
    metadata = table.schema.metadata or {}
    for made, key in _KEYS.items():
        if key in metadata:
            return table, json.loads(metadata[key]) | {"made": made}
    raise TssError(f"{str(path)!r} is a Parquet table that holds no family")


def _loaded(path, made):
    """Points of a file, and what else it says, if it holds a family or a curve as it should."""
    table, told = _read(path)
    if told["made"] is not made:
        words = {Family: "a family", SpecialCurve: "a curve of special points"}
        raise TssError(f"{str(path)!r} holds {words[told['made']]}, not {words[made]}")
    return tuple(_made(_ROWS[made], row) for row in table.to_pylist()), told


def _made(result, row):
    """An object of a class from a row that `cells_of` made of one."""
    values, known = {}, {f.name for f in fields(result) if f.default is not MISSING}
    for name, kind in kinds_of(result).items():
        if name in known - row.keys():
            continue  # written before there was such a field
        if kind is State:
            arrays = (np.reshape(row[n], (-1, 3)) for n in ("position_m", "velocity_m_s"))
            values[name] = State(*arrays)
        elif kind is complex or name == "multiplier":
            parts = [row[f"{name}_real"], row[f"{name}_imag"]]
            if kind is complex:
                values[name] = complex(*(math.nan if part is None else part for part in parts))
            else:
                values[name] = np.array(parts[0]) + 1j * np.array(parts[1])
        else:
            values[name] = math.nan if row[name] is None else row[name]
    return result(**values)
