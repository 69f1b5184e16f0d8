"""
A recorded run in pandas
========================

A run recorded by the ROS nodes becomes tables: one row per step and satellite, one per step and
tether. Here a simulator and a recorder run for four turns, and pandas reads what they leave: how
the push dies out, and how the tension of the tethers swings.
"""

import contextlib
import io
import os
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.ticker import NullFormatter

# This example talks to nobody but its own nodes.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))

from tss_ros.bags.commands import export  # noqa: E402
from tss_ros.runs.processes import record, watched_nodes  # noqa: E402

BLUE, RED, GREEN, INK = "#0072B2", "#D55E00", "#009E73", "#333333"
plt.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "axes.grid": True})
plt.rcParams.update({"grid.color": "0.9", "axes.axisbelow": True, "figure.dpi": 110})

# %%
# Recording
# ---------
#
# In a shell this is ``ros2 run tss_ros logger_node`` beside ``ros2 run tss_ros sim_node``, then
# ``ros2 run tss_ros export my_bag --parquet tables``. Python does the same: the nodes are processes
# of their own, and all of them are gone when the ``with`` block ends.

SPIN_RATE_RATIO = -2.5


def recorded_tables(**simulator):
    """Record a run, export it, and return its beads, its tethers and the recording itself."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        with watched_nodes("example", folder, [], lambda *_: None) as (nodes, node, watch):
            recording = record(nodes, node, watch, folder / "bag", **simulator)
        with contextlib.redirect_stdout(io.StringIO()):
            status = export([str(folder / "bag"), "--parquet", str(folder / "tables")])
        if status:
            raise SystemExit("the export failed")
        beads, tethers = (
            pd.read_parquet(folder / "tables" / f"{name}.parquet") for name in ("beads", "tethers")
        )
    return beads, tethers, recording


beads, tethers, recording = recorded_tables(
    scenario="three_star", spin_rate_ratio=SPIN_RATE_RATIO, turns=4.0, publish_period_s=10.0,
    disturbance_m=10.0, disturbance_seed=1,
)
print(beads.tail(3).to_string())

# %%
# How the push dies out
# ---------------------
#
# All satellites have the same mass, so the centre of mass is the mean of their places. The
# deviation from there tells about the shape, whatever the drift along the orbit.

axes_m = ["x_m", "y_m", "z_m"]
place_m = beads[axes_m]
radius_m = np.linalg.norm(place_m, axis=1) / (1.0 + beads["deviation"])
from_centre_m = place_m - beads.groupby("step")[axes_m].transform("mean")
beads["from_centre"] = np.linalg.norm(from_centre_m, axis=1) / radius_m - 1.0
shape = beads.groupby("turns")["from_centre"].agg(lambda values: values.abs().max())
per_turn = shape.groupby(np.maximum(1, np.ceil(shape.index)).astype(int)).max()
print("largest deviation from the centre of mass, by turn:")
print((100 * per_turn).map("{:.4f} %".format).to_string())

# %%
# How the tension swings
# ----------------------
#
# A rigid triangle has a closed form: with theta the angle of a tether from the direction of flight,
# its tension is (M L / 3) Omega^2 (w^2 + 2 w + 3/2 - 3 cos 2 theta). It swings twice a turn. At
# this rate its least value lies just below zero. Eq. (6) allows that: the damping of a stretched
# tether may push. The tethers do not go slack.

w = SPIN_RATE_RATIO
scale_n = recording.mass_kg[0] * recording.rest_length_m[0] / 3.0 * recording.orbit_rate_rad_s**2
mean_n, swing_n = scale_n * (w * w + 2.0 * w + 1.5), 3.0 * scale_n
settled = tethers[tethers["turns"] > 1.0]
table = settled.groupby("tether", observed=True)["tension_n"].agg(["mean", "min", "max"])
print(table.round(4).to_string())
print(f"closed form: mean {mean_n:.4f} N, {mean_n - swing_n:.4f} to {mean_n + swing_n:.4f} N")
print(f"in the first turn: up to {tethers['tension_n'].max():.1f} N")
print(f"slack after the first turn: {(~settled['taut']).sum()} of {len(settled)} rows")

# %%
# The picture
# -----------
#
# The very first seconds, in which the push pulls at the tethers, reach beyond the lower picture.

figure, (top, bottom) = plt.subplots(2, 1, figsize=(9.0, 6.6), sharex=True, layout="constrained")
top.semilogy(shape.index, 100 * shape, color=INK, linewidth=1.2)
top.set_title("The push dies out within half a turn; the gravity gradient keeps the ring breathing")
top.set_ylabel("largest deviation from\nthe centre of mass [%]")
top.yaxis.set_minor_formatter(NullFormatter())
top.set_yticks(percents := [0.002, 0.005, 0.01, 0.02, 0.05], [f"{p:g}" for p in percents])
tensions = tethers.pivot(index="turns", columns="tether", values="tension_n")
for name, colour in zip(tensions.columns, (BLUE, RED, GREEN)):
    bottom.plot(tensions.index, tensions[name], color=colour, linewidth=1.2, label=name)
for value in (mean_n - swing_n, mean_n, mean_n + swing_n):
    (line,) = bottom.plot([0.0, 4.0], [value, value], "--", color=INK, linewidth=0.9)
line.set_label("rigid triangle: least, mean, largest")
bottom.set_title("Tension swings twice a turn about its mean")
bottom.set(xlabel="turns of the formation [-]", ylabel="tension [N]", xlim=(0.0, 4.0))
bottom.set_ylim(mean_n - 1.3 * swing_n, mean_n + 1.3 * swing_n)
figure.legend(
    *bottom.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False
)

if len(sys.argv) > 1:
    figure.savefig(sys.argv[1])
plt.show()
