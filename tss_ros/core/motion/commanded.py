"""A motion on which commands act from outside: it goes on from exactly the time of each of them."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tss_ros.core.arguments import checked
from tss_ros.core.errors import Cancelled, TssError
from tss_ros.core.model.commands import Commands
from tss_ros.core.motion import integrate
from tss_ros.core.motion.state import IntegratorState, Samples
from tss_ros.core.motion.step_control import EXPLICIT, IMPLICIT

if TYPE_CHECKING:
    from tss_ros.core.motion.propagator import Integrator


class CommandedMotion:
    """A motion under way, and what acts on it from outside, now and later.

    Parameters
    ----------
    integrator : Integrator
    motion : IntegratorState
        Without variations.
    since_s : float
        [s] when time 0 of the motion is for the axes of forces, `commands.FRAMES`.
    """

    #: Accepted steps between two looks at `cancelled`.
    SLICE = 200

    def __init__(self, integrator: Integrator, motion: IntegratorState, since_s: float) -> None:
        self._free, self._motion, self._since_s = integrator, motion, since_s
        self._plan = []
        self._integrator, self._commands = integrator, Commands.none(integrator.system)
        self._commanded_s = -1.0

    @property
    def integrator_state(self) -> IntegratorState:
        """All that the integrator remembers: write to it what was read, and the motion goes on."""
        return self._motion

    @property
    def time_s(self) -> float:
        """[s] end of the last integration step; samples up to here cost no further steps."""
        return self._motion.time

    @property
    def steps(self) -> int:
        """Accepted integration steps so far."""
        return self._motion.steps

    @property
    def switches(self) -> int:
        """Slack/taut switches so far, Eq. (5)."""
        return self._motion.switches

    @property
    def commands(self) -> Commands:
        """What acts from outside at present."""
        return self._commands

    @property
    def commanded_s(self) -> float:
        """[s] since when it does; -1 before anything has been commanded."""
        return self._commanded_s

    @property
    def plan(self) -> list[tuple[float, Commands]]:
        """What will act from outside, and from which times [s] on, in their order."""
        return [(edge, commands) for edge, commands in self._plan if edge > self._commanded_s]

    def set_commands(self, commands: Commands, commanded_s: float) -> None:
        """Let this act from outside from here on, as it does since a time [s]."""
        if commands != self._commands:
            self._integrator = self._with(commands)
        self._commands, self._commanded_s = commands, commanded_s

    @checked
    def command(self, plan: Sequence[tuple[float, Commands]]) -> None:
        """Say what acts from outside and from when on, in place of all that was to come.

        The motion goes on from exactly these times. States up to one of them are the same as
        without it. While a force acts, all steps are implicit.

        Parameters
        ----------
        plan : sequence of (float, Commands)
            Times [s], increasing, none before the start of the last step taken. What came into
            effect before may be among them.

        Raises
        ------
        TssError
            If times do not increase or lie in the past, if commands do not fit the system, or if a
            force is to act where only explicit steps are allowed.
        """
        last, kept = -math.inf, []
        for edge, commands in plan:
            if not last < edge < math.inf:
                raise TssError(f"times of commands must be finite and increase, got {edge:g} s")
            last = float(edge)
            if last > self._commanded_s:
                kept.append((last, commands.checked(self._free.system)))
                self._with(kept[-1][1])
        begun = float(self._motion.progress["step_start"][0])
        if kept and kept[0][0] < begun:
            raise TssError(
                f"commands must not lie before {begun:g} s, where the last step began,"
                f" got {kept[0][0]:g}"
            )
        self._plan = kept

    def _with(self, commands):
        """The integrator with these commands."""
        free = self._free
        if commands.pushes and free.settings.kind == EXPLICIT:
            raise TssError("integrator 'taylor' bears no forces of thrusters: choose auto or radau")
        other = copy.copy(free)
        other.arrays = commands.in_arrays(free.arrays, free.system, free.spin, self._since_s)
        if commands.pushes:
            other.settings = free.settings._replace(kind=IMPLICIT)
        other._table = None
        return other

    def _advance_through(
        self, samples: Samples, cancelled: Callable[[], bool] | None = None
    ) -> None:
        """Advance to the end of the step that covers these times, with all that is to come."""
        times, first = samples.times, 0
        for edge, commands in self.plan:
            if not times.size or edge >= times[-1]:
                break
            if commands != self._commands:
                count = int(np.searchsorted(times, edge, side="right"))
                self._cover(Samples(*(part[first:count] for part in samples)), cancelled)
                self._go_to(edge, cancelled)
                cut = not np.array_equal(commands.cut, self._commands.cut)
                self.set_commands(commands, edge)
                if cut:
                    self._set_modes()
                first = count
        self._cover(Samples(*(part[first:] for part in samples)), cancelled)

    def _cover(self, samples, cancelled):
        self._motion.progress["sampled"] = 0
        while not self._integrator.advance(self._motion, steps=self.SLICE, samples=samples):
            if cancelled is not None and cancelled():
                raise Cancelled(f"stopped at {self.time_s:g} s")

    def _go_to(self, edge, cancelled):
        """Let a step end at a time; the one that was made without knowing of it is taken back."""
        integrator, motion = self._integrator, self._motion
        self._cover(integrator.samples(np.array([edge])), cancelled)
        if self.time_s > edge:
            integrate.take_back(integrator.arrays, integrator.tables, motion)
            integrator.advance(motion, stop=edge)
        if self._free.settings.kind != EXPLICIT:
            motion.progress["next_kind"] = IMPLICIT

    def _set_modes(self):
        """Set the modes of tethers anew, as some of them have been cut."""
        motion, room = self._motion, np.empty((2, self._motion.taut.size))
        integrate.set_modes(self._integrator.arrays, motion, motion.v, motion.r, *room)
