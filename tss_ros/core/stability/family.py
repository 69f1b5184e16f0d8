"""What is known of a family of periodic motions: its points, and where something happens."""

from dataclasses import dataclass, field

import numpy as np

from tss_ros.core.model.system import State

#: What may happen on a family: it turns round; a real multiplier leaves the circle at 1, or at -1;
#: a pair does; that of the spin rate grows beyond what the drive explains; tethers begin to go
#: slack.
SPECIAL_KINDS = (
    "fold", "branch point", "period doubling", "torus", "spin divergence", "first slack"
)  # fmt: skip


@dataclass(frozen=True)
class FamilyPoint:
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
    multiplier: np.ndarray = field(repr=False)
    state: State = field(repr=False)


@dataclass(frozen=True)
class SpecialPoint:
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
    state: State = field(repr=False)
    turns: int = 1


@dataclass(frozen=True)
class Family:
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
