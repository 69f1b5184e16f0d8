"""A motion on which commands act from outside: it goes on from exactly the time of each of them."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tss_ros.core.arguments import checked
from tss_ros.core.errors import Cancelled, TssError
from tss_ros.core.model import forces
from tss_ros.core.model.commands import Commands
from tss_ros.core.model.feedback import with_feedback
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.model.laws.feedback import SHAPE_KEEPING
from tss_ros.core.model.orbits import reference_orbit
from tss_ros.core.model.reel_law import rests_in_rows, what_yields
from tss_ros.core.model.reels import deployment, pay_out, reels
from tss_ros.core.model.system import State, System
from tss_ros.core.motion import integrate
from tss_ros.core.motion.state import IntegratorState, Samples, velocities_and_positions
from tss_ros.core.motion.step_control import ANY_STEP, EXPLICIT, IMPLICIT

if TYPE_CHECKING:
    from tss_ros.core.motion.integrator import Integrator


def commanded_acceleration(
    system: System, spin_rate_ratio: float, commands: Commands, time_s: float, state: State
) -> np.ndarray:
    """Accelerations of all beads as seen from the orbit frame, with all that acts.

    Parameters
    ----------
    system : System
    spin_rate_ratio : float
        w = omega / Omega that feedback and spinning axes of forces have.
    commands : Commands
    time_s : float
        [s] when the state is there.
    state : State

    Returns
    -------
    ndarray, shape (n, 3)
        [m/s^2]
    """
    spin, part = system.spin_rate_rad_s(spin_rate_ratio), commands.part_out(system, time_s)
    v, r = velocities_and_positions(system, state)
    rows = np.append(part.beads, np.arange(system.n, len(r)))
    v, r = v[rows], r[rows]
    orbit = None if system.autonomous else reference_orbit(part.system)
    # Without spin the turning frame of the forces is the orbit frame.
    arrays = orbit.arrays(0.0) if orbit else kernel_arrays(part.system, 0.0)
    arrays = with_feedback(arrays, part.system, spin)
    arrays = commands.in_arrays(arrays, part, spin, time_s=time_s)
    n = part.system.n
    rests = tuple(x[part.segments] for x in commands.rests(system, time_s))
    if len(r) > n:
        rests = rests_in_rows(system, v, r)
    taut = forces.tether_state(part.system, r[:n], v[:n], rests)
    cut = commands.cut[part.segments]
    taut = (taut[2] | system.bilateral) & ~cut & (system.law.pushes | (taut[1] > 0.0))
    if orbit:
        return orbit.relative_acceleration(time_s, taut, v, r, arrays)[part.carrier]
    a = np.empty_like(r)
    forces.acceleration(arrays, taut, time_s, v, r, a)
    return a[part.carrier]


class _Leg(NamedTuple):
    """Commands from a time [s] on, and how many segments of each whole tether are out then."""

    edge: float
    commands: Commands
    out: tuple[int, ...]


class CommandedMotion:
    """A motion under way, and what acts on it from outside, now and later.

    Beads on a reel ride with their satellite; those that are out are integrated.

    Parameters
    ----------
    make : callable
        Makes the `Integrator` of a system.
    system : System
    state : State
        At time 0, in the orbit frame.
    plan : sequence of (float, Commands)
        What acts, and from which times [s] on; of those up to 0 the last one counts.
    since_s : float
        [s] when time 0 of the motion is for the axes of forces, `commands.FRAMES`.
    """

    #: Accepted steps between two looks at `cancelled`.
    SLICE = 200

    def __init__(
        self,
        make: Callable[[System], Integrator],
        system: System,
        state: State,
        plan: Sequence[tuple[float, Commands]],
        since_s: float,
    ) -> None:
        self._make, self._system, self._since_s = make, system, since_s
        self._integrators, self._first_step_s = {}, 0.0
        v, r = velocities_and_positions(system, state)
        begun = [commands for edge, commands in plan if edge <= 0.0]
        commands = begun[-1].checked(system) if begun else Commands.none(system)
        later = min((edge for edge, _ in plan if edge > 0.0), default=math.inf)
        self._base = _Leg(-1.0, commands, commands.hand_overs(system, 0.0, later)[0][1])
        self._integrator, self._plan = self._with(self._base), []
        beads = self._part.beads
        if beads.size < system.n:
            state = State(r[beads], v[beads])
        self._motion = self._integrator.begin(state)
        self.command([(edge, commands) for edge, commands in plan if edge > 0.0])
        self._first_step_s = float(self._motion.progress["implicit_size"][0])

    @property
    def integrator_state(self) -> IntegratorState:
        """All that the integrator remembers: write to it what was read, and the motion goes on."""
        return self._motion

    @property
    def blank_state(self) -> IntegratorState:
        """Room for all that the integrator remembers with nothing on a reel."""
        return self._free(tuple(len(reel.segments) for reel in reels(self._system)))[1].blank()

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
        return self._base.commands

    @property
    def commanded_s(self) -> float:
        """[s] since when it does, or since a bead left its reel; -1 before anything has changed."""
        return self._base.edge

    @property
    def segments_out(self) -> tuple[int, ...]:
        """Segments of each whole tether, `reels.reels`, that are not on its reel."""
        return self._base.out

    @property
    def plan(self) -> list[tuple[float, Commands]]:
        """What will act from outside, and from which times [s] on, in their order."""
        return [leg[:2] for leg in self._plan if leg.edge > self._base.edge]

    def set_commands(
        self, commands: Commands, commanded_s: float, segments_out: Sequence[int]
    ) -> None:
        """Let this act from outside from here on, as it does since a time [s].

        Room for another motion is made: its state must be written to `integrator_state` then.
        """
        self._base = _Leg(commanded_s, commands, tuple(segments_out))
        self._integrator, self._plan = self._with(self._base), []
        self._motion = self._integrator.blank()

    @checked
    def command(self, plan: Sequence[tuple[float, Commands]]) -> None:
        """Say what acts from outside and from when on, in place of all that was to come.

        The motion goes on from exactly these times. States up to one of them are the same as
        without it. While a force acts or a reel moves, all steps are implicit. A reel that the
        last commands would have take in all of its tether stops at `reels.SHORTEST_M`.

        Parameters
        ----------
        plan : sequence of (float, Commands)
            Times [s], increasing, none before the start of the last step taken. What came into
            effect before may be among them.

        Raises
        ------
        TssError
            If times do not increase or lie in the past, if commands do not fit the system, if a
            rest length would jump or a reel would take in all of its tether, or if something is to
            act that the integrator or the feedback does not allow.
        """
        last, kept = -math.inf, []
        for edge, commands in plan:
            if not last < edge < math.inf:
                raise TssError(f"times of commands must be finite and increase, got {edge:g} s")
            last = float(edge)
            if last > self._base.edge:
                kept.append((last, commands.checked(self._system)))
        begun = float(self._motion.progress["step_start"][0])
        if kept and kept[0][0] < begun:
            raise TssError(
                f"commands must not lie before {begun:g} s, where the last step began,"
                f" got {kept[0][0]:g}"
            )
        self._plan = self._legs(kept)

    def _legs(self, kept):
        """All changes to come: those of commands, and those where beads leave reels."""
        system, legs, before = self._system, [], self._base.commands
        begun = max(self._base.edge, 0.0)
        edges = [(begun, before), *kept]
        edges[-1:] = edges[-1][1].reels_that_stop(edges[-1][0])
        edges.append((math.inf, None))
        for (edge, commands), (until, _) in zip(edges, edges[1:]):
            self._check(commands)
            commands.check_reels(system, before, edge, until)
            legs += [_Leg(t, commands, out) for t, out in commands.hand_overs(system, edge, until)]
            before = commands
        return legs[1:]  # the first is what acts already

    def _check(self, commands):
        """Raise TssError if something acts that the integrator or the feedback does not allow."""
        pushes = commands.pushes
        explicit = self._free(self._base.out)[1].settings.kind == EXPLICIT
        if explicit and (pushes or commands.unreels):
            what = "forces of thrusters" if pushes else "reels that move"
            raise TssError(f"integrator 'taylor' bears no {what}: choose auto or radau")
        if commands.all_out(self._system):
            return
        if self._system.law_parameters[SHAPE_KEEPING.name]:
            raise TssError(f"{SHAPE_KEEPING.name} keeps one shape, but a rest length is to change")
        if words := what_yields(self._system):
            raise TssError(
                f"{words} moves the reels, but a command is to change a rest length; allowed:"
                " commands that leave all tethers as built"
            )

    def _with(self, leg):
        """The integrator of a leg."""
        part, free = self._free(leg.out)
        other = copy.copy(free)
        other.arrays = leg.commands.in_arrays(
            free.arrays, part, free.spin, since_s=self._since_s, time_s=max(leg.edge, 0.0)
        )
        if leg.commands.pushes or leg.commands.unreels:
            other.settings = free.settings._replace(kind=IMPLICIT)
        other._table = None
        return other

    def _free(self, out):
        """What is out of the reels, and its integrator without commands."""
        if out not in self._integrators:
            part = deployment(self._system, out)
            self._integrators[out] = part, self._make(part.system)
        return self._integrators[out]

    @property
    def _part(self):
        return self._free(self._base.out)[0]

    def _advance_through(
        self, samples: Samples, cancelled: Callable[[], bool] | None = None
    ) -> None:
        """Advance to the end of the step that covers these times, with all that is to come."""
        times, first = samples.times, 0
        for leg in [leg for leg in self._plan if leg.edge > self._base.edge]:
            if not times.size or leg.edge >= times[-1]:
                break
            if leg[1:] != self._base[1:]:
                count = int(np.searchsorted(times, leg.edge, side="right"))
                self._cover(Samples(*(part[first:count] for part in samples)), cancelled)
                self._go_to(leg.edge, cancelled)
                self._change(leg)
                first = count
        self._cover(Samples(*(part[first:] for part in samples)), cancelled)

    def _cover(self, samples, cancelled):
        """Advance through times, and write the states of all beads."""
        part = self._part
        if part.system is self._system:
            self._run(samples, cancelled)
            return
        out = self._integrator.samples(samples.times)
        self._run(out, cancelled)
        samples.v[:], samples.r[:] = out.v[:, part.carrier], out.r[:, part.carrier]

    def _run(self, samples, cancelled):
        self._motion.progress["sampled"] = 0
        while not self._integrator.advance(self._motion, steps=self.SLICE, samples=samples):
            if cancelled is not None and cancelled():
                raise Cancelled(f"stopped at {self.time_s:g} s")

    def _go_to(self, edge, cancelled):
        """Let a step end at a time; the one that was made without knowing of it is taken back."""
        integrator, motion = self._integrator, self._motion
        self._run(integrator.samples(np.array([edge])), cancelled)
        if self.time_s > edge:
            integrate.take_back(integrator.arrays, integrator.tables, motion)
            integrator.advance(motion, stop=edge)
        if integrator.settings.kind != EXPLICIT:
            motion.progress["next_kind"] = IMPLICIT

    def _change(self, leg):
        """Go on with another leg."""
        before, self._base = self._base, leg
        self._integrator = self._with(leg)
        if leg.out != before.out:
            self._hand_over(before)
        elif leg.commands._replace(force_n=before.commands.force_n) != before.commands:
            self._set_modes()

    def _hand_over(self, before):
        """Let beads leave their reels, or be taken in."""
        leg, integrator, old = self._base, self._integrator, self._motion
        turning = integrator.arrays.rate + integrator.arrays.spin
        v, r, out = old.v, old.r, list(before.out)
        lengths, rates = before.commands.lengths_out(leg.edge)
        for i, reel in enumerate(reels(self._system)):
            while out[i] != leg.out[i]:
                part = self._free(tuple(out))[0]
                far = reel.segments[len(reel.segments) - out[i] + 1 :]
                paying = lengths[i] - self._system.rest_length_m[list(far)].sum(), rates[i]
                out[i] += 1 if leg.out[i] > out[i] else -1
                v, r = pay_out(part, self._free(tuple(out))[0], reel, turning, (v, r), paying)
        self._motion = motion = integrator.blank()
        motion.progress[:] = old.progress
        for name, value in (("r", r), ("v", v), ("start_r", r), ("start_v", v)):
            getattr(motion, name)[:] = value
        at = motion.progress
        at["step_start"], at["step_size"], at["newton_limit"] = at["time"], 0.0, ANY_STEP
        at["implicit_size"] = np.minimum(at["implicit_size"], self._first_step_s)
        self._set_modes()

    def _set_modes(self):
        """Set the modes of tethers anew."""
        motion, room = self._motion, np.empty((2, self._motion.taut.size))
        integrate.set_modes(self._integrator.arrays, motion, motion.time, motion.v, motion.r, *room)
