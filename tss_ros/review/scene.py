"""What Rerun shows of a formation, whether from a bag or while it runs.

Satellites with labels and trails, tethers coloured by tension and grey when slack, plots, and the
stability results, on the timelines `sim_time`, `milliturns` (thousandths of a turn) and `step`.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tss_ros.bags.recording import Recording
from tss_ros.core import in_words
from tss_ros.core.stability.law_words import law_in_words
from tss_ros.plots import mode_of
from tss_ros.plots.views import about_normal, views
from tss_ros.review.earth import Earth

APPLICATION = "tss_ros"
#: Seconds of wall time that one turn takes when the viewer plays a recording.
PLAYBACK_TURN_S = 12.0
#: Tensions remembered to tell what is typical.
RECENT_TENSIONS = 10_000
#: Steps sent at a time: what a viewer takes in without a pause.
BATCH_STEPS = 1 << 15

# Light enough for the viewer's dark theme, distinct for every kind of colour vision.
SERIES = np.array(
    [0x56B4E9FF, 0xE69F00FF, 0x00B282FF, 0xCC79A7FF, 0xF0E442FF, 0xD55E00FF], dtype=np.uint32
)
LOW_TENSION, TYPICAL_TENSION, HIGH_TENSION = (60, 130, 255), (250, 225, 90), (235, 60, 30)
SLACK, BEADS, AXES = (125, 125, 125), (200, 200, 200), (150, 150, 150)
#: How far above a formation the eye is that sees the Earth, too, over its reach.
ABOVE_EARTH = 0.8
TETHER_WIDTH, SLACK_WIDTH = rr.Radius.ui_points(2.5), rr.Radius.ui_points(1.0)
TRAIL_WIDTH = rr.Radius.ui_points(1.0)

#: Title, names of the curves (an attribute of Recording, or the names), values (an attribute).
PLOTS = {
    "shape": ("Shape: deviation from the centre of mass [-]", "bead_name", "deviation_from_centre"),
    "length": ("Tether length [m]", "tether_name", "length_m"),
    "tension": ("Tether tension [N]", "tether_name", "tension_n"),
    "deviation": ("Drift: deviation from the frame's origin [-]", "bead_name", "deviation"),
    "energy": ("Energy in the orbit frame [J]", ("energy",), "energy_j"),
    "centre_of_mass": ("Centre of mass [m]", ("x", "y (up)", "z"), "centre_of_mass_m"),
}

#: Those that share the last panel, as tabs.
BEHIND = ("deviation", "centre_of_mass", "energy")
#: Where legends hide the least: drifts grow.
_LEGENDS = {"deviation": rrb.Corner2D.LeftTop, "centre_of_mass": rrb.Corner2D.LeftTop}
#: Parts of the scale of tensions, and its place and height over the reach of the view.
SCALE_PARTS, SCALE_X, SCALE_HEIGHT = 16, 1.15, 1.0
_SCALE = np.linspace(-0.5, 0.5, SCALE_PARTS + 1)


class Scene:
    """One formation in a Rerun recording stream.

    Parameters
    ----------
    stream : rerun.RecordingStream
    recording : tss_ros.bags.recording.Recording
        Says what the formation is; its steps are for `send`.
    root : str
        Entity under which all is put, ending in "/" if not empty.
    earth : bool
        Whether to show the Earth where it is, in its size.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        recording: Recording,
        root: str = "",
        earth: bool = False,
    ) -> None:
        self.root = root
        self.earth = Earth(stream, f"{root}formation/earth", recording) if earth else None
        self.turn_s = recording.turn_s
        self._spin_axis, self.spins_about = recording.spin_axis, recording.spins_about
        self.seen = views(recording.spins_about)[0]
        self.has_stability, self.mode_title, self.mode_view = False, "", None
        self._stream = stream
        self._satellites = np.flatnonzero(recording.is_satellite)
        self._others = np.flatnonzero(~recording.is_satellite)
        self._ends = recording.tether_ends
        self.trails = {
            i: f"{root}formation/trails/{rr.escape_entity_path_part(recording.bead_name[i])}"
            for i in self._satellites
        }
        self._last_position_m = None
        self._recent_tension_n, self._typical_n = np.empty(0), 0.0
        self.tension_range_n = None
        self._send_static(recording)

    def send(self, recording: Recording) -> None:
        """Send the steps of `recording`, which follow those sent before."""
        turns = recording.turns
        curves = {
            plot: np.reshape(getattr(recording, attribute), (len(turns), -1))
            for plot, (_, _, attribute) in PLOTS.items()
        }
        for first in range(0, len(turns), BATCH_STEPS):
            steps = slice(first, first + BATCH_STEPS)
            when = _when(recording, steps)
            self._send_formation(when, recording, steps)
            self._send_scale(_when(recording, slice(first, first + 1)))
            if self.earth:
                self.earth.send(when, recording.t_s[steps])
            for plot, values in curves.items():
                columns = rr.Scalars.columns(scalars=values[steps].ravel())
                path = f"{self.root}plots/{plot}"
                self._stream.send_columns(path, when, columns.partition(_lengths(values[steps])))
        if recording.stability:
            self.send_stability(recording.stability)

    def send_stability(self, results: Iterable[Any]) -> None:
        """Show messages FloquetResult as a table, instead of those sent before."""
        self.has_stability, results = True, list(results)
        text = stability_table(results)
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        self._stream.log(f"{self.root}stability", document, static=True)
        shown = [result for result in results if result.mode]
        if shown:
            self._send_mode(mode_of(shown[-1], self._spin_axis))

    def _send_mode(self, mode):
        """Show a mode in the frame that turns with the formation, from the start of the run."""
        self.mode_title, self.mode_view = " ".join(mode.title.split()), mode.view
        size_m = np.max(np.linalg.norm(self._last_position_m, axis=-1))
        when = [
            rr.TimeColumn("sim_time", duration=mode.turns * self.turn_s),
            rr.TimeColumn("milliturns", sequence=np.rint(1e3 * mode.turns).astype(int)),
        ]
        moved = size_m * (mode.place + mode.shift)
        rest = size_m * mode.place[0][mode.tether_ends]
        self._log("mode", rr.ViewCoordinates.RIGHT_HAND_Y_UP)
        self._log("mode/undisturbed", rr.LineStrips3D(rest, colors=SLACK, radii=SLACK_WIDTH))
        beads = rr.Points3D.columns(positions=moved.reshape(-1, 3)).partition(_lengths(moved))
        self._stream.send_columns(f"{self.root}mode/beads", when, beads)
        strips = moved[:, mode.tether_ends]
        tethers = rr.LineStrips3D.columns(strips=strips.reshape(-1, 2, 3))
        self._stream.send_columns(
            f"{self.root}mode/tethers", when, tethers.partition(_lengths(strips))
        )
        self._log(
            "mode/beads",
            rr.Points3D.from_fields(
                colors=_colours(range(moved.shape[1])), radii=rr.Radius.ui_points(6)
            ),
        )
        style = rr.LineStrips3D.from_fields(colors=TYPICAL_TENSION, radii=TETHER_WIDTH)
        self._log("mode/tethers", style)

    def _send_formation(self, when, recording, steps):
        position_m, taut = recording.position_m[steps], recording.taut[steps]
        tension_n = recording.tension_n[steps]
        self._send_points(when, "satellites", position_m[:, self._satellites])
        if self._others.size:
            self._send_points(when, "beads", position_m[:, self._others])
        self._send_trails(when, position_m)
        self._send_tethers(when, position_m, tension_n, taut)
        if self._last_position_m is None:
            self._send_axes(position_m[0])
        self._last_position_m = position_m[-1]

    def _log(self, path, *what):
        self._stream.log(self.root + path, *what, static=True)

    def _send_static(self, recording):
        log = self._log
        log("formation", rr.ViewCoordinates.RIGHT_HAND_Y_UP)
        log(
            "formation/satellites",
            rr.Points3D.from_fields(
                labels=[recording.bead_name[i] for i in self._satellites],
                colors=_colours(self._satellites),
                radii=rr.Radius.ui_points(7),
                show_labels=True,
            ),
        )
        if self._others.size:
            dots = rr.Points3D.from_fields(radii=rr.Radius.ui_points(3), colors=BEADS)
            log("formation/beads", dots)
        names = list(recording.tether_name)
        numbers = rr.Points3D.from_fields(
            colors=AXES, radii=rr.Radius.ui_points(1), show_labels=True
        )
        log("formation/scale/numbers", numbers)
        log("formation/tethers", rr.LineStrips3D.from_fields(labels=names, show_labels=False))
        for i, path in self.trails.items():
            style = rr.LineStrips3D.from_fields(colors=_colours([i]), radii=TRAIL_WIDTH)
            self._stream.log(path, style, static=True)
        for plot, (_, names, _) in PLOTS.items():
            names = list(getattr(recording, names) if isinstance(names, str) else names)
            colours = _colours(range(len(names)))
            log(f"plots/{plot}", rr.SeriesLines(names=names, colors=colours, widths=1.5))

    def _send_points(self, when, name, position_m):
        columns = rr.Points3D.columns(positions=position_m.reshape(-1, 3))
        path = f"{self.root}formation/{name}"
        self._stream.send_columns(path, when, columns.partition(_lengths(position_m)))

    def _send_trails(self, when, position_m):
        first = position_m[:1] if self._last_position_m is None else self._last_position_m[None]
        previous = np.concatenate([first, position_m[:-1]])
        for i, path in self.trails.items():
            strips = np.stack([previous[:, i], position_m[:, i]], axis=1)
            self._stream.send_columns(path, when, rr.LineStrips3D.columns(strips=strips))

    def _send_tethers(self, when, position_m, tension_n, taut):
        strips = position_m[:, self._ends].reshape(-1, 2, 3)
        columns = rr.LineStrips3D.columns(
            strips=strips,
            colors=self._tension_colours(tension_n, taut).reshape(-1, 3),
            radii=np.where(taut.ravel(), TETHER_WIDTH, SLACK_WIDTH),
        )
        path = f"{self.root}formation/tethers"
        self._stream.send_columns(path, when, columns.partition(_lengths(tension_n)))

    def _tension_colours(self, tension_n, taut):
        """Colours from a tenth to ten times the tension typical of what was sent lately."""
        known = np.concatenate([self._recent_tension_n, tension_n[taut & (tension_n > 0)]])
        self._recent_tension_n = known[-RECENT_TENSIONS:]
        self._typical_n = typical = float(np.median(known)) if known.size else 1.0
        decade = np.log10(np.maximum(tension_n, 1e-3 * typical) / typical)
        return np.where(taut[..., None], _colour_of(decade), SLACK).astype(np.uint8)

    def _send_scale(self, when):
        """A bar beside the formation that says what its tethers' colours mean, from now on."""
        right, up, _ = self.reach_m * self.seen.axes
        ends = SCALE_X * right + SCALE_HEIGHT * _SCALE[:, None] * up
        bar = np.stack([ends[:-1], ends[1:]], axis=1)
        colours = _colour_of(2.0 * (_SCALE[:-1] + _SCALE[1:])).astype(np.uint8)
        self._log("formation/scale", rr.LineStrips3D(bar, colors=colours, radii=TETHER_WIDTH))
        labels = [f"{factor * self._typical_n:.2g} N" for factor in (0.1, 1.0, 10.0)]
        places = ends[[0, SCALE_PARTS // 2, SCALE_PARTS]] + 0.12 * right
        points = rr.Points3D.columns(positions=places, labels=labels)
        path = f"{self.root}formation/scale/numbers"
        self._stream.send_columns(path, when, points.partition([len(labels)]))

    def _send_axes(self, position_m):
        self.reach_m = 1.2 * np.linalg.norm(position_m, axis=-1).max()
        directions = {"up": (0.0, 1.0, 0.0), "flight": (-1.0, 0.0, 0.0)}
        if self.spins_about is not None and not about_normal(self.spins_about):
            directions["spin axis"] = self.spins_about
        axes = rr.Arrows3D(
            vectors=self.reach_m / 6 * np.array(list(directions.values())),
            labels=list(directions),
            colors=AXES,
            radii=TRAIL_WIDTH,
        )
        self._log("formation/axes", axes)


def layout(scenes: Sequence[Scene], titles: Sequence[str]) -> rrb.Blueprint:
    """The viewer's layout: a formation with its plots beside it, or several formations in columns.

    Parameters
    ----------
    scenes : list of Scene
        Each with at least one step sent.
    titles : list of str
        Name of each formation's view.

    Returns
    -------
    rerun.blueprint.Blueprint
    """
    columns = []
    for scene, title in zip(scenes, titles):
        views = [_formation_view(scene, title)]
        if scene.has_stability:
            origin = f"{scene.root}stability"
            views.append(rrb.TextDocumentView(origin=origin, name="Stability results"))
        if scene.mode_title:
            eye = _eye(scene.mode_view, scene.reach_m, 1.3)
            views.append(
                rrb.Spatial3DView(
                    origin=f"{scene.root}mode", name=scene.mode_title, line_grid=False,
                    eye_controls=eye,
                )
            )  # fmt: skip
        before = [_plot_view(scene, plot) for plot in PLOTS if plot not in BEHIND]
        plots = rrb.Vertical(*before, rrb.Tabs(*(_plot_view(scene, plot) for plot in BEHIND)))
        if len(scenes) == 1:
            left = rrb.Vertical(*views, row_shares=[3, 1, 2][: len(views)])
            columns.append(rrb.Horizontal(left, plots, column_shares=(3, 2)))
        else:
            columns.append(rrb.Vertical(rrb.Tabs(*views), plots, row_shares=(2, 3)))
    pace = min(scene.turn_s for scene in scenes) / PLAYBACK_TURN_S
    return rrb.Blueprint(
        columns[0] if len(columns) == 1 else rrb.Horizontal(*columns),
        rrb.TimePanel(timeline="sim_time", state="collapsed", playback_speed=pace),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def _formation_view(scene, title):
    # Trails end at the next satellite, so that those on one circle do not cover each other.
    part = scene.turn_s / len(scene.trails)
    now = rrb.TimeRangeBoundary.cursor_relative()
    trail = rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(
                "sim_time", start=rrb.TimeRangeBoundary.cursor_relative(seconds=-part), end=now
            ),
            rrb.VisibleTimeRange(
                "milliturns",
                start=rrb.TimeRangeBoundary.cursor_relative(seq=-1000 // len(scene.trails)),
                end=now,
            ),
        ]
    )
    # From above, the Earth's edge is in the picture.
    eye = _eye(scene.seen, scene.reach_m, -ABOVE_EARTH if scene.earth else 0.6)
    return rrb.Spatial3DView(
        origin=f"{scene.root}formation",
        overrides=dict.fromkeys(scene.trails.values(), trail),
        line_grid=False,
        name=title,
        eye_controls=eye,
    )


def _eye(view, reach_m, below):
    """Where a formation is seen from: in a view, and so far below, over its reach."""
    _, up, towards = view.axes
    return rrb.EyeControls3D(
        position=reach_m * (2.2 * towards - below * up), look_target=(0, 0, 0), eye_up=up
    )


def _plot_view(scene, plot):
    everything = rr.TimeRange(
        start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
    )
    name, axis_y = PLOTS[plot][0], None
    if plot == "tension" and scene.tension_range_n:
        axis_y = rrb.ScalarAxis(range=scene.tension_range_n)
        name += f", spikes cut at {scene.tension_range_n[1]:.3g} N"
    return rrb.TimeSeriesView(
        origin=f"{scene.root}plots/{plot}",
        name=name,
        axis_x=rrb.TimeAxis(view_range=everything),
        axis_y=axis_y,
        plot_legend=rrb.PlotLegend(corner=_LEGENDS.get(plot, rrb.Corner2D.RightTop)),
    )


def stability_table(results: Iterable[Any]) -> str:
    """Messages FloquetResult as a Markdown table, by rate."""
    rows = ["| rate/Omega | max modulus | decided by | verdict | tether law |"]
    rows.append("|---:|---:|---:|---|---|")
    for r in sorted(results, key=lambda result: result.spin_rate_ratio):
        verdict = r.verdict or r.message
        decided = in_words(r.deciding_family, r.deciding_modulus, r.closure_residual)
        rows.append(
            f"| {r.spin_rate_ratio:.5g} | {r.max_modulus:.6f} | {decided} "
            f"| {verdict} | {law_in_words(r.tether_law, r.pushing_share)} |"
        )
    return "\n".join(rows)


def _when(recording, steps):
    """Times of some steps on all timelines."""
    milliturns = np.rint(1e3 * recording.turns[steps]).astype(int)
    return [
        rr.TimeColumn("sim_time", duration=recording.t_s[steps]),
        rr.TimeColumn("milliturns", sequence=milliturns),
        rr.TimeColumn("step", sequence=recording.step[steps]),
    ]


def _colour_of(decade):
    """Colours (..., 3) of tensions, by the decimal logarithm of how many times typical they are."""
    anchors = np.array([LOW_TENSION, TYPICAL_TENSION, HIGH_TENSION])
    return np.stack([np.interp(decade, (-1, 0, 1), anchor) for anchor in anchors.T], axis=-1)


def _lengths(values):
    """How many instances each of k steps has, as `send_columns` wants it."""
    return np.full(values.shape[0], values.shape[1])


def _colours(indices):
    return SERIES[np.asarray(indices) % len(SERIES)]
