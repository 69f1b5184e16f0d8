"""Draws docs/ring.gif: a ring that holds its shape after a push, beside one that does not.

Run as ``python docs/make_animation.py`` in an activated shell. Both rings are the paper's, seen
from the orbit's north in the orbit frame, about their centre of mass; slack tethers are red. A
slack tether has no shape in the model: its bow is drawn for the eye.
"""

from pathlib import Path

import matplotlib

matplotlib.use("agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from PIL import Image  # noqa: E402

from tss_ros.core import Propagator, disturbed, initial_state, ring, tether_state  # noqa: E402

OUTPUT = Path(__file__).parent / "ring.gif"
RATES = {-2.5: "keeps its shape", -2.0: "loses it"}
PUSH_M, TURNS, FRAMES = 300.0, 3.0, 84
#: Samples between frames, so that trails are smooth, and length of a trail in samples.
FINE, TRAIL = 3, 40
NIGHT, INK, GREY = "#0d1424", "#e6ebf5", "#7a869c"
COLOURS = np.array([[0.36, 0.72, 1.0], [1.0, 0.62, 0.26], [0.45, 0.88, 0.55]])


def simulate(spin_rate_ratio):
    """Turns (k,), positions from the centre of mass (k, 3, 2) [km] and tautness (k, 3)."""
    system = ring()
    start = disturbed(initial_state(system, spin_rate_ratio), PUSH_M, seed=3)
    motion = Propagator(system, spin_rate_ratio, start)
    turns = np.linspace(0.0, TURNS, FINE * (FRAMES - 1) + 1)
    position, velocity = motion.sample(turns * motion.period_s)
    _, _, taut = tether_state(system, position, velocity)
    position = position - position.mean(axis=1, keepdims=True)
    return turns, position[:, :, :2] / 1e3, taut


def draw(axes, positions, taut, k, title, turns):
    """Draw one frame of one motion, with the trails of the satellites."""
    axes.clear()
    axes.set(xlim=(-7.4, 7.4), ylim=(-7.6, 7.2), aspect="equal")
    axes.axis("off")
    axes.set_title(title, color=INK, fontsize=11, pad=4)
    axes.add_patch(plt.Circle((0, 0), 5.774, fill=False, color="#24304a", lw=0.8, ls=(0, (3, 3))))
    trail = positions[max(0, k - TRAIL) : k + 1]
    for i, colour in enumerate(COLOURS):
        for j in range(len(trail) - 1):
            shade = (j + 1) / len(trail)
            ground = np.array(matplotlib.colors.to_rgb(NIGHT))
            axes.plot(*trail[j : j + 2, i].T, color=ground + shade * 0.8 * (colour - ground), lw=2)
    for i in range(3):
        ends = positions[k][[i, (i + 1) % 3]]
        style = {"color": INK, "lw": 1.4} if taut[k, i] else {"color": "#ff6b6b", "lw": 1.1}
        axes.plot(*(ends if taut[k, i] else slack(*ends)).T, **style)
    axes.scatter(*positions[k].T, s=70, c=COLOURS, edgecolors=INK, linewidths=0.8, zorder=3)
    axes.text(0, -7.5, f"turn {turns:.1f}", color=GREY, ha="center", fontsize=9)


def slack(a, b, length_km=10.0):
    """A bow of about the tether's length between two points, bent outward."""
    s = np.linspace(0.0, 1.0, 25)
    along = b - a
    chord = np.linalg.norm(along)
    across = np.array([along[1], -along[0]]) / max(chord, 1e-9)
    across *= np.sign(np.dot(across, (a + b) / 2)) or 1.0
    sag = np.sqrt(max(length_km**2 - chord**2, 0.0)) * 0.6
    return a + s[:, None] * along + (4 * s * (1 - s) * min(sag, 2.2))[:, None] * across


def main():
    """Simulate both motions, draw all frames and write the animation."""
    motions = {ratio: simulate(ratio) for ratio in RATES}
    figure, pair = plt.subplots(1, 2, figsize=(6.4, 3.4), dpi=100, facecolor=NIGHT)
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=0.91, wspace=0.02)
    frames = []
    for frame in range(FRAMES):
        k = FINE * frame
        for axes, (ratio, text) in zip(pair, RATES.items()):
            turns, positions, taut = motions[ratio]
            title = f"spin {ratio:g} Ω: {text}"
            draw(axes, positions, taut, k, title, turns[k])
        figure.canvas.draw()
        frames.append(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3]))
    strip = Image.new("RGB", (frames[0].width, 4 * frames[0].height))
    for j, frame in enumerate(frames[:: FRAMES // 4][:4]):
        strip.paste(frame, (0, j * frame.height))
    palette = strip.quantize(40, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    frames = [f.quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    durations = [60] * (FRAMES - 1) + [1500]
    frames[0].save(
        OUTPUT, save_all=True, append_images=frames[1:], duration=durations, loop=0, optimize=True
    )
    print(f"{OUTPUT.name}: {OUTPUT.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
