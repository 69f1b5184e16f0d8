"""Plans of reels: rest lengths over time, as commands that follow each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PPoly

from tss_ros.core.arguments import checked, numbers
from tss_ros.core.errors import TssError
from tss_ros.core.model.commands import Commands
from tss_ros.core.model.reels import reel_index
from tss_ros.core.model.system import System


@checked
def reel_profile(
    time_s: Sequence[float],
    length_m: Sequence[float],
    rate_m_s: Sequence[float] | None = None,
) -> PPoly:
    """A rest length over time: straight lines between points, or cubics if rates are given.

    Parameters
    ----------
    time_s : sequence of float
        [s], increasing, two or more.
    length_m : sequence of float
        [m] at these times.
    rate_m_s : sequence of float, optional
        [m/s] there.

    Returns
    -------
    scipy.interpolate.PPoly

    Raises
    ------
    TssError
        If there are too few points, or if they are not finite or times do not increase.
    """
    given = {"time_s": time_s, "length_m": length_m}
    if rate_m_s is not None:
        given["rate_m_s"] = rate_m_s
    arrays = {name: numbers(name, values) for name, values in given.items()}
    times = arrays["time_s"]
    for name, values in arrays.items():
        if values.ndim != 1 or values.size != times.size or values.size < 2:
            raise TssError(
                f"{name} must have as many values as time_s, 2 or more, got shape {values.shape}"
            )
        if not np.isfinite(values).all():
            raise TssError(f"{name} must be finite, got {values!r:.80}")
    if not (np.diff(times) > 0.0).all():
        raise TssError(f"time_s must increase, got {times!r:.80}")
    lengths = arrays["length_m"]
    if rate_m_s is not None:
        return CubicHermiteSpline(times, lengths, arrays["rate_m_s"])
    return PPoly(np.stack([np.diff(lengths) / np.diff(times), lengths[:-1]]), times)


@checked
def reel_plan(
    system: System, profiles: Mapping[str, PPoly], commands: Commands | None = None
) -> list[tuple[float, Commands]]:
    """What reels do over time, for `Propagator`.

    Before a profile begins its tether has the rest length that it begins with, after its end the
    one that it ends with.

    Parameters
    ----------
    system : System
    profiles : dict of str to scipy.interpolate.PPoly
        Rest length [m] over time [s] by name of a whole tether: straight lines or up to cubics,
        as of `reel_profile` or of SciPy's interpolators.
    commands : Commands, optional
        What else acts meanwhile: forces, cut tethers, other reels.

    Returns
    -------
    list of (float, Commands)
        The first one at 0, or at the beginning of a profile that is earlier.

    Raises
    ------
    TssError
        If there is no such tether, or if a profile has a higher degree than 3.
    """
    places = {name: reel_index(system, name) for name in profiles}
    for name, profile in profiles.items():
        if profile.c.ndim != 2 or profile.c.shape[0] > 4:
            raise TssError(
                f"profile of {name} must be one cubic after another, got coefficients of shape"
                f" {profile.c.shape}"
            )
    plan = []
    for edge in sorted({0.0} | {float(t) for profile in profiles.values() for t in profile.x}):
        acting = (commands or Commands.none(system)).checked(system)
        for name, profile in profiles.items():
            acting.reel[places[name]] = _row(profile, edge)
        plan.append((edge, acting))
    return plan


def rests_over(
    system: System,
    plan: Sequence[tuple[float, Commands]],
    times_s: np.ndarray,
    yielding: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Rest lengths of all segments over time, as a plan makes them.

    Parameters
    ----------
    system : System
    plan : sequence of (float, Commands)
        What acts from outside, and after which times [s].
    times_s : ndarray, shape (k,)
        Increasing.
    yielding : tuple of two ndarray, shape (k, m), optional
        Rest lengths [m] and rates [m/s] there where those next to reels are states.

    Returns
    -------
    rest_length_m, rest_rate_m_s : ndarray, shape (k, m)
        [m] and [m/s]; both are 0 for segments that are on a reel or cut.
    """
    rests = Commands.none(system).rests(system, times_s) if yielding is None else yielding
    firsts = np.searchsorted(times_s, [edge for edge, _ in plan], side="right").tolist()
    for (_, commands), first, end in zip(plan, firsts, [*firsts[1:], times_s.size]):
        if first == end:
            continue
        for part, values in zip(rests, commands.rests(system, times_s[first:end])):
            if yielding is None:
                part[first:end] = values
            part[first:end, commands.cut] = 0.0
    return rests


def _row(profile, time_s):
    """A profile from a time [s] on, as `Commands.reel` has it."""
    row, piece = np.zeros(5), np.searchsorted(profile.x, time_s, side="right") - 1
    if 0 <= piece < profile.x.size - 1:
        row[0] = profile.x[piece]
        row[1 : 1 + profile.c.shape[0]] = profile.c[::-1, piece]
    else:
        row[:2] = profile.x[0 if piece < 0 else -1], profile(profile.x[0 if piece < 0 else -1])
    return row
