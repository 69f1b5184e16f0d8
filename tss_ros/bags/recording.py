"""Bags read into arrays, run by run; as fast for a million steps as the disk allows."""

import json
import math
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tss_ros.bags.older import UNSAID, completed
from tss_ros.bags.reader import STATES, BagContent, bag_files, open_complete
from tss_ros.core import System, TssError, deviation, elastic_energy, pushing_share


@dataclass(frozen=True, kw_only=True)
class Description:
    """What stays the same during a run: n beads, m tether segments.

    Attributes
    ----------
    scenario : str
    bead_name, tether_name : tuple of str, lengths n and m
    is_satellite : ndarray, shape (n,), bool
    tether_ends : ndarray, shape (m, 2), int
        Indices of the two beads that each segment joins.
    mass_kg, reference_radius_m : ndarray, shape (n,)
        Masses [kg]; undisturbed initial distances from the nominal centre [m], Eq. (53).
    rest_length_m, axial_stiffness_n, damping_n_s_per_m : ndarray, shape (m,)
        [m], [N], [N s/m].
    orbit_altitude_m, orbit_rate_rad_s, spin_rate_ratio : float
        [m], [rad/s], [-].
    disturbance_m, publish_period_s : float
        [m], [s].
    disturbance_seed : int
    tether_law : str
        How taut tethers pull; the paper's law in bags that do not say.
    law_parameters : dict of str to float
        What the laws of forces were given; those left out have their defaults.
    parameters : dict
        The simulator's parameters; empty in bags of other recorders.
    scenario_yaml : str
        Text of the scenario file.
    versions : tuple of str
        Of the software that simulated.
    """

    scenario: str
    bead_name: tuple
    tether_name: tuple
    is_satellite: np.ndarray
    tether_ends: np.ndarray
    mass_kg: np.ndarray
    reference_radius_m: np.ndarray
    rest_length_m: np.ndarray
    axial_stiffness_n: np.ndarray
    damping_n_s_per_m: np.ndarray
    orbit_altitude_m: float
    orbit_rate_rad_s: float
    spin_rate_ratio: float
    disturbance_m: float
    publish_period_s: float
    disturbance_seed: int
    tether_law: str = UNSAID["tether_law"]
    law_parameters: dict = field(default_factory=dict)
    parameters: dict = field(default_factory=dict)
    scenario_yaml: str = ""
    versions: tuple = ()

    @classmethod
    def of(cls, message: Any) -> "Description":
        """Take over a message SystemDescription, whose fields have the same names.

        Bags made before some of these fields existed lack them.
        """
        values = {
            f.name: _CONVERSIONS.get(f.type, f.type)(getattr(message, f.name))
            for f in fields(cls)
            if hasattr(message, f.name)
        }
        values["is_satellite"] = values["is_satellite"].astype(bool)
        values["tether_ends"] = values["tether_ends"].reshape(-1, 2).astype(int)
        named = getattr(message, "law_parameter_name", ())
        values["law_parameters"] = dict(zip(named, getattr(message, "law_parameter", ())))
        values["parameters"] = json.loads(getattr(message, "parameters_json", "") or "{}")
        return cls(**values)

    @property
    def turn_s(self) -> float:
        """Spin period of the undisturbed formation [s]."""
        return 2.0 * math.pi / abs(self.spin_rate_ratio * self.orbit_rate_rad_s)


#: How a message's values become those of a field, but where its type makes them.
_CONVERSIONS = {np.ndarray: np.array}


