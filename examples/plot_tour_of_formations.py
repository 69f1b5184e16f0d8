"""
A tour of the formations of the literature
==========================================

The paper places its ring among other formations: chains that hang, hubs with spokes, pyramids that
face the Earth. Each is asked about in one line. Some hold their shape, and one cannot be flown at
all: the answer says why. On a shell the same questions are ``tss sweep vertical_chain_4`` and the
like.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

from tss_ros.core import compute_floquet, formation, lyapunov_exponents, simulate
from tss_ros.scenarios import scenario

INK, FAINT = "#333333", "#999999"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#333333")


def ask(name):
    """A shipped scenario, its system and the verdict at its own rate."""
    loaded = scenario.load(name)
    system = loaded.build()
    return loaded, system, compute_floquet(system, loaded.spin_rate_ratio, certify=False)


# %%
# Four questions
# --------------
#
# A hanging chain of four, a hub with six spokes that is to face the Earth, a closed hub in the
# orbit plane, and a double pyramid that faces the Earth.

NAMES = (
    "vertical_chain_4", "hub_and_spoke_earth_facing", "closed_hub_and_spoke",
    "double_pyramid_earth_facing",
)  # fmt: skip
answers = {name: ask(name) for name in NAMES}
for name, (loaded, _, result) in answers.items():
    print(f"{name}, ω = {loaded.spin_rate_ratio:g} Ω: {result.verdict}\n    {result.reason}\n")

# %%
# What they look like
# -------------------
#
# Paths over two turns, or two orbits for the chain, about the centre of mass. Where no motion
# repeats, what is drawn is the start that comes nearest to one. The chain's swings, after a push of
# 50 m, are drawn a hundred times wider than they are.

figure = plt.figure(figsize=(11.0, 9.0), layout="constrained")
for place, (name, (loaded, system, result)) in enumerate(answers.items(), 1):
    push_m = 50.0 if not loaded.spin_rate_ratio else 1.0
    turns = 2.0 if result.family else 0.9
    motion = simulate(system, loaded.spin_rate_ratio, turns=turns, disturbance_m=push_m, seed=1)
    axes = figure.add_subplot(2, 2, place, projection="3d", computed_zorder=False)
    x, y, z = np.moveaxis(motion.position_m - motion.centre_of_mass_m[:, None], 2, 0) / 1e3
    for i in np.flatnonzero(system.is_satellite):
        colour = COLOURS[i % len(COLOURS)]
        axes.plot(z[:, i], x[:, i], y[:, i], color=colour, linewidth=1.0)
        axes.plot(*([p[-1, i]] for p in (z, x, y)), "o", color=colour, markersize=5)
    for i, j in system.tether_ends:
        axes.plot(*(p[-1, [i, j]] for p in (z, x, y)), color=INK, linewidth=0.9)
    axes.set(xlabel="z, normal [km]", ylabel="x, back [km]", zlabel="y, up [km]")
    axes.set_title(
        f"{name.replace('_', ' ')}\nω = {loaded.spin_rate_ratio:g} Ω: {result.verdict}",
        color=INK, fontsize=10,
    )  # fmt: skip
    reach = 1.1 * np.abs(y).max()
    wide = reach if loaded.spin_rate_ratio else 0.1
    axes.set(xlim=(-wide, wide), ylim=(-wide, wide), zlim=(-reach, reach))
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(plt.MaxNLocator(3))
if sys.argv[1:]:
    figure.savefig(sys.argv[1])
plt.show()

# %%
# How the chain swings
# --------------------
#
# A formation that hangs has exponents instead of multipliers: its librations and their frequencies.
# In the plane a chain of equal satellites has sqrt(3 k (k + 1) / 2), out of it the squares are
# larger by 1 (Misra and Modi).

_, chain, hanging = answers["vertical_chain_4"]
frequency = np.abs(hanging.exponent.imag) / chain.orbit_rate_rad_s
swings = np.unique(np.round(frequency[(frequency > 1.5) & (frequency < 10.0)], 3))
expected = np.sqrt([1.5 * k * (k + 1) + out for k in (1, 2, 3) for out in (0.0, 1.0)])

figure, axes = plt.subplots(figsize=(8.0, 3.2), layout="constrained")
axes.vlines(expected, 0.0, 1.0, color=FAINT, linewidth=5.0, label="closed form")
axes.plot(swings, np.full(swings.size, 0.5), "o", color=COLOURS[1], label="exponents found")
axes.set(xlabel="frequency over the orbit's [-]", ylabel="", yticks=[], xlim=(1.0, 5.0))
axes.set_ylabel("librations and bending")
axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(0.3, 0.95))
axes.set_title("A hanging chain of four", color=INK)
plt.show()

# %%
# On an ellipse
# -------------
#
# On an ellipse nothing rests in the orbit frame. A pair swings once an orbit, and Floquet theory
# answers over that orbit. A spin of 3.05 turns an orbit does not repeat there: the question becomes
# one of growth.

pair = formation("chain", 2, damping_n_s_per_m=0.0, tether_length_m=1000.0, eccentricity=0.1)
libration = compute_floquet(pair, 0.0, certify=False)
print(libration, "\n")
ring = formation("ring", 3, eccentricity=0.02)
print(compute_floquet(ring, -3.05, certify=False).message, "\n")
growth = lyapunov_exponents(ring, -3.05, turns=20, count=1)
print(growth)

motion = simulate(pair, 0.0, turns=3.0, state=libration.state)
arm = motion.position_m[:, 0] - motion.position_m[:, 1]
angle_deg = np.degrees(np.arctan2(-arm[:, 0], arm[:, 1]))
figure, axes = plt.subplots(figsize=(8.0, 3.2), layout="constrained")
axes.plot(motion.turns, angle_deg, color=COLOURS[0])
axes.axhline(0.0, color=FAINT, linewidth=0.8)
axes.set(xlabel="orbits [-]", ylabel="angle from the vertical [degrees]")
axes.set_title(f"A pair on an ellipse of e = 0.1: {libration.verdict} over an orbit", color=INK)
plt.show()
