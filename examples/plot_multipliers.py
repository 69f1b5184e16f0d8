"""
Multipliers, and where stability ends
=====================================

A spinning formation repeats its motion every turn. A small change of the motion is multiplied in
each turn by the Floquet multipliers. One outside the unit circle means that the change grows. Here
are all multipliers of the paper's ring at one rate, and the largest ones over a range of rates.
"""

import cmath
import math
import sys

import matplotlib.pyplot as plt
import numpy as np

from tss_ros.core import FAMILIES, FloquetJob, compute_floquet, find_critical_rates, ring, sweep

INK = "#333333"
STYLES = {
    "centre of mass": {"marker": "o", "color": "#0072B2", "markersize": 11},
    "spin": {"marker": "s", "color": "#009E73", "markersize": 7},
    "axis tilt": {"marker": "D", "color": "#D55E00", "markersize": 7},
    "shape": {"marker": "^", "color": "#CC79A7", "markersize": 9},
}
plt.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "axes.grid": True})
plt.rcParams.update({"grid.color": "0.9", "axes.axisbelow": True, "figure.dpi": 110})

# %%
# One rate
# --------
#
# :func:`~tss_ros.core.compute_floquet` first corrects the start to a motion that closes, then
# integrates its variations over a turn. Every multiplier comes with the family of motion that it
# belongs to. Centre of mass, spin and axis tilt lie on the circle and never decay. Only the shape
# is damped, here to almost nothing in a single turn.

SPIN_RATE_RATIO = -2.5
system = ring()
result = compute_floquet(system, SPIN_RATE_RATIO)
print(f"{result.verdict}; the turn closes to {result.closure_residual:.1e}")
families = [name for name in FAMILIES if name in result.family]
for name in families:
    moduli = [abs(m) for m, f in zip(result.multiplier, result.family) if f == name]
    print(f"{name:15s}{len(moduli)} multipliers, |rho| {min(moduli):.6f} to {max(moduli):.6f}")

# %%
# Many rates
# ----------
#
# :func:`~tss_ros.core.sweep` runs jobs on all cores. Where no motion closes, Floquet theory has
# nothing to say, and the curve has a gap. :func:`~tss_ros.core.find_critical_rates` brackets the
# ends of the ranges in which the ring is stable and taut.
#
# Two rings are compared. In the paper's, with 1450 N s/m, tethers go slack first. With 2600 N s/m
# they stay taut longer, and the tilt of the spin axis ends stability.

RATES = np.linspace(-2.4, -1.7, 71)
DAMPING_N_S_PER_M = (1450.0, 2600.0)
largest, boundaries = {}, {}
for damping in DAMPING_N_S_PER_M:
    damped = ring(damping_n_s_per_m=damping)
    largest[damping] = {name: np.full(len(RATES), np.nan) for name in families}
    for i, outcome in sweep([FloquetJob(damped, rate) for rate in RATES]):
        if outcome.verdict == "none found":
            continue
        for name in families:
            moduli = [abs(m) for m, f in zip(outcome.multiplier, outcome.family) if f == name]
            largest[damping][name][i] = max(moduli)
    boundaries[damping] = find_critical_rates(damped, RATES[0], RATES[-1])
    for found in boundaries[damping]:
        print(
            f"{damping:g} N s/m: {found.cause} at {found.spin_rate_ratio:.4f}"
            f" +- {found.uncertainty:.4f}"
        )

# %%
# A check
# -------
#
# The tilt of a rigid ring has a closed form: it is unstable for -2 < w < -1/2, where it grows by
# exp(2 pi lambda / abs(w)) per turn. The tilt of the ring with tethers should come close to it.


def tilt_growth(w):
    """Growth of the axis tilt of a rigid flat ring per turn [-]."""
    s = 1.0 + w
    b, c = (2.0 * s - 1.0) ** 2 + 4.0, (2.0 * s - 1.0) * (2.0 * s + 2.0)
    roots = [cmath.sqrt((-b + sign * cmath.sqrt(b * b - 4.0 * c)) / 2.0) for sign in (1, -1)]
    return math.exp(2.0 * math.pi * max(abs(root.real) for root in roots) / abs(w))


computed = compute_floquet(ring(damping_n_s_per_m=2600.0), -1.95)
tilt = max(abs(m) for m, f in zip(computed.multiplier, computed.family) if f == "axis tilt")
print(f"axis tilt at -1.95: {tilt:.5f}, closed form {tilt_growth(-1.95):.5f}")

# %%
# The picture
# -----------

figure = plt.figure(figsize=(11.0, 5.8), layout="constrained")
grid = figure.add_gridspec(2, 2, width_ratios=(1.05, 1.0))
plane = figure.add_subplot(grid[:, 0])
circle = np.exp(1j * np.linspace(0.0, 2.0 * math.pi, 361))
plane.plot(circle.real, circle.imag, color=INK, linewidth=0.9, label="unit circle")
for name, style in STYLES.items():
    chosen = np.array([f == name for f in result.family])
    values = result.multiplier[chosen]
    plane.plot(
        values.real, values.imag, linestyle="", label=f"{name} ({chosen.sum()})",
        markerfacecolor="none", markeredgewidth=1.8, **style,
    )
plane.set_title(f"All {len(result.multiplier)} multipliers at ω = {SPIN_RATE_RATIO:g} Ω")
plane.set(xlabel="real part of ρ [-]", ylabel="imaginary part of ρ [-]", aspect="equal")

top = figure.add_subplot(grid[0, 1])
bottom = figure.add_subplot(grid[1, 1], sharex=top)
titles = ("1450 N s/m: tethers go slack first", "2600 N s/m: the axis tilts first")
for axes, damping, title in zip((top, bottom), DAMPING_N_S_PER_M, titles):
    last = np.flatnonzero(np.isfinite(largest[damping]["spin"])).max()
    axes.axhline(1.0, color=INK, linewidth=0.9)
    if damping == 2600.0:
        fine = np.linspace(-2.0, RATES[last], 200)
        axes.plot(
            fine, [tilt_growth(w) for w in fine], color="0.65", linewidth=4.0,
            label="axis tilt, closed form", zorder=1,
        )
    for name in ("spin", "axis tilt"):
        axes.plot(RATES, largest[damping][name], **{**STYLES[name], "markersize": 4})
    axes.axvspan(RATES[last] + 0.005, RATES[-1], color="0.93", zorder=0, linewidth=0)
    middle = (RATES[last] + RATES[-1]) / 2.0
    axes.text(middle, 1.5, "no closed\nmotion found", ha="center", color="0.35")
    first = boundaries[damping][0]
    axes.axvline(first.spin_rate_ratio, color=INK, linestyle="--", linewidth=1.0)
    axes.annotate(
        f"{first.cause}\nat {first.spin_rate_ratio:.3f} Ω", (first.spin_rate_ratio, 1.95),
        xytext=(-6, 0), textcoords="offset points", ha="right", va="top",
    )
    if damping == 2600.0:
        axes.legend(frameon=False, loc="center left")
    axes.set(title=title, ylabel="largest |ρ| [-]")
    axes.set(xlim=(RATES[0], RATES[-1]), ylim=(0.9, 2.25))
bottom.set_xlabel("spin rate over orbital rate, ω/Ω [-]")
figure.legend(
    *plane.get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False
)

if len(sys.argv) > 1:
    figure.savefig(sys.argv[1])
plt.show()
