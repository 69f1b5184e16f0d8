r"""
A formation of your own
=======================

Any graph of satellites and tethers will do. Here four satellites form a rhombus with a tether along
its short diagonal. A steady spin keeps all five tethers taut only if the satellites on the short
diagonal are the heavier ones. Which spin rates are stable, too, says the analysis.
"""

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from tss_ros.core import (
    FloquetJob,
    Propagator,
    Satellite,
    Tether,
    assemble,
    averaged_state,
    compute_floquet,
    find_critical_rates,
    sweep,
    tether_state,
)
from tss_ros.scenarios import scenario

BLUE, RED, INK = "#0072B2", "#D55E00", "#333333"
plt.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "axes.grid": True})
plt.rcParams.update({"grid.color": "0.9", "axes.axisbelow": True, "figure.dpi": 110})

# %%
# The formation in Python
# -----------------------
#
# A :class:`~tss_ros.core.Satellite` has a name, a mass and a place in the nominal shape; the spin
# axis is z. A :class:`~tss_ros.core.Tether` names the two satellites it joins by their numbers and
# has one length, stiffness and damping per segment. :func:`~tss_ros.core.assemble` checks it all.

LENGTH_M, HEIGHT_M = 1.0e4, 1.0e4 * 3.0**0.5 / 2.0
STIFFNESS_N, DAMPING_N_S_PER_M = 5.0e4, 1450.0
NAMES = ("west", "north", "east", "south")
PLACES_M = ((-LENGTH_M / 2, 0, 0), (0, HEIGHT_M, 0), (LENGTH_M / 2, 0, 0), (0, -HEIGHT_M, 0))
ENDS = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 2))


def rhombus(mass_on_diagonal_kg, mass_at_tips_kg):
    """Four satellites and five tethers of equal length."""
    masses = (mass_on_diagonal_kg, mass_at_tips_kg) * 2
    satellites = [Satellite(*values) for values in zip(NAMES, masses, PLACES_M)]
    tethers = [
        Tether(f"{NAMES[i]}-{NAMES[j]}", (i, j), (LENGTH_M,), (STIFFNESS_N,), (DAMPING_N_S_PER_M,))
        for i, j in ENDS
    ]
    return assemble(satellites, tethers)


HEAVY_KG, LIGHT_KG = 300.0, 100.0
system = rhombus(HEAVY_KG, LIGHT_KG)

# %%
# The same in YAML
# ----------------
#
# The nodes read formations from a scenario file, for instance
# ``ros2 run tss_ros sim_node --ros-args -p scenario:=rhombus.yaml``.

text = f"""
description: a rhombus with its short diagonal
spin_rate_ratio: -3.0
orbit_altitude_m: 1000000.0
bodies:
  - {{name: west, mass_kg: 300.0, position_m: [-5000.0, 0.0, 0.0]}}
  - {{name: north, mass_kg: 100.0, position_m: [0.0, {HEIGHT_M}, 0.0]}}
  - {{name: east, mass_kg: 300.0, position_m: [5000.0, 0.0, 0.0]}}
  - {{name: south, mass_kg: 100.0, position_m: [0.0, -{HEIGHT_M}, 0.0]}}
tethers:
"""
for i, j in ENDS:
    text += f"""\
  - {{name: {NAMES[i]}-{NAMES[j]}, between: [{NAMES[i]}, {NAMES[j]}],
     length_m: 10000.0, axial_stiffness_n: 50000.0, damping_n_s_per_m: 1450.0}}
"""
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "rhombus.yaml"
    path.write_text(text)
    from_yaml = scenario.load(path).build()
same = (
    from_yaml.tether_name == system.tether_name
    and np.array_equal(from_yaml.layout_m, system.layout_m)
    and np.array_equal(from_yaml.mass_kg, system.mass_kg)
)
print(f"Python and YAML give the same formation: {same}")

# %%
# Its steady state
# ----------------
#
# :func:`~tss_ros.core.averaged_state` is the rotating equilibrium under the gravity gradient
# averaged over a turn. With k = Omega^2 (w^2 + 2 w + 3/2) the balance of a rigid rhombus gives
#
# .. math:: T_\text{rim} = \tfrac12 m_\text{tip} k L, \qquad
#     T_\text{diagonal} = \tfrac12 (m_\text{diagonal} - m_\text{tip}) k L.

SPIN_RATE_RATIO = -3.0
steady = averaged_state(system, SPIN_RATE_RATIO)
_, tension_n, _ = tether_state(system, steady.position_m, steady.velocity_m_s)
w = SPIN_RATE_RATIO
outward = system.orbit_rate_rad_s**2 * (w * w + 2.0 * w + 1.5)
rim_n = 0.5 * LIGHT_KG * outward * LENGTH_M
diagonal_n = 0.5 * (HEAVY_KG - LIGHT_KG) * outward * LENGTH_M
print(f"rim {tension_n[0]:.4f} N, rigid {rim_n:.4f} N")
print(f"diagonal {tension_n[4]:.4f} N, rigid {diagonal_n:.4f} N")

