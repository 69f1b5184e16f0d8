"""Ensembles: what becomes of a formation after thousands of pushes, and how probably it holds."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from tss_ros.core import (
    Cancelled,
    CriticalRate,
    CriticalRatesJob,
    DisturbedMotion,
    EnsembleJob,
    TssError,
)
from tss_ros.core.stability.confirmation import LOST, MOST_TURNS
from tss_ros.scenarios import scenario
from tss_ros.scenarios.parameters import DISTURBANCE, SPIN_RATE_RATIO
from tss_ros.sweeps import software, work
from tss_ros.sweeps.jobs import CRITICAL_RATES, Boundaries, Entry, cells_of, columns_of

MOTIONS = "motions"
#: Motions in a job, so that starting it and its undisturbed motion cost little beside them.
MOTIONS_PER_JOB = 50
#: Confidence of the intervals.
CONFIDENCE = 0.95
_PUSH, _SEED = DISTURBANCE


@dataclass(frozen=True)
class Pushed:
    """A job: motions after pushes of one size at one rate, and a row for each."""

    ensemble: EnsembleJob

    def run(
        self, cancelled: Callable[[], bool] | None = None
    ) -> tuple[dict[str, list[dict[str, Any]]], TssError | None]:
        """Rows of `MOTIONS`, and the first error of a motion."""
        seeds = self.ensemble.seeds
        try:
            found = self.ensemble.run(cancelled)
        except Cancelled:
            raise
        except TssError as error:
            found = [error] * len(seeds)
        rows, failure = [], None
        for seed, motion in zip(seeds, found):
            row = {_SEED.name: seed}
            if isinstance(motion, TssError):
                failure = failure or motion
                row["error"] = str(motion)
            else:
                row |= cells_of(motion)
            rows.append(row)
        return {MOTIONS: rows}, failure


class EnsembleQuestion:
    """What an ensemble is asked: every push, with every seed, at every rate.

    A motion is the one that `sim_node` and `simulate` make of the same scenario, spin rate,
    `disturbance_m` and `disturbance_seed`.

    Parameters
    ----------
    scenario_name : str
        Shipped name or file.
    rates : (float, float, int)
        First and last spin rate, and how many.
    pushes : sequence of float
        [m] norms over all beads of the offsets added to the initial positions.
    seeds : (int, int)
        First and last seed.
    turns : int
        Length of each motion.
    overrides : mapping, optional
        Parameters that differ from the scenario's.
    critical : bool
        Whether the critical rates between the rates are looked for as well.

    Raises
    ------
    TssError
        If the scenario, an override, a push, a seed or the number of turns is not allowed.
    """

    name = "ensemble"

    def __init__(
        self,
        scenario_name: str,
        rates: tuple[float, float, int],
        pushes: Sequence[float],
        seeds: tuple[int, int],
        turns: int,
        *,
        overrides: Mapping[str, Any] | None = None,
        critical: bool = False,
    ) -> None:
        self.scenario_name, self.turns = scenario_name, turns
        self.overrides = dict(overrides or {})
        if SPIN_RATE_RATIO.name in self.overrides:
            raise TssError(f"{SPIN_RATE_RATIO.name} is what the rates say; it cannot be overridden")
        self.ratios = [SPIN_RATE_RATIO.check(ratio) for ratio in np.linspace(*rates).tolist()]
        self.pushes = [_PUSH.check(push) for push in pushes]
        for push in self.pushes:
            if not push > 0.0:
                raise TssError(f"push is {push:g} m; allowed: more than 0")
        if not self.pushes or len(set(self.pushes)) < len(self.pushes):
            raise TssError(f"pushes are {self.pushes}; allowed: one or more, all different")
        first, last = self.seeds = tuple(_SEED.check(seed) for seed in seeds)
        if first > last:
            raise TssError(f"seeds are {first} to {last}; allowed: the last no less than the first")
        if not 1 <= turns <= MOST_TURNS:
            raise TssError(f"turns is {turns}; allowed: a whole number from 1 to {MOST_TURNS}")
        if critical and len(self.ratios) < 2:
            raise TssError("critical rates lie between two rates; there is only one")
        self.critical = critical
        loaded = scenario.load(scenario_name)
        if loaded.failures:
            raise TssError(
                f"scenario {scenario_name!r:.200} has failures, which ensembles do not know"
            )
        if loaded.reels:
            raise TssError(
                f"scenario {scenario_name!r} has reels that move or are out in part; allowed: reels"
                " at rest with all tethers out"
            )
        self.system = loaded.build(self.overrides)
        self._start = loaded.start(self.system)
        far = LOST * np.max(np.linalg.norm(self.system.layout_m, axis=1))
        if (push := max(self.pushes)) > far:
            warnings.warn(
                f"push of {push:g} m: a bead that is pushed by more than {far:.4g} m,"
                f" {LOST:g} of the radius, and comes back to its place counts as lost",
                scenario.ImplausibleValue,
                stacklevel=2,
            )
        self._blocks = -(-(last + 1 - first) // MOTIONS_PER_JOB)
        self.description = {
            "ensemble of": scenario.read_text(scenario_name),
            "scenario": scenario_name, "rates": rates, "pushes": self.pushes, "seeds": self.seeds,
            "turns": turns, "overrides": self.overrides, "critical": critical,
            **{f"version of {name}": value for name, value in software.versions().items()},
        }  # fmt: skip

    def __len__(self):
        return len(self.ratios) * len(self.pushes) * self._blocks + self.critical

    @property
    def motions(self) -> int:
        """How many motions there are."""
        first, last = self.seeds
        return len(self.ratios) * len(self.pushes) * (last + 1 - first)

    def label(self, number: int) -> str:
        """What a job is about, in words."""
        if self._is_critical(number):
            return f"{self.scenario_name}, critical rates"
        ratio, push, seeds = self._place(number)
        return (
            f"{self.scenario_name} at {ratio:g}, push {push:g} m, seeds {seeds[0]} to {seeds[-1]}"
        )

    def job(self, number: int) -> Entry:
        """The Entry of a number."""
        cells = {
            "job": number, "scenario": self.scenario_name, "tether_law": self.system.tether_law,
        }  # fmt: skip
        if self._is_critical(number):
            interval = CriticalRatesJob(self.system, self.ratios[0], self.ratios[-1])
            return Entry(Boundaries(interval, 0), cells)
        ratio, push, seeds = self._place(number)
        job = EnsembleJob(self.system, ratio, push, seeds, self.turns, self._start)
        return Entry(Pushed(job), cells | {SPIN_RATE_RATIO.name: ratio, _PUSH.name: push})

    def columns(self) -> dict[str, dict[str, type]]:
        """Names and types of the columns of each table."""
        about, why = {"job": int, "scenario": str, "tether_law": str}, {"error": str}
        motion = {SPIN_RATE_RATIO.name: float, _PUSH.name: float, _SEED.name: int}
        return {
            MOTIONS: about | motion | columns_of(DisturbedMotion) | why,
            CRITICAL_RATES: about | columns_of(CriticalRate) | why,
        }

    def _is_critical(self, number):
        return self.critical and number == len(self) - 1

    def _place(self, number):
        """Rate, push and seeds of a job."""
        group, block = divmod(number, self._blocks)
        rate, push = divmod(group, len(self.pushes))
        first = self.seeds[0] + block * MOTIONS_PER_JOB
        seeds = range(first, min(first + MOTIONS_PER_JOB, self.seeds[1] + 1))
        return self.ratios[rate], self.pushes[push], tuple(seeds)


def ensemble(
    scenario_name: str,
    rates: tuple[float, float, int],
    pushes: Sequence[float],
    seeds: tuple[int, int],
    turns: int = 20,
    *,
    overrides: Mapping[str, Any] | None = None,
    output: str | Path | None = None,
    workers: int | None = None,
    scheduler: str = "",
    cancelled: Callable[[], bool] | None = None,
) -> pa.Table:
    """Disturb a formation many times, on all cores or a cluster, and see what becomes of it.

    Parameters
    ----------
    scenario_name, rates, pushes, seeds, turns, overrides
        See `EnsembleQuestion`.
    output : str or Path, optional
        Folder where the motions are kept; the same call goes on with what is there.
    workers : int, optional
        Threads of this process; as many as there are cores if not given.
    scheduler : str
        Address of a Dask scheduler whose workers do it instead; "" for none.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.

    Returns
    -------
    pyarrow.Table
        A row for each motion: what it is of, the fields of `core.DisturbedMotion`, and `error`
        where there is no motion. `probabilities` sums it up.

    Raises
    ------
    TssError
        For values that are not allowed, or if the work cannot go on.
    Cancelled
        If `cancelled` said so; what is done stays in `output`.
    """
    question = EnsembleQuestion(scenario_name, rates, pushes, seeds, turns, overrides=overrides)
    with work.opened(question, Path(output) if output else None) as store:
        work.compute(question, store, workers, scheduler, cancelled=cancelled)
        store.flush()
        return store.table(MOTIONS)


@dataclass(frozen=True)
class HoldProbability:
    """How probably a formation holds after pushes of one size at one rate.

    Attributes
    ----------
    spin_rate_ratio, disturbance_m : float
    held, lost, failed : int
        Motions; one that could not be simulated to its end is neither held nor lost.
    probability : float
        Share held of those held or lost; NaN if there are none, and so are the bounds.
    low, high : float
        Wilson's interval of that probability, of confidence `CONFIDENCE`.
    median_turns_to_settle : float
        Of the motions held; infinity if half of them or more do not settle, NaN if none held.
    largest_deviation : float
        Of the motions held, `deviation_from_centre`; NaN if none held.
    """

    spin_rate_ratio: float
    disturbance_m: float
    held: int
    lost: int
    failed: int
    probability: float
    low: float
    high: float
    median_turns_to_settle: float
    largest_deviation: float


def probabilities(motions: pa.Table) -> list[HoldProbability]:
    """How probably the motions of an ensemble hold, by rate and push, in their order.

    Parameters
    ----------
    motions : pyarrow.Table
        What `ensemble` gave or ``motions/`` of its folder holds.

    Returns
    -------
    list of HoldProbability
    """
    columns = "turns_to_settle", "deviation_from_centre"
    ratio, push, settle, largest = (
        motions[name].to_numpy() for name in (SPIN_RATE_RATIO.name, _PUSH.name, *columns)
    )
    held = motions["held"].fill_null(False).to_numpy()
    failed = motions["held"].is_null().to_numpy()
    new = np.flatnonzero((np.diff(ratio) != 0.0) | (np.diff(push) != 0.0)) + 1
    ends = [0, *new.tolist(), len(ratio)] if len(ratio) else []
    found = []
    for first, last in itertools.pairwise(ends):
        part = slice(first, last)
        good, bad = held[part], int(np.count_nonzero(failed[part]))
        count = int(np.count_nonzero(good))
        lost = last - first - count - bad
        settled = float(np.sort(settle[part][good])[count // 2]) if count else np.nan
        most = float(np.max(largest[part][good])) if count else np.nan
        shares = _wilson(count, count + lost)
        found.append(
            HoldProbability(
                float(ratio[first]), float(push[first]), count, lost, bad, *shares, settled, most
            )
        )
    return found


def _wilson(held, count):
    """Share, and the ends of Wilson's interval."""
    if not count:
        return np.nan, np.nan, np.nan
    from scipy.stats import binomtest  # takes a second to load

    interval = binomtest(held, count).proportion_ci(CONFIDENCE, method="wilson")
    return held / count, float(interval.low), float(interval.high)


