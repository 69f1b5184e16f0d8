"""What is known of a family of periodic motions: its points, and where something happens."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tss_ros.core.model.system import State
from tss_ros.core.presentation import Presented, data_frame, found, html_table
from tss_ros.core.stability.result import in_words

#: What may happen on a family: it turns round; a real multiplier leaves the circle at 1, or at -1;
#: a pair does; that of the spin rate grows beyond what the drive explains; tethers begin to go
#: slack.
SPECIAL_KINDS = (
    "fold", "branch point", "period doubling", "torus", "spin divergence", "first slack"
)  # fmt: skip


#: Points of which a table in a notebook shows so many of the first and of the last.
SHOWN = 4


@dataclass(frozen=True, repr=False)
class FamilyPoint(Presented):
    """A motion of a family, with what its multipliers say.

    Attributes
    ----------
    parameter, spin_rate_ratio : float
    verdict : str
        One of `VERDICTS`, not certified.
    deciding_modulus, deciding_family, max_modulus_nontrivial, spin_loss, closure_residual, state
        As in `FloquetResult`.
    outside : int
        Multipliers outside the unit circle.
    slack : bool
        Whether tethers go slack, or let go, during the turn.
    multiplier : ndarray, shape (6n,), complex
        Largest modulus first.
    """

    parameter: float
    spin_rate_ratio: float
    verdict: str
    deciding_modulus: float
    deciding_family: str
    max_modulus_nontrivial: float
    outside: int
    slack: bool
    spin_loss: float
    closure_residual: float
    multiplier: np.ndarray
    state: State

    def _headline(self):
        decided = in_words(self.deciding_family, self.deciding_modulus, self.closure_residual)
        return f"at {self.parameter:g}, ω = {self.spin_rate_ratio:g} Ω: {self.verdict}, {decided}"

    def _facts(self):
        return {
            "verdict": self.verdict,
            "decided by": in_words(
                self.deciding_family, self.deciding_modulus, self.closure_residual
            ),
            "multipliers outside": self.outside,
            "tethers go slack": "yes" if self.slack else "no",
            "closure residual": f"{self.closure_residual:.1e}",
        }


@dataclass(frozen=True, repr=False)
class SpecialPoint(Presented):
    """A point of a family where something happens.

    Attributes
    ----------
    kind : str
        One of `SPECIAL_KINDS`.
    parameter, uncertainty : float
        Middle and half the width of the bracket, whose ends were found different.
    spin_rate_ratio : float
    multiplier : complex
        The one that leaves the circle, just outside; NaN for the other kinds.
    family : str
        Its family; "" for the other kinds.
    after : int
        Number of the family's point before it.
    state : State
        Start of the motion at the bracket's first end.
    turns : int
        After which it closes.
    """

    kind: str
    parameter: float
    uncertainty: float
    spin_rate_ratio: float
    multiplier: complex
    family: str
    after: int
    state: State
    turns: int = 1

    def _headline(self):
        return f"{self.kind} at {self.parameter:.8g} ± {self.uncertainty:.1e}{self._which}"

    @property
    def _which(self):
        """The multiplier that leaves the circle, in words."""
        if not self.family:
            return ""
        return f", {self.family} {self.multiplier:.6f}, |ρ| = {abs(self.multiplier):.6f}"

    def _facts(self):
        return {
            "kind": self.kind,
            "at": f"{self.parameter:.10g} ± {self.uncertainty:.1e}",
            "spin rate": f"{self.spin_rate_ratio:.10g} Ω",
            "multiplier": self._which.strip(", ") or "-",
            "turns": self.turns,
        }


@dataclass(frozen=True, repr=False)
class Family(Presented):
    """A family that was followed.

    Attributes
    ----------
    parameter : str
        What it was followed in.
    points : tuple of FamilyPoint
        In the order of the curve.
    special : tuple of SpecialPoint
    ended : str
        Why it stopped before it reached the end that was asked for; "" if it did not.
    turns : int
        After which its motions close, and which multipliers count: 2 beyond a period doubling.
    """

    parameter: str
    points: tuple[FamilyPoint, ...]
    special: tuple[SpecialPoint, ...]
    ended: str
    turns: int = 1

    def columns(self) -> dict[str, list]:
        """The points as columns of a table, e.g. for pandas.DataFrame, arrays left out."""
        names = [n for n in FamilyPoint.__dataclass_fields__ if n not in ("multiplier", "state")]
        return {name: [getattr(point, name) for point in self.points] for name in names}

    def to_pandas(self) -> Any:
        """`columns` as a pandas.DataFrame."""
        return data_frame(self.columns())

    def plot(self, label: str = "", law: str = "") -> Any:
        """The bifurcation diagram, `plots.family`, a Matplotlib figure."""
        return found("tss_ros.plots", "plot").family(self, label, law)

    def save(self, path: str | Path) -> None:
        """Write the family to a Parquet file, which `tss follow --start` reads as well."""
        found("tss_ros.sweeps.families", "save").save(self, path)

    @staticmethod
    def load(path: str | Path) -> Family:
        """A family that `save` or `tss follow` wrote."""
        return found("tss_ros.sweeps.families", "load").load(path)

    def _headline(self):
        return in_brief(self.parameter, self.points, self.ended)

    def __repr__(self):
        lines = [f"Family {self._headline()}", *(f"  {s._headline()}" for s in self.special)]
        return f"<{chr(10).join(lines)}>"

    def _repr_html_(self):
        head = ("", self.parameter, "ω/Ω", "verdict or kind", "decided by", "outside")
        rows = []
        for i, point in enumerate(self.points):
            if SHOWN <= i < len(self.points) - SHOWN:
                rows += [("...",)] * (i == SHOWN)
            else:
                decided = in_words(
                    point.deciding_family, point.deciding_modulus, point.closure_residual
                )
                place = f"{point.parameter:.6g}", f"{point.spin_rate_ratio:.6g}"
                rows.append((i, *place, point.verdict, decided, point.outside))
        for special in self.special:
            place = f"{special.parameter:.8g}", f"{special.spin_rate_ratio:.8g}"
            which = special._which.strip(", ")
            rows.append((f"after {special.after}", *place, special.kind, which))
        return html_table(f"Family {self._headline()}", rows, head)


def in_brief(parameter: str, points: tuple, ended: str) -> str:
    """What was followed, how far and why no further, in words."""
    words = f"in {parameter}: {len(points)} points"
    if points:
        words += f" from {points[0].parameter:g} to {points[-1].parameter:g}"
    return words + (f"; ended: {ended}" if ended else "")
