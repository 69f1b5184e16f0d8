"""Measurements: relative states, ranges and tensions with bias and noise; knows no ROS.

Noise is a function of the seed, the instrument and the simulation time. So a run that is made
again, restored or reset is measured alike, bit for bit, however it is paced.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tss_ros.core import System
from tss_ros.core.model.reels import reels

#: What is measured: the first parts of the parameters' names, and their units.
QUANTITIES = {"position": "m", "velocity": "m_s", "range": "m", "tension": "n"}


class Instrument:
    """Adds a constant error and noise, both normal, to what is true.

    Parameters
    ----------
    seed : int
    name : str
        No other instrument has it.
    noise, bias : sequence of float
        Standard deviations, one for each number that is measured at one time.
    """

    def __init__(self, seed: int, name: str, noise: Sequence[float], bias: Sequence[float]) -> None:
        own = np.random.SeedSequence(seed, spawn_key=tuple(name.encode()))
        self._key = own.generate_state(2, np.uint64)
        self._noise = np.array(noise, dtype=float)
        # The block of time -1 ns, which no state has.
        self.bias = np.array(bias, dtype=float) * self._normal(-1)

    def measure(self, time_ns: int, true: np.ndarray) -> np.ndarray:
        """What it shows at a simulation time [ns], in the units of `true`."""
        values = true + self.bias
        return values + self._noise * self._normal(time_ns) if self._noise.any() else values

    def _normal(self, time_ns):
        # Philox counts from the first word on: what is drawn for one time is far from the next.
        counter = np.array([0, 0, 0, time_ns], dtype=np.int64).astype(np.uint64)
        draw = np.random.Generator(np.random.Philox(key=self._key, counter=counter))
        return draw.standard_normal(len(self._noise))


class Sensors:
    """The instruments of a formation.

    Parameters
    ----------
    system : System
    options : mapping
        The simulator's parameters by name, `sensor_period_s` and `sensor_seed` among them.

    Attributes
    ----------
    satellites : list of int
        Indices of their beads.
    tethers : list of Reel
        Whole tethers between two satellites.
    """

    def __init__(self, system: System, options: Mapping[str, Any]) -> None:
        self.satellites = np.flatnonzero(system.is_satellite).tolist()
        self.tethers = [
            line for line in reels(system)
            if system.is_satellite[[line.beads[0], line.beads[-1]]].all()
        ]  # fmt: skip
        self._period_s = options["sensor_period_s"]
        self._names = system.bead_name
        self._seed, self._options = options["sensor_seed"], options
        self._instruments = {}
        ends = [(*line.beads[:: len(line.beads) - 1], *line.segments[:1], *line.segments[-1:])
                for line in self.tethers]  # fmt: skip
        self._ends, self._segments = np.hsplit(np.array(ends, dtype=int).reshape(-1, 4), 2)

    def due(self, time_ns: int, step_s: float) -> bool:
        """Whether a state is the first at or after a multiple of the period.

        Parameters
        ----------
        time_ns : int
            Simulation time [ns] of the state.
        step_s : float
            [s] from one state to the next.
        """
        if not self._period_s:
            return False
        now_s = time_ns / 1e9
        return self._count(now_s) > self._count(now_s - step_s)

    def relative_states(
        self, observer: int, time_ns: int, position_m: np.ndarray, velocity_m_s: np.ndarray
    ) -> tuple[list[int], np.ndarray, np.ndarray]:
        """Where a satellite sees the others.

        Parameters
        ----------
        observer : int
            Index of its bead.
        time_ns : int
        position_m, velocity_m_s : ndarray, shape (n, 3)

        Returns
        -------
        tuple of list, ndarray and ndarray
            Indices of the others, their positions [m] and velocities [m/s], shape (k, 3).
        """
        others = [i for i in self.satellites if i != observer]
        measured = [
            self._measure(
                f"{quantity}/{self._names[observer]}", quantity, time_ns,
                (values[others] - values[observer]).ravel(),
            ).reshape(-1, 3)
            for quantity, values in (("position", position_m), ("velocity", velocity_m_s))
        ]  # fmt: skip
        return others, *measured

    def ranges_and_tensions(
        self, time_ns: int, position_m: np.ndarray, tension_n: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of every whole tether.

        Parameters
        ----------
        time_ns : int
        position_m : ndarray, shape (n, 3)
        tension_n : ndarray, shape (m,)
            Of every segment.

        Returns
        -------
        tuple of ndarray, shape (k,)
            Distances [m] of the satellites that it joins, and means of the tensions [N] of the
            segments at its two ends.
        """
        first, second = self._ends.T
        range_m = np.linalg.norm(position_m[first] - position_m[second], axis=1)
        end_n = tension_n[self._segments].mean(axis=1)
        return (
            self._measure("range", "range", time_ns, range_m),
            self._measure("tension", "tension", time_ns, end_n),
        )

    def _count(self, time_s):
        """Periods up to a time; one that ends there counts, whatever rounding does."""
        return math.floor((time_s * (1.0 + 1e-12) + 2e-9) / self._period_s)

    def _measure(self, name, quantity, time_ns, true):
        if name not in self._instruments:
            unit = QUANTITIES[quantity]
            noise, bias = (
                np.full(true.size, self._options[f"{quantity}_{kind}_{unit}"])
                for kind in ("noise", "bias")
            )
            self._instruments[name] = Instrument(self._seed, name, noise, bias)
        return self._instruments[name].measure(time_ns, true)