# %%
# Its verdict
# -----------
#
# "neutral" means stable, with a shape whose oscillation does not decay. Two triangles that share a
# tether can fold along it, and to first order no tether is stretched by that. With the masses
# exchanged the diagonal hangs slack and the light satellites meet: no motion of a rhombus is left,
# and the message says so.

result = compute_floquet(system, SPIN_RATE_RATIO)
exchanged = compute_floquet(rhombus(LIGHT_KG, HEAVY_KG), SPIN_RATE_RATIO)
for name, outcome in (("heavy on the diagonal", result), ("heavy at the tips", exchanged)):
    print(f"{name}: {outcome.verdict}; {outcome.message}")

critical = find_critical_rates(system, -3.0, -1.8)
for found in critical:
    print(f"{found.cause} at {found.spin_rate_ratio:.3f} +- {found.uncertainty:.3f}")

# %%
# In a faster spin no tether ever goes slack. Towards the critical rate their least stretch in a
# turn shrinks to nothing, that of the rim and that of the diagonal alike.

rates = np.linspace(-3.0, -1.8, 49)
least_stretch_m = np.full((len(rates), 2), np.nan)
for i, outcome in sweep([FloquetJob(system, rate) for rate in rates]):
    if outcome.verdict != "none found" and not outcome.switches:
        propagator = Propagator(system, rates[i], outcome.state)
        position_m, velocity_m_s = propagator.sample(np.linspace(0.0, propagator.period_s, 400))
        length_m, *_ = tether_state(system, position_m, velocity_m_s)
        stretch_m = length_m.min(axis=0) - system.rest_length_m
        least_stretch_m[i] = stretch_m[:4].min(), stretch_m[4]

# %%
# The picture
# -----------

figure, (plan, chart) = plt.subplots(1, 2, figsize=(11.0, 5.6), layout="constrained")
x_km, y_km, _ = steady.position_m.T / 1e3
for segment, (i, j) in enumerate(system.tether_ends):
    on_rim = segment < 4
    plan.plot(x_km[[i, j]], y_km[[i, j]], color=BLUE if on_rim else RED, linewidth=2.2, zorder=2)
    plan.text(
        x_km[[i, j]].mean() * 1.35, y_km[[i, j]].mean() * 1.2 + (0.0 if on_rim else 0.35),
        f"{tension_n[segment]:.2f} N", ha="center", color=BLUE if on_rim else RED,
    )
plan.scatter(x_km, y_km, s=1.1 * system.mass_kg, color=INK, zorder=3)
for i, name in enumerate(NAMES):
    side = np.sign(x_km[i]) if abs(x_km[i]) > 1.0 else 0.0
    plan.annotate(
        f"{name}\n{system.mass_kg[i]:g} kg", (x_km[i], y_km[i]), textcoords="offset points",
        xytext=(38 * side if side else 38, 0), ha="center", va="center",
    )
plan.set_title(f"Steady at ω = {SPIN_RATE_RATIO:g} Ω: {result.verdict}")
plan.set(xlabel="x [km]", ylabel="y [km]", xlim=(-9.0, 9.0), ylim=(-10.0, 10.0), aspect="equal")

chart.plot(rates, least_stretch_m[:, 1], color=RED, label="diagonal")
chart.plot(rates, least_stretch_m[:, 0], color=BLUE, label="rim")
chart.axhline(0.0, color=INK, linewidth=0.8)
first = critical[0]
chart.axvspan(first.spin_rate_ratio, rates[-1], color="0.93", zorder=0, linewidth=0)
chart.text((first.spin_rate_ratio + rates[-1]) / 2, 0.2, "tethers\ngo slack", ha="center")
chart.axvline(first.spin_rate_ratio, color=INK, linestyle="--", linewidth=1.0)
chart.annotate(
    f"{first.cause}\nat {first.spin_rate_ratio:.2f} Ω", (first.spin_rate_ratio, 0.42),
    xytext=(-6, 0), textcoords="offset points", ha="right",
)
chart.set_title("The least stretch of the tethers ends at the critical rate")
chart.set(xlabel="spin rate over orbital rate, ω/Ω [-]", ylabel="least stretch in a turn [m]")
chart.set(xlim=(rates[0], rates[-1]), ylim=(-0.03, 0.65))
chart.legend(frameon=False, loc="upper right")

if len(sys.argv) > 1:
    figure.savefig(sys.argv[1])
plt.show()
