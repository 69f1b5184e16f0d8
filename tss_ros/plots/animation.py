"""Animations: of a motion beside its tether lengths, and of a mode. They show in notebooks."""

import base64
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.ticker import MaxNLocator
from PIL import Image

from tss_ros.core import ModeMotion, Trajectory, TssError
from tss_ros.core.presentation import turn_in_words
from tss_ros.plots.mode_shapes import ShownMode, mode_pictures, shown_motion
from tss_ros.plots.style import Figure
from tss_ros.plots.views import about_normal, is_narrow, views, width_limits

FRAME_MS, FRAMES = 70, 90
#: Colours of an animation's one palette, and pictures that it is chosen from.
PALETTE, CHOSEN_FROM = 64, 6
NIGHT, INK, FAINT, SLACK = "#0d1424", "#e6ebf5", "#2a3550", "#8a94a8"
TENSIONS = LinearSegmentedColormap.from_list(
    "tension", ["#3f6fd8", "#36c5d6", "#ffd24a", "#ff5d3a"]
)
BEADS = ("#5cb8ff", "#ff9e42", "#73e08c", "#d58cff", "#ffe066", "#ff7b7b")
#: Share of the turns for which a satellite leaves a trail.
TRAIL = 0.2
#: Tension of the brightest colour, over the mean one.
BRIGHTEST = 3.0


