"""Pictures and animations of the mode behind a Floquet multiplier.

The formation is drawn in the frame that turns with it, where it stands still unless disturbed. A
mode along the spin axis is seen from above the edge of the plane across the axis, with its heights
as stems; one in that plane along the axis. A formation that hangs is seen from the orbit's north,
or from ahead if its mode is out of the orbit plane.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import ArrayLike
from PIL import Image

from tss_ros.core import ModeMotion
from tss_ros.core.model.system import ORBIT_NORMAL
from tss_ros.core.presentation import a_turn, turn_in_words
from tss_ros.plots.style import COLOURS, INK, Figure, finish, series_style
from tss_ros.plots.views import View, about_normal, counted, views

#: Largest displacement drawn, over the formation's radius; turns shown, fewer where growth in them
#: would exceed a factor.
LARGEST, TURNS, MOST_GROWTH = 0.35, 3, 30.0
#: Phases of a cycle that a still picture shows, and pictures of an animation.
PHASES, FRAMES = 5, 60
#: Where a mode out of the plane is seen from [rad]: turned about the spin axis, above the plane.
AZIMUTH, ELEVATION = math.radians(-25.0), math.radians(24.0)
#: How far a picture of a formation that hangs goes down, for the words below.
BELOW = 1.25
#: Share of a mode's motion out of the plane above which it is drawn as such.
ABOVE = 0.5
#: Distance from the centre, over the radius, below which a bead has no direction of its own.
NEAR_CENTRE = 0.05
DPI = 100


@dataclass(frozen=True)
class ShownMode:
    """A mode along some turns, scaled for the eye.

    Attributes
    ----------
    turns : ndarray, shape (k,)
    place, shift : ndarray, shape (k, n, 3)
        Undisturbed positions and displacements over the radius.
    tether_ends : ndarray, shape (m, 2)
    above : bool
        Whether the mode is out of the plane across the spin axis, the orbit plane if the formation
        hangs.
    title : str
    spins_about : ndarray, shape (3,), or None
        As of `core.ModeMotion`.
    """

    turns: np.ndarray
    place: np.ndarray
    shift: np.ndarray
    tether_ends: np.ndarray
    above: bool
    title: str
    spins_about: np.ndarray | None

    @property
    def turn(self) -> str:
        """What is counted: "turn", or "orbit" of a formation that hangs."""
        return turn_in_words(self.spins_about is not None)

    @property
    def view(self) -> View:
        """Where it is seen from: along the axis of the spin, or how its motion is seen best."""
        along, side = views(self.spins_about)
        return side if self.above and self.spins_about is None else along

    def heights(self, vector: np.ndarray) -> np.ndarray:
        """Parts (...) of vectors (..., 3) towards the eye."""
        return vector @ self.view.axes[2]


def shown_mode(
    turns: ArrayLike,
    position_m: ArrayLike,
    shape: ArrayLike,
    multiplier: complex,
    tether_ends: ArrayLike,
    title: str,
    spins_about: ArrayLike | None = ORBIT_NORMAL,
) -> ShownMode:
    """Go on with a mode from its first turn, as `core.mode_motion` or message Mode have it.

    Parameters
    ----------
    turns : array (k,)
        Times over the period, from 0 to 1.
    position_m : array (k, n, 3)
        Undisturbed positions in the turning frame [m].
    shape : array (k, n, 3), complex
        Displacements.
    multiplier : complex
        By which they are multiplied from turn to turn.
    tether_ends : array (m, 2) of int
    title : str
    spins_about : array (3,), optional
        Unit vector of the spin's axis in the orbit frame; None for a formation that hangs.

    Returns
    -------
    ShownMode
    """
    turns, shape = np.asarray(turns, dtype=float), np.asarray(shape)
    place = np.asarray(position_m, dtype=float)
    place = place / np.max(np.linalg.norm(place, axis=2))
    growth = abs(multiplier)
    count = TURNS
    if growth > 1.0:
        count = min(TURNS, max(1, int(math.log(MOST_GROWTH) / math.log(growth))))
    later = [shape[:-1] * multiplier**k for k in range(count)]
    shift = np.concatenate([*later, shape[:1] * multiplier**count]).real
    shift = shift * (LARGEST / max(np.max(np.linalg.norm(shift, axis=2)), 1e-300))
    normal = views(spins_about)[0].axes[2]
    return ShownMode(
        np.concatenate([turns[:-1] + k for k in range(count)] + [[count]]),
        np.concatenate([place[:-1]] * count + [place[-1:]]),
        shift,
        np.asarray(tether_ends),
        bool(np.sum((shift @ normal) ** 2) > ABOVE * np.sum(shift**2)),
        title,
        None if spins_about is None else np.asarray(spins_about, dtype=float),
    )


def shown_motion(motion: ModeMotion) -> ShownMode:
    """Go on with a mode from its first turn, with a title.

    Parameters
    ----------
    motion : ModeMotion

    Returns
    -------
    ShownMode
    """
    return shown_mode(
        motion.turns, motion.position_m, motion.shape, motion.multiplier, motion.tether_ends,
        f"{motion.family}, |ρ| = {abs(motion.multiplier):.6f}"
        f" {a_turn(motion.spins_about is not None)}",
        motion.spins_about,
    )  # fmt: skip


def mode_of(result: Any, spin_axis: ArrayLike = ORBIT_NORMAL) -> ShownMode:
    """The mode that a message FloquetResult carries, with a title.

    Parameters
    ----------
    result : message FloquetResult
        With one mode.
    spin_axis : array (3,)
        Unit vector of the spin's axis in the orbit frame, if the formation spins.

    Returns
    -------
    ShownMode
    """
    (mode,) = result.mode
    rho, spin = complex(mode.multiplier_real, mode.multiplier_imag), result.spin_rate_ratio
    shape = np.asarray(mode.shape_real) + 1j * np.asarray(mode.shape_imag)
    places = (len(mode.turns), -1, 3)
    return shown_mode(
        mode.turns,
        np.reshape(mode.position_m, places),
        shape.reshape(places),
        rho,
        np.reshape(mode.tether_ends, (-1, 2)),
        f"{f'spin {spin:g} Ω' if spin else 'hanging'}, {result.verdict}, |ρ| = {abs(rho):.6f}"
        f" {a_turn(spin)}, {result.tether_law}\n{mode.resonance or mode.in_words}",
        spin_axis if spin else None,
    )


def mode_shape(mode: ShownMode) -> Figure:
    """The formation at some phases of a cycle, and the displacement of every bead against turns.

    Parameters
    ----------
    mode : ShownMode

    Returns
    -------
    matplotlib.figure.Figure
        Two axes: the formation, undisturbed as a broken line, and displacements over the radius.
    """
    figure, formation, curves = _figure(mode)
    steps = np.linspace(*_half_cycle(mode), PHASES).round().astype(int)
    for j, step in enumerate(steps):
        _draw_formation(formation, mode, step, 0.2 + 0.8 * j / (PHASES - 1), j == PHASES - 1)
    curves.axvspan(mode.turns[steps[0]], mode.turns[steps[-1]], color="0.93", zorder=0)
    first, last = mode.turns[steps[[0, -1]]]
    _say(formation, mode, f"{mode.turn} {first:.2f} (faint) to {last:.2f}")
    return figure


def mode_pictures(mode: ShownMode) -> Iterator[Image.Image]:
    """The mode's motion, picture by picture.

    Parameters
    ----------
    mode : ShownMode

    Yields
    ------
    PIL.Image.Image
    """
    figure, formation, curves = _figure(mode)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    figure.set_layout_engine("none")  # to place the axes anew would take most of the time
    cursor = curves.axvline(0.0, color=INK, linewidth=0.9)
    limits = formation.get_xlim(), formation.get_ylim()
    fixed = len(formation.lines), len(formation.texts)
    for step in np.linspace(0, mode.turns.size - 1, FRAMES).round().astype(int):
        for artist in (*formation.lines[fixed[0] :], *formation.texts[fixed[1] :]):
            artist.remove()
        for collection in list(formation.collections):
            collection.remove()
        _draw_formation(formation, mode, step, 1.0, True)
        _say(formation, mode, f"{mode.turn} {mode.turns[step]:.2f}")
        formation.set(xlim=limits[0], ylim=limits[1])
        cursor.set_xdata([mode.turns[step]] * 2)
        canvas.draw()
        yield Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def _figure(mode: ShownMode) -> tuple[Figure, Axes, Axes]:
    """The figure with what does not move: the formation at rest, and all curves."""
    figure = Figure(figsize=(9.6, 4.6), dpi=DPI, layout="constrained")
    formation, curves = figure.subplots(1, 2, width_ratios=(1.0, 1.0))
    figure.suptitle(mode.title, color=INK, fontsize=11)
    formation.set_aspect("equal")
    formation.axis("off")
    _draw_tethers(formation, mode, _seen(mode, mode.place[0]), color="0.6", linestyle="--", lw=1.0)
    reach = np.concatenate([_seen(mode, mode.place[0]), _seen(mode, mode.place + mode.shift)], None)
    half = 1.08 * max(np.max(np.abs(reach)), 0.5)
    lower = -half if mode.spins_about is not None else -BELOW * half
    formation.set(xlim=(-half, half), ylim=(lower, half))
    values, label = _largest_part(mode)
    for i, curve in enumerate(values.T):
        curves.plot(mode.turns, curve, **series_style(i), linewidth=1.2)
    curves.margins(x=0.0)
    finish(curves, counted(mode.turn), label)
    return figure, formation, curves


def _largest_part(mode):
    """The displacements (k, n) that tell the most of a mode, and what they are."""
    axes, names = mode.view.axes, mode.view.names
    if mode.spins_about is None:
        across, up = mode.view.of(mode.shift).transpose(2, 0, 1)
        sideways = np.sum(across**2) > np.sum(up**2)
        name = names[0 if sideways else 1].partition(",")[0]
        label = f"displacement along {name}\nover the radius [-]"
        return across if sideways else up, label
    if mode.above:
        plane = "orbit plane" if about_normal(mode.spins_about) else "plane across the axis"
        return mode.heights(mode.shift), f"height over the {plane}\nover the radius [-]"
    outward = _outward(mode.place)
    along = np.cross(axes[2], outward)
    radial, tangential = (np.sum(mode.shift * x, axis=2) for x in (outward, along))
    radially = np.sum(radial**2) > np.sum(tangential**2)
    label = f"{'outward' if radially else 'sideways'} displacement\nover the radius [-]"
    return radial if radially else tangential, label


def _outward(place):
    """Unit vectors from the centre; a bead that stays near it has the direction of the farthest."""
    size = np.linalg.norm(place, axis=2, keepdims=True)
    outward = place / np.maximum(size, 1e-9)
    near = np.min(size[:, :, 0], axis=0) < NEAR_CENTRE
    outward[:, near] = outward[:, [np.argmax(np.mean(size[:, :, 0], axis=0))]]
    return outward


def _seen(mode, position):
    """Where positions (..., n, 3) are on the picture, (..., n, 2)."""
    x, y, z = np.moveaxis(position @ mode.view.axes.T, -1, 0)
    if not mode.above or mode.spins_about is None:
        return np.stack([x, y], axis=-1)
    across = math.cos(AZIMUTH) * x - math.sin(AZIMUTH) * y
    away = math.sin(AZIMUTH) * x + math.cos(AZIMUTH) * y
    return np.stack([across, math.sin(ELEVATION) * away + math.cos(ELEVATION) * z], axis=-1)


def _draw_tethers(axes, mode, seen, **style):
    pen = np.full((len(mode.tether_ends), 3, 2), np.nan)
    pen[:, :2] = seen[mode.tether_ends]
    axes.plot(*pen.reshape(-1, 2).T, **style)


def _draw_formation(axes, mode, step, strength, beads):
    """The disturbed formation at one step; of the last one beads and stems as well."""
    place, moved = mode.place[step], mode.place[step] + mode.shift[step]
    seen = _seen(mode, moved)
    if mode.above and beads and mode.spins_about is not None:
        heights = mode.heights(mode.shift[step])
        for foot, head, height in zip(_seen(mode, place), seen, heights):
            colour = COLOURS[1] if height > 0.0 else COLOURS[0]
            axes.plot(*np.transpose([foot, head]), color=colour, lw=2.0, alpha=0.7, zorder=2)
    _draw_tethers(axes, mode, seen, color=INK, lw=1.5, alpha=strength, zorder=3)
    if beads:
        colours = [COLOURS[i % len(COLOURS)] for i in range(len(seen))]
        axes.scatter(*seen.T, s=46, c=colours, edgecolors=INK, linewidths=0.8, zorder=4)


def _say(axes, mode, when):
    """Under the formation, what is seen."""
    hangs = mode.spins_about is None
    frame = "orbit" if hangs else "turning"
    if mode.above and not hangs:
        seen = "orange above, blue below the plane"
    elif hangs or not about_normal(mode.spins_about):
        seen = f"seen {mode.view.title}"
    else:
        seen = "seen from the orbit's north"
    axes.text(
        0.5, 0.02, f"{when}, in the {frame} frame\n{seen}; broken: undisturbed",
        transform=axes.transAxes, ha="center", va="bottom", color="0.4", fontsize=8.5,
    )  # fmt: skip


def _half_cycle(mode):
    """First and last step of half a cycle, the largest displacement at one of its ends.

    It ends there, or begins there if less than a turn comes before.
    """
    largest = int(np.argmax(np.linalg.norm(mode.shift, axis=(1, 2))))
    per_turn = int(round(1.0 / (mode.turns[1] - mode.turns[0])))
    first = largest - per_turn if largest >= per_turn else largest
    near = mode.shift[first : first + per_turn + 1]
    likeness = np.tensordot(near, mode.shift[largest], axes=([1, 2], [0, 1]))
    return sorted((first + int(np.argmin(likeness)), largest))
