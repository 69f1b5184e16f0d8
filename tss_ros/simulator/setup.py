"""What a simulator's run begins with: a system, its spin and its disturbed initial state."""

import dataclasses
from functools import cached_property
from typing import Any

import numpy as np

from tss_ros.core import (
    Failure,
    State,
    System,
    TssError,
    deployed_system,
    disturbed,
    initial_state,
    tether_state,
    whole_state,
)
from tss_ros.core.model.laws.feedback import SHAPE_KEEPING
from tss_ros.core.model.orbits import ReferenceOrbit
from tss_ros.core.model.reel_law import with_fixed_reels
from tss_ros.core.model.reels import reel_names
from tss_ros.core.presentation import turn_in_words
from tss_ros.scenarios.scenario import Scenario
from tss_ros.simulator.commands import CommandTable
from tss_ros.simulator.reel_commands import ReelStart, reel_start


def declared(loaded: Scenario, system: System, publish_period_s: float) -> dict[str, Any]:
    """What a scenario has happen in a run, as arguments of `Setup.of`.

    Parameters
    ----------
    loaded : Scenario
    system : System
        What it builds, with whatever overrides.
    publish_period_s : float

    Raises
    ------
    TssError
        If it does not fit the system.
    """
    reels = reel_start(loaded, system, publish_period_s)
    for failure in loaded.failures:
        failure.check(with_fixed_reels(system) if reels else system)
    return {"failures": loaded.failures, "reels": reels}


@dataclasses.dataclass(frozen=True)
class Setup:
    """What a run begins with.

    Attributes
    ----------
    options : dict
        The simulator's parameters that it was made from, by name; `scenario`, `publish_period_s`,
        `disturbance_m` and `disturbance_seed` among them.
    system : System
    spin_rate_ratio : float
    start : State
    reference_radius_m : ndarray, shape (n,)
        Distances [m] from the centre before the disturbance, the zero of Eq. (53).
    tension_n : ndarray, shape (m,)
        Tensions [N] before the disturbance.
    failures : tuple of Failure
        What is to fail.
    reels : ReelStart or None
        What reels do; None: all tethers are out.
    """

    options: dict
    system: System
    spin_rate_ratio: float
    start: State
    reference_radius_m: np.ndarray
    tension_n: np.ndarray
    failures: tuple[Failure, ...] = ()
    reels: ReelStart | None = None

    @classmethod
    def of(
        cls,
        options: dict[str, Any],
        system: System,
        spin_rate_ratio: float,
        start: State | None = None,
        failures: tuple[Failure, ...] = (),
        reels: ReelStart | None = None,
    ) -> "Setup":
        """Find the initial configuration, Eqs. (50)-(54), unless one is given, and disturb it.

        Parameters
        ----------
        options : dict
            The simulator's parameters, by name.
        system : System
        spin_rate_ratio : float
        start : State, optional
        failures : tuple of Failure
        reels : ReelStart, optional
            The formation then begins with so much of its tethers out.

        Returns
        -------
        Setup

        Raises
        ------
        TssError
            If there is none for this system and rate.
        """
        if reels and system.law_parameters[SHAPE_KEEPING.name]:
            raise TssError(f"{SHAPE_KEEPING.name} keeps one shape; allowed with reels: 0")
        acting = CommandTable(system, reels).at(0)
        part = acting.part_out(system, 0.0)
        if start is None:
            lengths = dict(zip(reel_names(system), acting.lengths_out(0.0)[0].tolist()))
            out = deployed_system(system, lengths)[0] if reels else system
            start = initial_state(out, spin_rate_ratio)
        else:
            start = State(start.position_m[part.beads], start.velocity_m_s[part.beads])
        moved = disturbed(start, options["disturbance_m"], options["disturbance_seed"])
        steady = whole_state(part, start)
        rests = acting.rests(system, 0.0)[0], np.zeros(system.m)
        return cls(
            options=options,
            system=system,
            spin_rate_ratio=spin_rate_ratio,
            start=whole_state(part, moved),
            reference_radius_m=np.linalg.norm(steady.position_m, axis=1),
            tension_n=tether_state(system, steady.position_m, steady.velocity_m_s, rests)[1],
            reels=reels,
            failures=failures,
        )

    @cached_property
    def moving_system(self) -> System:
        """What is integrated: its reels yield where their law acts all the time."""
        return with_fixed_reels(self.system) if self.reels else self.system

    @property
    def commands(self) -> CommandTable:
        """What acts from outside on a run that is told nothing, as a table of its own."""
        return CommandTable(self.system, self.reels)

    @property
    def publish_period_s(self) -> float:
        """[s] simulated time between steps."""
        return self.options["publish_period_s"]

    @cached_property
    def orbit(self) -> ReferenceOrbit:
        """The orbit of the formation's nominal centre."""
        return ReferenceOrbit(self.system)

    @property
    def turn(self) -> str:
        """What is counted: "turn", or "orbit" of a formation that hangs."""
        return turn_in_words(self.spin_rate_ratio)

    @property
    def turn_s(self) -> float:
        """[s] duration of one turn, of the orbit if the formation hangs."""
        return self.system.period_s(self.spin_rate_ratio)

    @property
    def identity(self) -> dict[str, np.ndarray]:
        """Everything that must be equal for a snapshot to fit, by name."""
        values = {f.name: getattr(self.system, f.name) for f in dataclasses.fields(System)}
        del values["layout_m"]
        values |= values.pop("law_parameters")
        values = {name: np.array(value) for name, value in values.items()}
        values["spin_rate_ratio"] = np.array(self.spin_rate_ratio)
        values["publish_period_s"] = np.array(self.publish_period_s)
        values["failures"] = np.array([str(failure) for failure in self.failures], dtype=str)
        sampled = self.reels and self.reels.every
        said = [self.reels.every, *self.reels.length_m] if sampled else []
        values["reel_sample_s"] = np.array(said, dtype=float)
        return values
