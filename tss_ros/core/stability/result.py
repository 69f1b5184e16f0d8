"""What is known of the multipliers at one spin rate."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tss_ros.core.model.laws import TETHER_LAWS
from tss_ros.core.model.system import State, System
from tss_ros.core.presentation import Presented, a_turn, data_frame, found, turn_in_words
from tss_ros.core.stability.law_words import law_in_words
from tss_ros.core.stored import Stored

METHODS = ("monodromy", "frozen")
VERDICTS = ("unstable", "neutral", "asymptotically stable", "none found", "undecided")


@dataclass(frozen=True, kw_only=True, repr=False)
class FloquetResult(Presented, Stored):
    """Multipliers at one spin rate, with what is known of their accuracy.

    Attributes
    ----------
    method : str
        "monodromy" or "frozen".
    spin_rate_ratio : float
        w = omega / Omega.
    spin_rate_rad_s, period_s : float
        omega [rad/s] and T = 2 pi / |omega| [s]; where omega is 0, T is the orbit's period.
    orbits : int
        How many orbits the period has where the orbit is no circle, and forces depend on time; 0
        where they do not.
    multiplier : ndarray, shape (6n,) or (leading,), complex
        Largest modulus first; empty if there is no configuration or the motion is chaotic, and
        then all that follows from multipliers is NaN.
    family : tuple of str, as long
        One of `FAMILIES` for each multiplier.
    max_modulus, max_modulus_nontrivial : float
        Over all, and over those of axis tilt, shape and libration; of leading ones, over those
        found.
    verdict : str
        One of `VERDICTS`. "asymptotically stable" speaks of the shape: the tilt of the axis and
        the centre of mass never decay, so Eq. (47) cannot hold for them. "undecided": none of the
        leading multipliers that were found lies outside, but some were not found. Librations of
        a formation that hangs count as the tilt does.
    deciding_modulus : float
        Modulus of the multiplier that decided the verdict: the largest of those that leave the
        circle if it is "unstable", else of the shape, or of what else may leave it. NaN where none
        decided, as where no motion closes.
    deciding_family : str
        Family of that multiplier, "" for none.
    tolerance : float
        Distance from the unit circle within which the multiplier that decided counts as lying on
        it; the least of all where none decided. Near 1, within twice the root of the closure
        residual, where the drift of a damped motion splits Jordan blocks, it is three times
        `jordan_error`, if that is more.
    closure_residual : float
        |x(T) - x(0)| of the motion analysed, positions over the radius, velocities over the rim
        speed.
    spin_loss : float
        Share of the spin that damping takes in a turn. The motion analysed closes because a drive
        gives it back; the true one slows down by so much. Feedback that damps against the rigid
        turn gives it back itself, by aiming at a little more than the rate. 0 where no drive was
        sought: without correction, for "frozen" and for leading multipliers. NaN where no motion
        was found.
    initial_closure_residual : float
        The same for the start as given, before any correction; infinite if that turn cannot be
        integrated.
    trivial_error : float
        Largest distance from the unit circle of the four simple centre-of-mass multipliers
        exp(+-i Omega T), which theory puts on it. NaN for "frozen".
    jordan_error : float
        The same for the multipliers at 1 that come in Jordan blocks; about the square root of the
        matrix's error. Growth beyond 1e-3 and twice the root of the closure residual is no such
        split, and the motion is called unstable. NaN for "frozen".
    det_z_error : float
        |det Z - 1| of the out-of-plane block of a planar motion; NaN otherwise or for "frozen".
    flow_error : float
        Scaled error of M f(x(0)) = f(x(T)), which holds on every motion of the autonomous orbit
        frame, closed or not, and through every switch. NaN for "frozen".
    segment_error, convergence_error : float
        Largest change of a multiplier outside the Jordan blocks when the turn is cut into 3 and 7
        parts whose matrices are multiplied, and when it is integrated a hundred times more
        accurately. NaN if not certified. Of a formation that hangs `segment_error` is the largest
        |M v - exp(exponent t) v| of its modes v, M integrated over t: an orbit, or as much of it
        as `message` says.
    liouville_error : float
        Error of Liouville's formula for log|det M|, see `proofs.liouville_error`. NaN if not
        certified.
    switches : int
        Switches in the turn: between slack and taut, and of tethers that only pull between pulling
        and not.
    tether_law : str
        How taut tethers pull, a name in `laws.TETHER_LAWS`.
    pushing_share : float
        Share of the time that taut tethers spent pushing in the turn, sampled; 0 for laws that
        never push, NaN if no turn was made.
    state : State
        Start of the motion analysed.
    message : str
        Remarks for the reader.
    residual : ndarray, shape (leading,)
        |M v - rho v| / |v| of leading multipliers; empty where the whole matrix was computed.
    exponent : ndarray, shape (6n,) or (leading,), complex
        [1/s] of a formation that hangs, omega = 0: its multipliers are exp(exponent T), in the same
        order. Multipliers of stiff damped modes vanish in rounding and tell frequencies up to whole
        cycles; exponents do neither. Empty elsewhere.
    vectors : ndarray, shape (6n, k), complex
        Eigenvectors of the multipliers, columns in the same order: velocities over the rim speed,
        then positions over the radius of the start, in the turning frame. The rim speed of a
        formation that hangs is Omega times its radius. `compute_modes` says what they are.
    """

    method: str
    spin_rate_ratio: float
    spin_rate_rad_s: float
    period_s: float
    multiplier: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=complex))
    family: tuple[str, ...] = ()
    max_modulus: float = math.nan
    max_modulus_nontrivial: float = math.nan
    verdict: str = "none found"
    deciding_modulus: float = math.nan
    deciding_family: str = ""
    tolerance: float = math.nan
    closure_residual: float = math.nan
    initial_closure_residual: float = math.nan
    spin_loss: float = math.nan
    trivial_error: float = math.nan
    jordan_error: float = math.nan
    det_z_error: float = math.nan
    flow_error: float = math.nan
    switches: int = 0
    tether_law: str = TETHER_LAWS[0].name
    pushing_share: float = math.nan
    state: State
    segment_error: float = math.nan
    convergence_error: float = math.nan
    liouville_error: float = math.nan
    message: str = ""
    residual: np.ndarray = field(default_factory=lambda: np.empty(0))
    exponent: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=complex))
    vectors: np.ndarray = field(default_factory=lambda: np.empty((0, 0), dtype=complex))
    orbits: int = field(default_factory=int)

    @property
    def deciding(self) -> int:
        """Index of the multiplier that decided the verdict, -1 for none."""
        match = [
            k for k, family in enumerate(self.family)
            if family == self.deciding_family
            and abs(self.multiplier[k]) == self.deciding_modulus
        ]  # fmt: skip
        return match[0] if match else -1

    @property
    def decided_by(self) -> str:
        """What decided the verdict, in words: a family with its modulus, or the closure."""
        return in_words(self.deciding_family, self.deciding_modulus, self.closure_residual)

    @property
    def reason(self) -> str:
        """Why the verdict is what it is, in words, with the number that decided."""
        if self.verdict == "none found":
            return self.message
        return f"{_REASONS[self.verdict]}: {self.decided_by}"

    @property
    def largest_error(self) -> float:
        """The largest of the errors of the matrix that were measured; NaN if none was."""
        errors = (self.flow_error, self.segment_error, self.convergence_error)
        return max((error for error in errors if not math.isnan(error)), default=math.nan)

    def plot(self) -> Any:
        """The multipliers and the unit circle, `plots.plot_multipliers`, a Matplotlib figure."""
        return found("tss_ros.plots", "plot").plot_multipliers(self)

    def to_pandas(self) -> Any:
        """The multipliers as a pandas.DataFrame, largest modulus first."""
        columns = {"multiplier": self.multiplier, "modulus": np.abs(self.multiplier)}
        columns["family"] = list(self.family)
        for name in ("exponent", "residual"):
            if getattr(self, name).size:
                columns[name] = getattr(self, name)
        return data_frame(columns)

    def _headline(self):
        decided = f", {self.decided_by}" if self.deciding_family else ""
        if self.verdict == "none found":
            decided = f", {self.message.split(';')[0]}"
        known = {"closes to": self.closure_residual, "errors to": self.largest_error}
        known = [f"{name} {x:.1e}" for name, x in known.items() if not math.isnan(x)]
        method = "" if self.method == METHODS[0] else f" ({self.method})"
        return (
            f"ω = {self.spin_rate_ratio:g} Ω{method}: {'; '.join([self.verdict + decided, *known])}"
        )

    def _facts(self):
        numbers = {
            "distance that counts as none": self.tolerance,
            "closure residual": self.closure_residual,
            "before correction": self.initial_closure_residual,
            f"spin lost in {a_turn(self.spin_rate_ratio)}": self.spin_loss,
            **{
                f"{name.replace('_', ' ')} error": getattr(self, f"{name}_error")
                for name in ("trivial", "jordan", "det_z", "flow", "segment", "convergence")
            },
            "Liouville error": self.liouville_error,
        }
        return {
            "verdict": self.verdict,
            "because": self.reason,
            "multipliers": len(self.multiplier),
            "period": f"{self.period_s:.6g} s",
            **self._swings(),
            **{name: f"{x:.2e}" for name, x in numbers.items() if not math.isnan(x)},
            f"switches in the {turn_in_words(self.spin_rate_ratio)}": self.switches,
            "tether law": law_in_words(self.tether_law, self.pushing_share),
            **({"remarks": self.message} if self.family and self.message else {}),
        }

    def _swings(self):
        """Frequencies of librations, if there are any."""
        swings = [x.imag for x, name in zip(self.exponent, self.family) if name == "libration"]
        rates = sorted({f"{x * self.period_s / (2.0 * math.pi):.6g}" for x in swings if x > 0.0})
        return {"librations": f"{', '.join(rates)} {a_turn(0.0)}"} if rates else {}


#: What the verdicts say that multipliers decided.
_REASONS = {
    "unstable": "a multiplier lies outside the unit circle",
    "neutral": "no multiplier lies outside the unit circle by more than it is known to, and not all"
    " of the shape lie inside",
    "asymptotically stable": "all multipliers of the shape lie inside the unit circle",
    "undecided": "no leading multiplier that was found lies outside, but some were not found",
}


def asked(method: str, system: System, spin_rate_rad_s: float) -> dict[str, Any]:
    """What a `FloquetResult` says of the question, by name."""
    ratio = spin_rate_rad_s / system.orbit_rate_rad_s
    return {
        "method": method,
        "spin_rate_ratio": ratio,
        "spin_rate_rad_s": spin_rate_rad_s,
        "period_s": 2.0 * math.pi / abs(spin_rate_rad_s or system.orbit_rate_rad_s),
        "tether_law": system.tether_law,
    }


def in_words(family: str, modulus: float, closure_residual: float) -> str:
    """What decided a verdict: family and modulus of a multiplier, else the closure residual."""
    if family:
        return f"{family} {modulus:.6f}"
    return "" if math.isnan(closure_residual) else f"closure {closure_residual:.1e}"