class Animation:
    """Pictures that follow each other: saved as a GIF, shown by notebooks.

    Attributes
    ----------
    gif : bytes
        The whole file.
    frames : int
    """

    def __init__(self, pictures: Iterator[Image.Image]) -> None:
        pictures = list(pictures)
        self.frames = len(pictures)
        chosen = pictures[:: max(1, self.frames // CHOSEN_FROM)]
        self.size = chosen[0].size
        sheet = Image.new("RGB", (self.size[0], self.size[1] * len(chosen)))
        for i, picture in enumerate(chosen):
            sheet.paste(picture, (0, i * self.size[1]))
        # One palette for all and no dithering: it would flicker, and make the file large.
        palette = sheet.quantize(PALETTE, method=Image.Quantize.MAXCOVERAGE)
        first, *others = (p.quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures)
        stream = io.BytesIO()
        first.save(
            stream, format="GIF", save_all=True, append_images=others, duration=FRAME_MS, loop=0,
            optimize=True,
        )  # fmt: skip
        self.gif = stream.getvalue()

    def save(self, path: str | Path) -> None:
        """Write it to a file; OSError if that cannot be."""
        Path(path).write_bytes(self.gif)

    def __repr__(self) -> str:
        size = " x ".join(map(str, self.size))
        return f"<Animation of {self.frames} pictures, {size}, {len(self.gif) / 1e3:.0f} kB>"

    def _repr_html_(self):
        data = base64.b64encode(self.gif).decode()
        return f'<img alt="{self.frames} pictures" src="data:image/gif;base64,{data}">'


def animate(
    shown: Trajectory | ModeMotion | ShownMode, frames: int = FRAMES, title: str = ""
) -> Animation:
    """The animation of a motion or of a mode.

    A motion is seen along the axis of its spin, in the frame that turns with it, and in the orbit
    frame: from the orbit's north, or from the side if the axis is another than its normal. A
    formation that hangs is seen from the north and from ahead. Below are its tether lengths. A
    tether's colour is its tension; slack tethers are dotted.

    Parameters
    ----------
    shown : Trajectory, ModeMotion or ShownMode
    frames : int
        Pictures of a motion, at most as many as it has states.
    title : str
        Of a motion; says the rate if empty.

    Returns
    -------
    Animation

    Raises
    ------
    TssError
        If it is neither, or for a number of pictures that is not allowed.
    """
    if isinstance(shown, ModeMotion):
        shown = shown_motion(shown)
    if isinstance(shown, ShownMode):
        return Animation(mode_pictures(shown))
    if not isinstance(shown, Trajectory):
        raise TssError(
            f"shown must be a Trajectory, a ModeMotion or a ShownMode, got {shown!r:.80}"
        )
    if isinstance(frames, bool) or not isinstance(frames, int) or not 2 <= frames <= 10_000:
        raise TssError(f"frames must be a whole number from 2 to 10000, got {frames!r:.80}")
    if len(shown) < 2:
        raise TssError(f"a motion needs at least 2 states to be animated, got {len(shown)}")
    title = title or (f"ω = {shown.spin_rate_ratio:g} Ω" if shown.spin_rate_ratio else "hanging")
    return Animation(_MotionPictures(shown, title).pictures(frames))


class _MotionPictures:
    """The figure of a motion, drawn anew for each picture."""

    def __init__(self, motion, title):
        self.motion, self.title = motion, title
        self.turn = turn_in_words(motion.spin_rate_ratio)
        self.figure = Figure(figsize=(7.6, 5.6), dpi=76, layout="constrained", facecolor=NIGHT)
        self.canvas = FigureCanvasAgg(self.figure)
        grid = self.figure.add_gridspec(2, 3, height_ratios=(3, 1), width_ratios=(1, 1, 0.05))
        pulled = motion.tension_n[motion.taut]
        self.mean_n = float(np.median(pulled)) if pulled.size else 1.0
        along, side = views(motion.spins_about)
        hangs = motion.spins_about is None
        upright = hangs or about_normal(motion.spins_about)
        places = grid[0, 0], grid[0, 1]
        if hangs:
            of = [(view, motion.position_m, view.title, view.names) for view in (along, side)]
        else:
            seen = along if upright else side
            where = "orbit frame" if upright else f"orbit frame, {side.title}"
            of = [
                (along, motion.turning_m, "turning with the spin", ("x'", "y'")),
                (seen, motion.position_m, where, seen.names),
            ]
        self.views = [self._view(place, *view) for place, view in zip(places, of)]
        self._lengths(grid[1, :2])
        bar = self.figure.colorbar(
            ScalarMappable(Normalize(0.0, BRIGHTEST), TENSIONS),
            cax=self.figure.add_subplot(grid[0, 2]), extend="max",
        )  # fmt: skip
        bar.set_label("tension over the median one [-]\n(slack: dotted)")
        self.heading = self.figure.suptitle(title, color=INK, fontsize=12)
        for axes in self.figure.axes:
            axes.set_facecolor(NIGHT)
            axes.tick_params(colors=SLACK, labelsize=8)
            axes.spines[:].set_color(FAINT)
            for text in (axes.title, axes.xaxis.label, axes.yaxis.label):
                text.set(color=INK, fontsize=9)

    def _view(self, place, view, position_m, title, names):
        """An axes, and what moves in it."""
        motion, axes = self.motion, self.figure.add_subplot(place)
        seen, radius_m = view.of(position_m), motion.reference_radius_m.max()
        reach_km = 1.22 * radius_m / 1e3
        thin = motion.spins_about is None and is_narrow(seen)
        unit_m = np.array([1.0 if thin else 1e3, 1e3])
        axes.set(ylim=(-reach_km, reach_km))
        if thin:
            axes.set(xlim=width_limits(seen))
            axes.xaxis.set_major_locator(MaxNLocator(4))
            title += ",\nwidths not to scale"
        else:
            axes.set(xlim=(-reach_km, reach_km), aspect="equal")
            round_ = radius_m / 1e3 * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 121))
            axes.plot(round_.real, round_.imag, color=FAINT, linewidth=1.0)
        if motion.spins_about is not None:
            axis = view.of(motion.spins_about)
            if np.any(np.abs(axis) > 1e-9):
                axes.axline((0.0, 0.0), tuple(axis), color=SLACK, linestyle="-.", linewidth=1.0)
        axes.set(title=title, xlabel=f"{names[0]} [{'m' if thin else 'km'}]")
        axes.set(ylabel=f"{names[1]} [km]")
        tethers = axes.add_collection(LineCollection([], linewidths=2.2, zorder=3))
        satellites = np.flatnonzero(motion.system.is_satellite)
        colours = [BEADS[k % len(BEADS)] for k in range(len(satellites))]
        trails = [axes.plot([], [], color=c, linewidth=1.2, alpha=0.7)[0] for c in colours]
        zero = np.zeros(len(satellites))
        dots = axes.scatter(zero, zero, s=48, c=colours, zorder=4)
        return seen / unit_m, satellites, tethers, trails, dots

    def _lengths(self, place):
        motion, axes = self.motion, self.figure.add_subplot(place)
        percent = 100.0 * motion.length_m / motion.system.rest_length_m
        taut = np.where(motion.taut, 100.0, percent)
        axes.plot(motion.turns, taut, color=INK, linewidth=0.9, alpha=0.85)
        axes.axhline(100.0, color=FAINT, linewidth=1.0)
        axes.set_ylim(min(99.9, taut.min()) - 0.1 * np.ptp(taut), 100.02 + 0.1 * np.ptp(taut))
        axes.ticklabel_format(axis="y", useOffset=False)
        axes.set(xlim=(motion.turns[0], motion.turns[-1]), xlabel=f"{self.turn}s [-]")
        axes.set_ylabel("tether lengths\n[% of rest]")
        self.cursor = axes.axvline(0.0, color=TENSIONS(0.7), linewidth=1.4)

    def pictures(self, frames):
        """So many pictures, or as many as there are states."""
        self.draw(0)
        self.figure.set_layout_engine("none")  # the layout stays, and pictures are drawn faster
        last = len(self.motion) - 1
        for k in np.linspace(0, last, min(frames, last + 1)).round().astype(int):
            self.draw(k)
            yield Image.fromarray(np.asarray(self.canvas.buffer_rgba())[..., :3].copy())

    def draw(self, k):
        """Draw state k."""
        motion = self.motion
        turn, taut = motion.turns[k], motion.taut[k]
        shade = TENSIONS(np.clip(motion.tension_n[k] / self.mean_n / BRIGHTEST, 0.0, 1.0))
        first = np.searchsorted(motion.turns, turn - TRAIL * (motion.turns[-1] - motion.turns[0]))
        for place_km, satellites, tethers, trails, dots in self.views:
            tethers.set_segments(place_km[k][motion.system.tether_ends])
            tethers.set_color([c if t else SLACK for c, t in zip(shade, taut)])
            tethers.set_linestyle(["-" if t else ":" for t in taut])
            dots.set_offsets(place_km[k, satellites])
            for i, line in zip(satellites, trails):
                line.set_data(*place_km[first : k + 1, i].T)
        self.cursor.set_xdata([turn, turn])
        self.heading.set_text(f"{self.title}: {self.turn} {turn:.1f}")
        self.canvas.draw()
