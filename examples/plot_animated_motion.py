"""
A motion, animated
==================

At twice the orbital rate a push of 10 m is enough: tethers go slack, jerk taut again, and within
three turns the ring is lost. The same motion is shown twice, in the frame that turns with the spin
and in the orbit frame. ``python examples/plot_animated_motion.py ring.gif`` saves it.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from PIL import Image, ImageSequence

from tss_ros.core import Propagator, disturbed, initial_state, ring, tether_state

NIGHT, INK, FAINT, SLACK = "#0d1424", "#e6ebf5", "#2a3550", "#8a94a8"
TENSION_COLOURS = LinearSegmentedColormap.from_list(
    "tension", ["#3f6fd8", "#36c5d6", "#ffd24a", "#ff5d3a"]
)
SATELLITE_COLOURS = ("#5cb8ff", "#ff9e42", "#73e08c")

# %%
# The motion
# ----------
#
# :class:`~tss_ros.core.Propagator` gives the motion in the orbit frame at any times. Turned back by
# the spin, an undisturbed ring would stand still.


def simulate(system, spin_rate_ratio, disturbance_m, turns, seed=1):
    """Motion after a push.

    Parameters
    ----------
    system : tss_ros.core.System
    spin_rate_ratio : float
    disturbance_m : float
        Norm of the push [m].
    turns : ndarray, shape (k,)
        When to look [-].
    seed : int

    Returns
    -------
    position_m : ndarray, shape (k, n, 3)
        In the orbit frame.
    turned_m : ndarray, shape (k, n, 3)
        In the frame that turns with the spin.
    length_m, tension_n : ndarray, shape (k, m)
    taut : ndarray, shape (k, m), bool
    """
    start = disturbed(initial_state(system, spin_rate_ratio), disturbance_m, seed)
    propagator = Propagator(system, spin_rate_ratio, start)
    position_m, velocity_m_s = propagator.sample(turns * propagator.period_s)
    angle = -2.0 * np.pi * turns[:, None] * np.sign(spin_rate_ratio)
    x, y, z = np.moveaxis(position_m, -1, 0)
    turned = (np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z)
    return position_m, np.stack(turned, -1), *tether_state(system, position_m, velocity_m_s)


# %%
# The animation
# -------------
#
# A tether's colour is its tension over the mean tension of the undisturbed ring; slack tethers are
# dotted. Below, the lengths: a tether shorter than its rest length is slack.


def animate(system, spin_rate_ratio, disturbance_m=10.0, turns=4.0, frames=90, trail=18):
    """Animation of a disturbed motion.

    Parameters
    ----------
    system : tss_ros.core.System
    spin_rate_ratio : float
    disturbance_m : float
        Norm of the push [m].
    turns : float
    frames : int
    trail : int
        Frames for which a satellite leaves a trail.

    Returns
    -------
    matplotlib.animation.FuncAnimation
        Keep it as long as the figure is shown.
    """
    fine = 8
    when = np.linspace(0.0, turns, (frames - 1) * fine + 1)
    position_m, turned_m, length_m, tension_n, taut = simulate(
        system, spin_rate_ratio, disturbance_m, when
    )
    still = initial_state(system, spin_rate_ratio)
    mean_n = tether_state(system, still.position_m, still.velocity_m_s)[1].mean()
    reach_km = 1.22 * np.linalg.norm(still.position_m, axis=1).max() / 1e3
    ends = system.tether_ends

    figure = plt.figure(figsize=(7.6, 5.6), dpi=76, layout="constrained", facecolor=NIGHT)
    grid = figure.add_gridspec(2, 3, height_ratios=(3.0, 1.0), width_ratios=(1.0, 1.0, 0.05))
    views = []
    for column, (places_m, title, names) in enumerate(
        (
            (turned_m, "turning with the spin", ("x'", "y'")),
            (position_m, "orbit frame", ("x, against the flight", "y, radially up")),
        )
    ):
        axes = figure.add_subplot(grid[0, column])
        axes.set(xlim=(-reach_km, reach_km), ylim=(-reach_km, reach_km), aspect="equal")
        axes.set(title=title, xlabel=f"{names[0]} [km]", ylabel=f"{names[1]} [km]")
        axes.set(xticks=(-5, 0, 5), yticks=(-5, 0, 5))
        round_km = np.linalg.norm(still.position_m[0]) / 1e3
        axes.add_patch(plt.Circle((0.0, 0.0), round_km, fill=False, color=FAINT, linewidth=1.0))
        tethers = LineCollection([], linewidths=2.2, zorder=3)
        axes.add_collection(tethers)
        colours = [SATELLITE_COLOURS[i % 3] for i in range(system.n)]
        trails = [axes.plot([], [], color=c, linewidth=1.2, alpha=0.7)[0] for c in colours]
        dots = axes.scatter(np.zeros(system.n), np.zeros(system.n), s=48, c=colours, zorder=4)
        views.append((places_m[..., :2] / 1e3, tethers, trails, dots))

    lengths = figure.add_subplot(grid[1, :2])
    percent = 100.0 * length_m / system.rest_length_m
    lengths.plot(when, np.where(taut, 100.0, percent), color=INK, linewidth=0.9, alpha=0.85)
    lengths.axhline(100.0, color=FAINT, linewidth=1.0)
    lengths.set(xlim=(0.0, turns), xlabel="turns [-]", ylabel="tether lengths\n[% of rest]")
    cursor = lengths.axvline(0.0, color=TENSION_COLOURS(0.7), linewidth=1.4)
    scale = plt.cm.ScalarMappable(Normalize(0.0, 3.0), TENSION_COLOURS)
    bar = figure.colorbar(scale, cax=figure.add_subplot(grid[0, 2]), extend="max")
    bar.set_label("tension over that of the undisturbed ring [-]\n(slack: dotted)")
    heading = figure.suptitle("", color=INK, fontsize=12)
    for axes in figure.axes:
        axes.set_facecolor(NIGHT)
        axes.tick_params(colors=SLACK, labelsize=8)
        axes.spines[:].set_color(FAINT)
        for text in (axes.title, axes.xaxis.label, axes.yaxis.label):
            text.set(color=INK, fontsize=9)

    def update(frame):
        k = frame * fine
        shade = TENSION_COLOURS(np.clip(tension_n[k] / mean_n / 3.0, 0.0, 1.0))
        for path_km, tethers, trails, dots in views:
            tethers.set_segments(path_km[k][ends])
            tethers.set_color([c if t else SLACK for c, t in zip(shade, taut[k])])
            tethers.set_linestyle(["-" if t else ":" for t in taut[k]])
            dots.set_offsets(path_km[k])
            since = max(0, k - trail * fine)
            for i, line in enumerate(trails):
                line.set_data(path_km[since : k + 1, i].T)
        cursor.set_xdata([when[k], when[k]])
        heading.set_text(
            f"ring at ω = {spin_rate_ratio:g} Ω after a push of {disturbance_m:g} m:"
            f" turn {when[k]:.1f}"
        )

    update(0)
    figure.canvas.draw()
    figure.set_layout_engine("none")  # the layout stays, and frames are drawn faster
    return FuncAnimation(figure, update, frames=frames, interval=70)


def save_gif(animation, path, colours=64):
    """Save an animation as a small GIF: one palette for all frames, no dithering.

    Parameters
    ----------
    animation : matplotlib.animation.FuncAnimation
    path : str or Path
        Ending in .gif.
    colours : int
    """
    animation.save(path, writer=PillowWriter(fps=14), savefig_kwargs={"facecolor": NIGHT})
    with Image.open(path) as raw:
        frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(raw)]
    samples = frames[:: max(1, len(frames) // 6)]
    sheet = Image.new("RGB", (samples[0].width, samples[0].height * len(samples)))
    for i, frame in enumerate(samples):
        sheet.paste(frame, (0, i * frame.height))
    palette = sheet.quantize(colours, method=Image.Quantize.MAXCOVERAGE)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    small[0].save(path, save_all=True, append_images=small[1:], duration=70, loop=0, optimize=True)


# %%
# The picture
# -----------

motion = animate(ring(), -2.0)
if len(sys.argv) > 1:
    save_gif(motion, sys.argv[1])
plt.gcf().canvas.draw()
plt.show()
