"""Reels that follow the tension of their tethers, as a controller makes them that samples.

    c L' = T - T_0 - k (L - L_0)

This is `core.model.laws.reel` without the inertia of the drum, which such a controller masters. At
every sample it measures the tension T next to a reel and the length L out, and commands the rate
that holds until the next one. Its commands are commands like all others: they are limited, told
and kept. A command from elsewhere takes its reel from the law.
"""

from __future__ import annotations

import math

import numpy as np

from tss_ros.core import TssError
from tss_ros.core.model.laws.reel import REEL_DAMPING, REEL_STIFFNESS, REEL_TENSION
from tss_ros.core.model.reel_law import reel_tension_n
from tss_ros.core.model.reels import deployed_system, reel_names, reels
from tss_ros.messages.steps import States
from tss_ros.simulator.commands import CommandTable
from tss_ros.simulator.reel_commands import (
    MAX_RATE_M_S,
    MIN_RATE_M_S,
    RATE,
    Limits,
    ReelCommand,
)
from tss_ros.simulator.setup import Setup


class ReelLaw:
    """The law of all reels of a run. Without one it never samples.

    Parameters
    ----------
    setup : Setup
        What the run begins with: L_0 is what is out then. T_0 is the steady tension next to each
        reel there if none is given, as `core.model.reel_law` has it.
    acts : bool
        Whether it acts, where the setup has one.

    Attributes
    ----------
    left : int or inf
        States to come up to the one that is sampled next, that one included.
    limits : Limits
        Of its commands.
    """

    def __init__(self, setup: Setup, acts: bool = True) -> None:
        self._system, start = setup.system, setup.reels
        self._samples = bool(start and start.every and acts)
        self.left, self.limits = math.inf, Limits()
        if self._samples:
            values = setup.system.law_parameters
            self._damping, self._stiffness, aim_n = (
                values[p.name] for p in (REEL_DAMPING, REEL_STIFFNESS, REEL_TENSION)
            )
            self.left, self._every, self._begun_m = 1, start.every, start.length_m
            self.limits = Limits.of(setup.options)
            self._aim_n = [aim_n] * len(start.length_m) if aim_n else self._steady_n(setup)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All that it remembers, for a snapshot."""
        counts = [self.left] if self._samples else []
        return {"law_left": np.array(counts, dtype=np.int64)}

    def resume(self, arrays: dict[str, np.ndarray], limits: Limits) -> None:
        """Go on where another one was.

        Raises
        ------
        TssError
            If what that remembered does not fit.
        """
        left, own = arrays["law_left"].tolist(), self._samples
        if len(left) != own or not all(1 <= count <= self._every for count in left):
            raise TssError(f"its law of reels has {left!r:.80} states to go")
        if own:
            self.left, self.limits = left[0], limits

    def look(self, table: CommandTable, states: States) -> bool:
        """Let states pass; post what follows from the last of them if that is to be sampled.

        Parameters
        ----------
        table : CommandTable
        states : States
            Those that follow the ones before, not more than are left.

        Returns
        -------
        bool
            Whether something has been posted.
        """
        self.left -= len(states.time_ns)
        if self.left > 0:
            return False
        self.left = self._every
        time_ns = int(states.time_ns[-1])
        out_m = table.at(time_ns).lengths_out(time_ns / 1e9)[0]
        tension_n = states.tension_n[-1, self._next_to_reels(out_m)].tolist()
        posted = False
        for place, length_m in enumerate(out_m.tolist()):
            if not table.reels.follows_law(place, time_ns):
                continue
            back_n = self._stiffness * (length_m - self._begun_m[place])
            rate = (tension_n[place] - self._aim_n[place] - back_n) / self._damping
            rate = max(-MAX_RATE_M_S, min(rate, MAX_RATE_M_S))
            point = (0.0, 0.0, rate if abs(rate) >= MIN_RATE_M_S else 0.0)
            table.post(ReelCommand(time_ns, place, RATE, (point,), self.limits, from_law=True))
            posted = True
        return posted

    def _steady_n(self, setup):
        """Steady tension [N] next to each reel as the run begins."""
        length_m = setup.reels.length_m
        out, _ = deployed_system(setup.system, dict(zip(reel_names(setup.system), length_m)))
        return reel_tension_n(out, setup.spin_rate_ratio).tolist()

    def _next_to_reels(self, out_m):
        """Which segments are next to their reels."""
        lines = zip(reels(self._system), out_m)
        return [reel.segments[-reel.segments_out(length_m)] for reel, length_m in lines]
