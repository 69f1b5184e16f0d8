"""Curves of special points: where a fold, a torus point, first slack goes in a second parameter.

The curve lies in the plane of two parameters, measured by their logarithms. From point to point it
is predicted along its chord; across that line a family is followed on a short window, and the
special point of the same kind on it is the next one. So a curve may turn round in either parameter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tss_ros.core.arguments import checked, finite
from tss_ros.core.errors import Cancelled, IntegrationError, TssError
from tss_ros.core.model.parameters import (
    SPIN_RATE_RATIO,
    check_parameter,
    parameter_of,
    with_parameter,
)
from tss_ros.core.model.system import State, System
from tss_ros.core.presentation import Presented, data_frame, found
from tss_ros.core.stability import continuation, families
from tss_ros.core.stability.closing import CLOSED, ClosingEquations, solve
from tss_ros.core.stability.continuation import Curve, Ended, Point
from tss_ros.core.stability.family import SpecialPoint, in_brief
from tss_ros.core.stability.follow import Run, symmetry_of
from tss_ros.core.stability.modes import stays_in_plane

#: First, longest and shortest step, over the values.
FIRST_STEP, LONGEST_STEP, SHORTEST_STEP = 0.01, 0.1, 1e-4
#: How far before the predicted place a window begins, in steps: those tried for the first step, and
#: that of the others.
FIRST_WINDOWS, WINDOW = (0.5, 2.0, 8.0), 0.5
#: How far it goes beyond, over the same; steps of the family up to there, and most points.
FAR, STEPS, MOST_POINTS = 3.0, 2, 60


@dataclass(frozen=True, repr=False)
class CurvePoint(Presented):
    """A special point at values of two parameters.

    Attributes
    ----------
    parameter, second : float
        The values.
    uncertainty : float
        Half the width of its bracket, over the values.
    spin_rate_ratio, multiplier, family, state
        As in `SpecialPoint`.
    """

    parameter: float
    second: float
    uncertainty: float
    spin_rate_ratio: float
    multiplier: complex
    family: str
    state: State

    def _headline(self):
        return f"at {self.parameter:.8g}, {self.second:.8g} ± {self.uncertainty:.1e} of them"

    def _facts(self):
        return {
            "parameters": f"{self.parameter:.10g}, {self.second:.10g}",
            "uncertainty": f"{self.uncertainty:.1e} of them",
            "spin rate": f"{self.spin_rate_ratio:.10g} Ω",
            "family": self.family or "-",
        }


@dataclass(frozen=True, repr=False)
class SpecialCurve(Presented):
    """A special point that was followed in a second parameter.

    Attributes
    ----------
    kind : str
        One of `SPECIAL_KINDS`.
    parameter, second : str
        The two parameters.
    points : tuple of CurvePoint
        In the order of the curve.
    ended : str
        Why it stopped before it reached the end that was asked for; "" if it did not.
    """

    kind: str
    parameter: str
    second: str
    points: tuple[CurvePoint, ...]
    ended: str

    def columns(self) -> dict[str, list]:
        """The points as columns of a table, e.g. for pandas.DataFrame, states left out."""
        names = [name for name in CurvePoint.__dataclass_fields__ if name != "state"]
        return {name: [getattr(point, name) for point in self.points] for name in names}

    def to_pandas(self) -> Any:
        """`columns` as a pandas.DataFrame."""
        return data_frame(self.columns())

    def plot(self, labels: tuple[str, str] = ("", ""), law: str = "") -> Any:
        """The curve in the plane of both parameters, `plots.special_curves`."""
        return found("tss_ros.plots", "plot").special_curves([self], labels, law)

    def save(self, path: str | Path) -> None:
        """Write the curve to a Parquet file."""
        found("tss_ros.sweeps.families", "save").save(self, path)

    @staticmethod
    def load(path: str | Path) -> SpecialCurve:
        """A curve that `save` wrote."""
        return found("tss_ros.sweeps.families", "load").load_curve(path)

    def _headline(self):
        return f"{self.kind} {in_brief(self.parameter, self.points, self.ended)}"

    def _facts(self):
        ends = self.points[:1] + self.points[1:][-1:]
        return {
            "kind": self.kind,
            "parameters": f"{self.parameter}, {self.second}",
            **{
                name: f"{point.parameter:.8g}, {point.second:.8g}"
                for name, point in zip(("first", "last"), ends)
            },
            "ended": self.ended or "at the end that was asked for",
        }


@checked
def follow_special(
    system: System,
    parameter: str,
    point: SpecialPoint,
    second: str,
    stop: float,
    *,
    spin_rate_ratio: float | None = None,
    longest_step: float = LONGEST_STEP,
    most_points: int = 500,
    progress: Callable[[float, CurvePoint], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> SpecialCurve:
    """Follow a special point of a family in a second parameter.

    Parameters
    ----------
    system : System
        That of the family.
    parameter : str
        In which the family was followed.
    point : SpecialPoint
    second : str
        "spin_rate_ratio" or one of `PARAMETERS`; followed from the value that the system has.
    stop : float
        Value of it. Where the curve turns round it is followed on, until it passes `stop` or comes
        back past its beginning.
    spin_rate_ratio : float, optional
        w = omega / Omega if `parameter` is another.
    longest_step : float
        Over the values.
    most_points : int
    progress, cancelled : callable, optional
        As for `follow`; progress gets a `CurvePoint`.

    Returns
    -------
    SpecialCurve

    Raises
    ------
    TssError
        For values that are not allowed, or if the special point was not found again.
    """
    check_parameter(parameter, spin_rate_ratio)
    if second == parameter:
        raise TssError(f"second must be another parameter than {parameter}")
    begin = spin_rate_ratio if second == SPIN_RATE_RATIO else parameter_of(system, second)
    finite("longest_step", longest_step, above=0.0)
    if finite(f"{second} to stop at", stop) == begin:
        raise TssError(f"the interval of {second} must not be empty, got {begin:g} to {stop:g}")

    def at(values):
        varied, ratio = system, spin_rate_ratio
        for name, value in zip((parameter, second), values):
            if name == SPIN_RATE_RATIO:
                ratio = float(value)
            else:
                varied = with_parameter(varied, name, float(value))
        return varied, varied.spin_rate_rad_s(ratio)

    at((point.parameter, stop))
    search = _Search(at, point, (point.parameter, begin), stop, cancelled)
    points, ended = search.curve(longest_step, most_points, progress)
    return SpecialCurve(point.kind, parameter, second, tuple(points), ended)


def _solved_at(equations: ClosingEquations, point: Point, value: float) -> np.ndarray:
    """y of the motion at a value of the parameter, next to a point of a curve."""
    share = (value - point.parameter) / point.tangent[-1]
    y = point.solution.y + share * point.tangent
    y[-1] = value
    solution = solve(equations, y, point.linear)
    if not solution.residual <= CLOSED:
        raise Ended(f"the motion closes to {solution.residual:.1e} only")
    return solution.y


class _Axis:
    """A parameter's values as places on an axis: their logarithms where they keep their sign."""

    def __init__(self, first, last):
        self._sign = math.copysign(1.0, first) if first * last > 0.0 else 0.0
        self._scale = abs(last - first) or 1.0
        self._exact = {self.place(value): value for value in (first, last)}

    def place(self, value):
        return math.log(abs(value)) * self._sign if self._sign else value / self._scale

    def value(self, place):
        if place in self._exact:
            return self._exact[place]
        return self._sign * math.exp(place * self._sign) if self._sign else place * self._scale


