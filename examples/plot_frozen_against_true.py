"""
Why the frozen method shows no critical rate
============================================

The paper takes the Jacobian of the motion at one instant and treats it as if it stayed the same for
the whole turn, Eqs. (34) to (47). Floquet theory integrates the variations along the motion, Eqs.
(12) to (27). One case has a closed form, and a simulation stands beside it: the frozen method
misses the growth.
"""

import cmath
import math
import sys

import matplotlib.pyplot as plt
import numpy as np

from tss_ros.core import FloquetJob, Propagator, State, compute_floquet, ring, sweep

BLUE, RED, INK = "#0072B2", "#D55E00", "#333333"
plt.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "axes.grid": True})
plt.rcParams.update({"grid.color": "0.9", "axes.axisbelow": True, "figure.dpi": 110})

# %%
# A case that can be solved on paper
# ----------------------------------
#
# A flat, rigid, symmetric ring has twice the inertia about its axis as across it. Its axis tilts
# away from the orbit normal for -2 < w < -1/2. Per turn the tilt grows by exp(2 pi lambda / abs(w))
# where lambda is the largest real part of the roots of
#
# .. math:: \lambda^4 + [(2s-1)^2 + 4] \lambda^2 + (2s-1)(2s+2) = 0, \qquad s = 1 + w.
#
# A ring comes close to a rigid one if its tethers may also push (``bilateral``) and do not damp.


def tilt_growth(w):
    """Growth of the axis tilt of a rigid flat ring per turn [-]."""
    s = 1.0 + w
    b, c = (2.0 * s - 1.0) ** 2 + 4.0, (2.0 * s - 1.0) * (2.0 * s + 2.0)
    roots = [cmath.sqrt((-b + sign * cmath.sqrt(b * b - 4.0 * c)) / 2.0) for sign in (1, -1)]
    return math.exp(2.0 * math.pi * max(abs(root.real) for root in roots) / abs(w))


system = ring(damping_n_s_per_m=0.0, linear_gravity=True, bilateral=True)

# %%
# Both methods over the band
# --------------------------
#
# The frozen Jacobian belongs to a formation that stands still at its first angle. The tethers turn,
# and with them the directions in which they pull: a quarter of a turn later the Jacobian is another
# matrix. Its exponential is not the matrix that carries a displacement through a turn.

RATES = np.linspace(-2.5, -0.3, 45)
METHODS = ("monodromy", "frozen")
jobs = [FloquetJob(system, rate, method) for method in METHODS for rate in RATES]
modulus = np.full(len(jobs), np.nan)
for i, outcome in sweep(jobs):
    if outcome.verdict != "none found":
        modulus[i] = outcome.max_modulus
true, frozen = modulus.reshape(2, -1)
closed_form = np.array([tilt_growth(w) for w in RATES])

difference = np.abs(true / closed_form - 1.0)
worst = np.nanargmax(difference)
print(
    f"monodromy and closed form: {100 * difference[worst]:.1f} % apart at {RATES[worst]:.2f}, an"
    f" end of the band; median {100 * np.nanmedian(difference):.4f} %"
)
print(f"frozen: |rho| at most {np.nanmax(frozen):.5f} at all {np.isfinite(frozen).sum()} rates")

# %%
# What a simulation does
# ----------------------
#
# Every satellite is moved out of the orbit plane by a millimetre or less, at w = -1.5. If the
# multipliers are right, the displacement grows with the largest of them, turn by turn.

SPIN_RATE_RATIO, TURNS = -1.5, 6
result = compute_floquet(system, SPIN_RATE_RATIO)
push_m = np.zeros((system.n, 3))
push_m[:, 2] = 1e-3 * np.random.default_rng(1).standard_normal(system.n)
start = State(result.state.position_m + push_m, result.state.velocity_m_s)
propagator = Propagator(system, SPIN_RATE_RATIO, start, rtol=1e-12)
turns = np.linspace(0.0, TURNS, 100 * TURNS + 1)
position_m, _ = propagator.sample(turns * propagator.period_s)
height_m = np.abs(position_m[..., 2]).max(axis=1)
whole = np.arange(2, TURNS + 1) * 100
growth = float(np.exp(np.polyfit(turns[whole], np.log(height_m[whole]), 1)[0]))
print(f"growth per turn at {SPIN_RATE_RATIO:g}: simulated {growth:.3f}, "
      f"monodromy {result.max_modulus:.3f}, closed form {tilt_growth(SPIN_RATE_RATIO):.3f}")

# %%
# The picture
# -----------

figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.8), layout="constrained")
left.semilogy(RATES, closed_form, color="0.7", linewidth=6.0, label="closed form, rigid ring")
left.semilogy(RATES, true, "o", color=BLUE, markersize=4, label="monodromy, Eqs. (12)-(27)")
left.semilogy(RATES, frozen, "s", color=RED, markersize=3, label="frozen, Eqs. (34)-(47)")
left.set_title("The frozen method stays at 1 where the axis tilts")
left.set(xlabel="spin rate over orbital rate, ω/Ω [-]", ylabel="largest multiplier, max |ρ| [-]")
left.legend(frameon=False, loc="upper left")

right.semilogy(turns, height_m, color=INK, linewidth=1.3, label="simulated")
for modulus, colour, name in ((result.max_modulus, BLUE, "monodromy"), (1.0, RED, "frozen")):
    right.semilogy(
        turns, height_m[whole[0]] * modulus ** (turns - turns[whole[0]]), "--", color=colour,
        linewidth=1.3, label=f"{name}: {modulus:.2f} per turn",
    )
right.set_title(f"A push out of the plane at ω = {SPIN_RATE_RATIO:g} Ω grows")
right.set(xlabel="turns of the formation [-]", ylabel="largest distance from the orbit plane [m]")
right.legend(frameon=False, loc="upper left")

if len(sys.argv) > 1:
    figure.savefig(sys.argv[1])
plt.show()
