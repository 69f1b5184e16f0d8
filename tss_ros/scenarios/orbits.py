"""Orbits of real satellites: two-line elements, and positions and velocities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta, timezone
from typing import Any

from tss_ros import core
from tss_ros.core import TssError
from tss_ros.core.presentation import found
from tss_ros.scenarios import files

#: Keys of a scenario that say what the orbit is instead of its elements.
KEYS = ("two_line_elements", "orbit_state")


def read_epoch(text: object) -> datetime | None:
    """The moment that a text names, None for an empty one.

    Parameters
    ----------
    text : str
        UTC as 2026-11-27T12:00:00Z; other offsets are taken into account.

    Raises
    ------
    TssError
        If it names none.
    """
    if text == "":
        return None
    try:
        moment = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    except (AttributeError, ValueError):
        moment = text if isinstance(text, datetime) else None
    if moment is None:
        raise TssError(f"epoch is {text!r:.80}; allowed: date and time as 2026-11-27T12:00:00Z")
    return moment.astimezone(timezone.utc) if moment.tzinfo else moment.replace(tzinfo=timezone.utc)


def epoch_text(moment: datetime) -> str:
    """A moment as `read_epoch` reads it, to the microsecond."""
    text = moment.astimezone(timezone.utc).replace(tzinfo=None).isoformat(timespec="microseconds")
    return f"{text.rstrip('0').rstrip('.')}Z"


def elements_of_two_lines(lines: Sequence[str]) -> dict[str, Any]:
    """The osculating orbit at the epoch of two-line elements, by the SGP4 theory.

    Parameters
    ----------
    lines : sequence of str
        The two lines, or three of which the first is a name.

    Returns
    -------
    dict
        Parameters of a scenario by name: `orbit_altitude_m` of the perigee, the other elements, and
        `epoch`. They refer to the true equator and mean equinox of the epoch (TEME).

    Raises
    ------
    TssError
        If these are no two-line elements, or the orbit is none that a scenario may have.
    """
    sgp4 = found("sgp4.api", "two_line_elements")
    if isinstance(lines, str):
        lines = lines.splitlines()
    try:
        one, two = (line.strip() for line in list(lines)[-2:])
        for number, line in (("1", one), ("2", two)):
            if not line.startswith(f"{number} ") or len(line) != 69:
                raise ValueError(f"line {number} is {line!r:.80}")
            if _checksum(line) != int(line[68]):
                raise ValueError(f"line {number} has checksum {line[68]}, not {_checksum(line)}")
        satellite = sgp4.Satrec.twoline2rv(one, two)
    except (AttributeError, TypeError, ValueError) as error:
        raise TssError(
            f"two_line_elements must be two lines of 69 characters, 1 ... and 2 ...: {error}"
        ) from None
    error, position_km, velocity_km_s = satellite.sgp4(satellite.jdsatepoch, satellite.jdsatepochF)
    if error:
        reason = sgp4.SGP4_ERRORS.get(error, f"error {error}")
        raise TssError(f"two_line_elements give no orbit at their epoch: {reason}")
    days = satellite.jdsatepoch - 2451545.0, satellite.jdsatepochF
    moment = datetime(2000, 1, 1, 12, tzinfo=timezone.utc) + sum(map(_days, days), timedelta())
    elements = core.orbit_elements([1e3 * x for x in position_km], [1e3 * x for x in velocity_km_s])
    return {**elements, "epoch": epoch_text(moment)}


def given(content: Mapping[str, Any]) -> dict[str, Any]:
    """The elements of the orbit that a scenario states by one of `KEYS`.

    Parameters
    ----------
    content : mapping
        A scenario file's.

    Returns
    -------
    dict
        Parameters by name; empty if it has none of the keys.

    Raises
    ------
    TssError
        If it states the orbit twice, or one that it may not have.
    """
    keys = [key for key in KEYS if key in content]
    if not keys:
        return {}
    if len(keys) > 1:
        raise TssError(f"{' and '.join(keys)} both state the orbit; allowed: one of them")
    (key,) = keys
    if key == "two_line_elements":
        stated = elements_of_two_lines(content[key])
    else:
        files.check_keys(key, content[key], {"position_m", "velocity_m_s"})
        stated = core.orbit_elements(content[key]["position_m"], content[key]["velocity_m_s"])
    for name in stated:
        if name in content:
            raise TssError(f"{key} and {name} both state the orbit; allowed: one of them")
    return stated


def _days(days: float) -> timedelta:
    return timedelta(days=days)


def _checksum(line: str) -> int:
    """The last digit that a line should have: the sum of its digits, a minus sign counting 1."""
    return sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10