class _Search:
    """The windows along a curve."""

    def __init__(self, at, point, values, stop, cancelled):
        self.point, self.cancelled = point, cancelled
        self.axes = [_Axis(values[0], values[0]), _Axis(values[1], stop)]
        self.at = lambda place: at(self.values(place))
        self.begin = np.array([axis.place(v) for axis, v in zip(self.axes, values)])
        self.stop, self.normal = self.axes[1].place(stop), np.array([1.0, 0.0])
        self.turns = point.turns
        system, spin = at(values)
        ratio = spin / system.orbit_rate_rad_s
        motion = families.Closed(point.state, 0.0, 0.0, "")
        self.planar = stays_in_plane(system, point.state)
        self.symmetry = families.no_symmetry(system)
        if self.turns == 1:
            self.symmetry = symmetry_of(system, motion, ratio, cancelled)
        self.length = families.size_of(system)

    def values(self, place):
        """Of both parameters at a place (2,) of the plane."""
        return [axis.value(float(u)) for axis, u in zip(self.axes, place)]

    def line(self, place, direction):
        """The closing equations along a line of the plane."""
        return ClosingEquations(
            lambda s: self.at(place + s * direction), self.length, self.planar, self.symmetry,
            families.RTOL, self.cancelled, 1.0, self.turns,
        )  # fmt: skip

    def again(self):
        """The special point itself, by the line's one end or the other."""
        failure = None
        for half in (FIRST_STEP, 0.1 * FIRST_STEP):
            for normal in (self.normal, -self.normal):
                place = self.begin - half * normal
                equations = self.line(place, normal)
                y = equations.vector(self.point.state, 0.0)
                try:
                    self.start = place, continuation.begin(equations, y, 1.0, False).solution.y
                    return self.window(self.begin, normal, half)
                except (Ended, IntegrationError) as error:
                    failure = failure or error
        raise TssError(
            f"the {self.point.kind} at {self.point.parameter:g} was not found again: {failure}"
        )

    def window(self, centre, normal, half):
        """The special point on a line through a place, from half a window before it on."""
        place = centre - half * normal
        y = self.moved(place, half)
        equations = self.line(centre, normal)
        y[-1] = -half
        first = continuation.begin(equations, y, 1.0, True)
        run = Run(
            equations.at, "s", -half, FAR * half, Curve(equations, first, True, half / STEPS),
            self.cancelled,
        )  # fmt: skip
        found = run.nearest(self.point.kind, MOST_POINTS)
        if found is None:
            raise Ended(f"no {self.point.kind} was found next to the last one")
        self.start, self.normal = (place, first.solution.y), normal
        ahead = centre + found.parameter * normal
        return ahead, CurvePoint(
            *self.values(ahead), found.uncertainty, found.spin_rate_ratio, found.multiplier,
            found.family, found.state,
        )  # fmt: skip

    def moved(self, place, longest):
        """y of the motion with which the last window began, followed to another place."""
        before, y = self.start
        distance = np.linalg.norm(place - before)
        if distance == 0.0:
            return np.array(y)
        equations = self.line(before, (place - before) / distance)
        y = np.append(y[:-1], 0.0)
        curve = Curve(equations, continuation.begin(equations, y, 1.0, False), False, longest)
        for _ in range(MOST_POINTS):
            point = curve.advance()
            if point.tangent[-1] <= 0.0:
                break
            if point.parameter >= distance:
                return _solved_at(equations, point, distance)
        raise Ended("the family turns round before the next window")

    def curve(self, longest, most_points, progress):
        """The points, and why they ended before the stop."""
        sense = math.copysign(1.0, self.stop - self.begin[1])
        place, found = self.again()
        points, tangent, step = [found], np.array([0.0, sense]), min(FIRST_STEP, longest)
        windows, ended = FIRST_WINDOWS, ""
        while len(points) < most_points:
            try:
                ahead, found = self._ahead(place, tangent, step, sense, windows)
            except Cancelled:
                return points, f"canceled at {points[-1].second:.6g}"
            except (Ended, TssError) as error:
                step *= 0.5
                if step < SHORTEST_STEP:
                    return points, f"{error}, beyond {points[-1].second:.6g}"
                continue
            chord = ahead - place
            place, tangent, windows = ahead, chord / np.linalg.norm(chord), (WINDOW,)
            points.append(found)
            if progress is not None:
                share = (place[1] - self.begin[1]) / (self.stop - self.begin[1])
                progress(float(np.clip(share, 0.0, 1.0)), found)
            if place[1] == self.stop:
                return points, ended
            if (place[1] - self.begin[1]) * sense < 0.0:
                return points, f"the curve came back past {points[0].second:g}"
            step = min(1.5 * step, longest)
        return points, f"{most_points} points were found, the last at {points[-1].second:.6g}"

    def _ahead(self, place, tangent, step, sense, windows):
        """The next point a step along a tangent, on the line of the stop if that comes first."""
        centre, normal = place + step * tangent, np.array([-tangent[1], tangent[0]])
        normal *= math.copysign(1.0, normal @ self.normal)
        if (centre[1] - self.stop) * sense >= 0.0:
            centre = place + (self.stop - place[1]) / tangent[1] * tangent
            centre[1], normal = self.stop, np.array([math.copysign(1.0, self.normal[0]), 0.0])
        failure = None
        for window in windows:
            try:
                return self.window(centre, normal, window * step)
            except (Ended, IntegrationError) as error:
                failure = error
        raise failure