def story(found: Sequence[HoldProbability]) -> str:
    """What an ensemble shows, as a title: where most motions hold, push by push.

    Parameters
    ----------
    found : sequence of HoldProbability

    Returns
    -------
    str
    """
    known = [one for one in found if one.held + one.lost]
    count = sum(one.held + one.lost for one in known)
    if not count:
        return "No motion could be simulated"
    held = sum(one.held for one in known)
    if held in (0, count):
        return f"{'All' if held else 'None'} of {count} disturbed motions held"
    words, pushes = {}, list(dict.fromkeys(one.disturbance_m for one in known))
    for push in pushes:
        words.setdefault(_fate([o for o in known if o.disturbance_m == push]), []).append(push)
    told = [f"{_listed(some, pushes)} m: {fate}" for fate, some in words.items()]
    if len(told) > 3:
        told = [told[0], "...", told[-1]]
    return f"After pushes of {'; '.join(told)}"


def _listed(some, pushes):
    """Some of the pushes in words; three or more that follow each other by their ends."""
    first = pushes.index(some[0])
    if len(some) > 2 and some == pushes[first : first + len(some)]:
        return f"{some[0]:g} to {some[-1]:g}"
    return ", ".join(f"{push:g}" for push in some)


def _fate(row):
    """What becomes of the motions after one push, rate by rate, in words."""
    ratio = np.array([one.spin_rate_ratio for one in row])
    above = np.array([one.probability - 0.5 for one in row])
    crossed = np.flatnonzero(np.diff(above >= 0.0))
    if len(crossed) == 1:
        ends = ratio[crossed[0] : crossed[0] + 2]
        held, lost = ends if above[crossed[0]] >= 0.0 else ends[::-1]
        return f"most hold at {held:.4g}, most are lost at {lost:.4g}"
    share = sum(one.held for one in row) / sum(one.held + one.lost for one in row)
    return {0.0: "none hold", 1.0: "all hold"}.get(share, f"{share:.1%} hold")
