"""
A ring is deployed and brought back
===================================

Three satellites pay out their tethers from 100 m to 10 km while they spin, and take them in again.
Rest lengths follow the classical law L' = a L. The Coriolis force slows the spin meanwhile, and
thrusters hold it. ``python examples/plot_deployment.py deployment.png`` saves the picture.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from tss_ros.core import deployed_system, initial_state, reel_plan, simulate, whole_state
from tss_ros.scenarios import scenario

# %%
# The shipped scenario
# --------------------
#
# Its profile is one for all tethers: points that cubics join. Until the first reel moves, the ring
# is in the steady state of what is out.

loaded = scenario.load("deploy_3_star")
system, ratio = loaded.build(), loaded.spin_rate_ratio
profile = loaded.reels.profiles["all"]
length_m = CubicHermiteSpline(profile.time_s, profile.length_m, profile.rate_m_s)
plan = reel_plan(system, dict.fromkeys(system.tether_name, length_m))
out, part = deployed_system(system, profile.length_m[0])
start = whole_state(part, initial_state(out, ratio))
turns = profile.time_s[-1] / system.period_s(ratio)
motion = simulate(system, ratio, turns=turns, period_s=20.0, state=start, plan=plan)

# %%
# What the thrusters have to hold
# -------------------------------
#
# Where L' = a L, a satellite of mass m that moves outwards at a R feels the Coriolis force
# 2 m (1 + w) Omega a R. Thrusters with the gain k balance it where the spin is off by
# 2 m (1 + w) a / k.

OMEGA, A = system.orbit_rate_rad_s, 0.15 * system.orbit_rate_rad_s
gain, mass_kg = system.law_parameters["rotation_damping_n_s_per_m"], system.mass_kg[0]
held = {
    a: (ratio - 2.0 * mass_kg * a / gain) / (1.0 + 2.0 * mass_kg * a / gain) for a in (A, -A)
}
r = motion.position_m - motion.centre_of_mass_m[:, None]
v = motion.velocity_m_s - motion.velocity_m_s.mean(axis=1, keepdims=True)
spin = np.cross(r, v)[..., 2].sum(axis=1) / (r**2).sum(axis=(1, 2)) / OMEGA
least_n, most_n = motion.tension_n.min(axis=1), motion.tension_n.max(axis=1)
print(f"spin {spin.min():.4f} to {spin.max():.4f}, expected {held[A]:.4f} and {held[-A]:.4f}")
print(f"tensions {least_n.min():.3g} to {most_n.max():.3g} N, taut in {motion.taut.mean():.1%}")

# %%
# Length, spin and tension
# ------------------------

orbits = motion.t_s * OMEGA / (2.0 * np.pi)
figure, axes = plt.subplots(3, 1, figsize=(8.0, 8.0), sharex=True, layout="constrained")
axes[0].semilogy(orbits, motion.rests_m[:, 0], color="tab:blue", label="rest length")
law = np.array([3000.0, profile.time_s[-1] / 2.0 - 4500.0])
for times in (law, profile.time_s[-1] - law):
    expected = length_m(times[0]) * np.exp((A if times[0] < times[1] else -A) * (times - times[0]))
    axes[0].semilogy(times * OMEGA / (2.0 * np.pi), expected, "k--", linewidth=1.0,
                     label="exp(a t)" if times is law else None)  # fmt: skip
axes[0].set(ylabel="length [m]", title="3-star deployed at a = 0.15 Ω and brought back")
axes[0].legend(frameon=False)
axes[1].plot(orbits, spin, color="tab:orange")
for value in held.values():
    axes[1].axhline(value, color="k", linestyle="--", linewidth=1.0)
axes[1].set(ylabel="spin rate [Ω]", title="dashed: thrusters balance the Coriolis force")
axes[2].fill_between(orbits, least_n, most_n, color="tab:green", alpha=0.5, linewidth=0.0)
axes[2].set(ylabel="tension [N]", xlabel="orbits [-]", yscale="log")
axes[2].set_title("least to largest of the three tethers")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
plt.show()
