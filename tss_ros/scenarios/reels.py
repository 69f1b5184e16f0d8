"""Reels in a scenario: how much of its tethers is out as a run begins, and what is flown then.

    deployed_m: 100.0
    reels:
      all: {time_s: [0.0, 6000.0], length_m: [100.0, 10000.0]}

Both may be given for all tethers, or as a mapping by names of whole tethers. `deployed_m` is what
is out at time 0, the first length of its profile if it is not given, and all of a tether without a
profile. Between the points of a profile are straight lines, or cubics if it has `rate_m_s`. It is
flown unless another command to its reel comes.

Instead of profiles all reels may follow the tension of their tethers, `core.model.laws.reel`:

    reel_damping_n_s_per_m: 1000.0
    reel_sample_s: 2.0

With `reel_sample_s` a controller does that which measures so often, and commands the rate until the
next time; then lengths may be out in part. Without it the law acts all the time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tss_ros.core import System, TssError
from tss_ros.core.arguments import finite
from tss_ros.core.model.reel_plans import reel_profile
from tss_ros.core.model.reels import deployed_lengths, reel_index, reel_names
from tss_ros.scenarios.files import check_keys

#: The keys of a scenario.
KEYS = ("deployed_m", "reels", "reel_sample_s")
#: What stands for every tether.
ALL = "all"
#: How far a profile may begin from what is out [m].
CONTINUOUS_M = 1e-6


class Profile(NamedTuple):
    """A rest length [m] at times [s], and its rates [m/s]; without these it follows lines."""

    time_s: tuple[float, ...]
    length_m: tuple[float, ...]
    rate_m_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class Reels:
    """What a scenario says of its reels, by names of whole tethers or `ALL`.

    Attributes
    ----------
    deployed_m : dict of str to float
    profiles : dict of str to Profile
    sample_s : float or None
        [s] between two samples of the law of reels; None: it acts all the time, if there is one.
    """

    deployed_m: Mapping[str, float]
    profiles: Mapping[str, Profile]
    sample_s: float | None = None

    def of(self, system: System) -> tuple[np.ndarray, dict[int, Profile]]:
        """What is out of each whole tether at time 0 [m], and profiles by index into `reels`.

        Raises
        ------
        TssError
            If there is no tether of a name, if a length is not allowed, or if a profile begins at
            another length than is out.
        """
        profiles = {reel_index(system, name): p for name, p in _each(system, self.profiles)}
        names = reel_names(system)
        begun = {names[place]: profile.length_m[0] for place, profile in profiles.items()}
        lengths = deployed_lengths(system, begun | dict(_each(system, self.deployed_m)))
        for place, profile in profiles.items():
            if abs(profile.length_m[0] - lengths[place]) > CONTINUOUS_M:
                raise TssError(
                    f"reels: profile of {names[place]} begins with {profile.length_m[0]:g} m;"
                    f" allowed: {lengths[place]:g} m, which deployed_m says is out"
                )
        return lengths, profiles


def read_reels(content: Mapping[str, Any]) -> Reels | None:
    """What the content of a scenario file says; None if nothing.

    Raises
    ------
    TssError
        Naming the key, its value and what is allowed.
    """
    if not any(key in content for key in KEYS):
        return None
    deployed, profiles = (content.get(key, {}) for key in KEYS[:2])
    if not isinstance(deployed, dict):
        deployed = {ALL: deployed}
    lengths = {
        str(name): finite(f"deployed_m of {name}", value, above=0.0)
        for name, value in deployed.items()
    }
    if not isinstance(profiles, dict):
        raise TssError(
            f"reels must be a mapping of tethers, or {ALL}, to profiles, got {profiles!r:.80}"
        )
    flown = {str(name): _profile(name, entry) for name, entry in profiles.items()}
    sample_s = content.get(KEYS[2])
    if sample_s is not None:
        sample_s = finite(KEYS[2], sample_s, above=0.0)
    return Reels(lengths, flown, sample_s)


def _profile(name, entry):
    where = f"reels.{name}"
    check_keys(where, entry, {"time_s", "length_m"}, {"rate_m_s"})
    columns = []
    for key, values in entry.items():
        if not isinstance(values, list):
            raise TssError(f"{where}.{key} must be a list of numbers, got {values!r:.80}")
        bounds = {} if key == "rate_m_s" else {"at_least": 0.0}
        columns.append((key, tuple(finite(f"{where}.{key}", value, **bounds) for value in values)))
    profile = Profile(**dict(columns))
    try:
        reel_profile(profile.time_s, profile.length_m, profile.rate_m_s or None)
    except TssError as error:
        raise TssError(f"{where}: {error}") from None
    return profile


def _each(system, values):
    """Names of single tethers and their values; a name of its own goes before `ALL`."""
    if ALL in values:
        values = dict.fromkeys(reel_names(system), values[ALL]) | values
    return [(name, value) for name, value in values.items() if name != ALL]
