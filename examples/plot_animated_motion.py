"""
A motion, animated
==================

At twice the orbital rate a push of 10 m is enough: tethers go slack, jerk taut again, and within
three turns the ring is lost. The same motion is shown twice, in the frame that turns with the spin
and in the orbit frame. ``python examples/plot_animated_motion.py ring.gif`` saves it.
"""

import sys

import matplotlib.pyplot as plt

from tss_ros.core import ring, simulate
from tss_ros.plots import animate

# %%
# The motion
# ----------
#
# :func:`~tss_ros.core.simulate` gives a :class:`~tss_ros.core.Trajectory`: positions, velocities,
# lengths and tensions as arrays. A shell or a notebook shows in a table what became of it.

system = ring()
motion = simulate(system, -2.0, turns=4.0, disturbance_m=10.0, seed=1, period_s=4.0)
print(motion)
motion

# %%
# When tethers are slack
# ----------------------
#
# A tether shorter than its rest length is slack. Each time it comes taut again, it jerks.

figure, axes = plt.subplots(figsize=(9.0, 3.6), layout="constrained")
lines = axes.plot(motion.turns, 100.0 * motion.length_m / system.rest_length_m, linewidth=1.2)
axes.legend(lines, system.tether_name, frameon=False)
axes.set(xlabel="turns [-]", ylabel="tether length [% of rest]", xlim=(0.0, 4.0))
axes.set_title(f"{motion.switches} times a tether goes slack or comes taut")
plt.show()

# %%
# The animation
# -------------
#
# A tether's colour is its tension over the median one; slack tethers are dotted. Below are the
# lengths again.

animation = animate(motion)
if len(sys.argv) > 1:
    animation.save(sys.argv[1])
animation