@dataclass(frozen=True, kw_only=True)
class Recording(Description):
    """What a bag says about one run: its description, and k steps of it as arrays.

    Attributes
    ----------
    step : ndarray, shape (k,), int
    t_s : ndarray, shape (k,)
        Simulation time [s].
    position_m, velocity_m_s : ndarray, shape (k, n, 3)
        [m], [m/s] in the orbit frame.
    deviation : ndarray, shape (k, n)
        Eq. (53) [-].
    length_m, tension_n : ndarray, shape (k, m)
        [m], [N].
    taut : ndarray, shape (k, m), bool
    run, runs : int
        This is the run-th of the runs in its bag, from 1; each begins where the steps begin anew.
    stability : tuple of messages FloquetResult
        What the stability node found while the bag was recorded.
    lost : int or None
        Messages that the recorder, or `recover`, knew to be lost; None if the bag does not say.
    """

    step: np.ndarray
    t_s: np.ndarray
    position_m: np.ndarray
    velocity_m_s: np.ndarray
    deviation: np.ndarray
    length_m: np.ndarray
    tension_n: np.ndarray
    taut: np.ndarray
    run: int = 1
    runs: int = 1
    stability: tuple = ()
    lost: int | None = None

    @cached_property
    def system(self) -> System:
        """What was simulated; its layout is where the recording begins."""
        names = {f.name for f in fields(System)} & {f.name for f in fields(self)}
        known = {name: getattr(self, name) for name in names}
        return System(**known, layout_m=self.position_m[0])

    @property
    def pushing_share(self) -> float:
        """Share of the time that taut tethers spent pushing [-]."""
        return pushing_share(self.tension_n, self.taut)

    @property
    def turns(self) -> np.ndarray:
        """Simulation time in spin turns [-], shape (k,)."""
        return self.t_s / self.turn_s

    @property
    def centre_of_mass_m(self) -> np.ndarray:
        """Centre of mass in the orbit frame [m], shape (k, 3)."""
        return np.average(self.position_m, axis=1, weights=self.mass_kg)

    @property
    def deviation_from_centre(self) -> np.ndarray:
        """Eq. (53) measured from the instantaneous centre of mass [-], shape (k, n)."""
        return deviation(
            self.position_m - self.centre_of_mass_m[:, None], self.reference_radius_m
        )

    @property
    def energy_j(self) -> np.ndarray:
        """Energy in the orbit frame [J] (the Jacobi integral), shape (k,).

        Kinetic energy, that of a round Earth's gravity and of centrifugal force against the
        frame's origin, and that of the taut tethers. Nothing but damping, drag and the Earth's
        oblateness changes it.
        """
        radius = self.system.orbit_radius_m
        y, z = self.position_m[..., 1], self.position_m[..., 2]
        # |q|^2 / R^2 - 1 for the distance q from the Earth's centre.
        u = (2.0 * y + (self.position_m**2).sum(axis=2) / radius) / radius
        well = -2.0 * np.expm1(-0.5 * np.log1p(u)) - u
        tidal = self.orbit_rate_rad_s**2 * (radius**2 * well + z**2)
        speed2 = np.einsum("kni,kni->kn", self.velocity_m_s, self.velocity_m_s)
        elastic = elastic_energy(self.system, self.position_m, self.velocity_m_s)
        return 0.5 * (speed2 + tidal) @ self.mass_kg + elastic


def read_bag(path: str | Path, run: int | None = None) -> Recording:
    """Read one run from a bag.

    Parameters
    ----------
    path : str or Path
        Bag directory or .mcap file.
    run : int, optional
        Which one, from 1, of a bag in which the simulation began anew; by default the last.

    Returns
    -------
    Recording
        The steps of which both bead and tether states were recorded; the last run, where the
        simulator was reset or a snapshot restored in between.

    Raises
    ------
    TssError
        If there is no readable recording of a run.
    """
    shown = str(path)
    bag = BagContent(shown)
    for file in bag_files(path):
        with open_complete(file) as stream:
            bag.read(stream)
    beads, tethers = (bag.runs(name) for name in STATES)
    if len(beads) != len(tethers):
        raise TssError(
            f"{shown!r} holds {len(beads)} runs of BeadStates and {len(tethers)} of TetherStates; "
            "allowed: as many of each"
        )
    if run is not None and not 1 <= run <= len(beads):
        raise TssError(f"run is {run}; allowed for {shown!r}: 1 to {len(beads)}")
    number = run or len(beads)
    first_bead = sum(len(earlier) for earlier in beads[: number - 1])
    return _recording(bag, number, len(beads), first_bead, beads[number - 1], tethers[number - 1])


def _recording(bag, number, run_count, first_bead, beads, tethers):
    steps, of_beads, of_tethers = np.intersect1d(
        beads["step"], tethers["step"], assume_unique=True, return_indices=True
    )
    if not steps.size:
        raise TssError(
            f"{bag.shown!r} holds no step of both: BeadStates {beads['step'][0]} to "
            f"{beads['step'][-1]}, TetherStates {tethers['step'][0]} to {tethers['step'][-1]}"
        )

    def column(source, field, *shape):
        values, rows = (beads, of_beads) if source == "beads" else (tethers, of_tethers)
        return values[field][rows].reshape(len(steps), *shape)

    return Recording(
        **vars(Description.of(bag.description(first_bead, number, run_count))),
        step=steps.astype(int),
        t_s=column("beads", "stamp.sec") + column("beads", "stamp.nanosec") * 1e-9,
        position_m=column("beads", "position_m", -1, 3),
        velocity_m_s=column("beads", "velocity_m_s", -1, 3),
        deviation=column("beads", "deviation", -1),
        length_m=column("tethers", "length_m", -1),
        tension_n=column("tethers", "tension_n", -1),
        taut=column("tethers", "taut", -1).astype(bool),
        run=number,
        runs=run_count,
        stability=tuple(completed(message) for _, message in bag.others["FloquetResult"]),
        lost=bag.lost,
    )
