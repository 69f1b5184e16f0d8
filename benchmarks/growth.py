"""How time and memory of the motion grow with the number of beads, from 3 to 10 000.

Three-star rings whose 10 km tethers of 10 kg each are cut ever finer. For each: the rotating
equilibrium, then integration steps of the motion from it, at -10 Omega, in processor time. Run as
``python -m benchmarks.growth --png growth.png``; each ring has a process of
its own, so that memory is its own, too.
"""

import argparse
import json
import resource
import subprocess
import sys
import time

import numpy as np

from tss_ros.core import averaged_state, ring
from tss_ros.core.motion.integrator import Integrator

BEADS = (3, 10, 30, 100, 300, 1000, 3000, 10_000)
RATE, TETHER_KG, STEPS = -10.0, 10.0, 30


def long_ring(beads):
    """A three-star ring of so many beads, or the next more that share equally among its tethers."""
    per_tether = -(-beads // 3) - 1
    return ring(beads_per_tether=per_tether, bead_mass_kg=TETHER_KG / max(per_tether, 1))


def measure(beads):
    """Processor times [ms] and memory [MB] of one ring."""
    averaged_state(long_ring(6), RATE)
    system = long_ring(beads)
    begun = time.process_time()
    state = averaged_state(system, RATE)
    steady = time.process_time() - begun
    length = np.max(np.linalg.norm(state.position_m, axis=1))
    integrator = Integrator(system, system.spin_rate_rad_s(RATE), 1e-9, length)
    motion = integrator.begin(state)
    integrator.advance(motion, 1e9, STEPS)
    before = motion.progress.copy()
    begun = time.process_time()
    integrator.advance(motion, 1e9, STEPS)
    taken = time.process_time() - begun
    names = ("steps", "rejected", "newton_iterations")
    steps, refused, iterations = (int(motion.progress[x][0] - before[x][0]) for x in names)
    return {
        "beads": system.n,
        "steady_ms": 1e3 * steady,
        "step_ms": 1e3 * taken / steps,
        "iteration_us": 1e6 * taken / iterations,
        "iterations_per_step": iterations / steps,
        "refused": int(refused),
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def draw(rows, path):
    """Both curves on logarithmic axes, with the slope fitted from 100 beads on."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
    beads = np.array([row["beads"] for row in rows])
    for key, name in (
        ("step_ms", "step [ms]"),
        ("iteration_us", "Newton iteration [us]"),
        ("steady_ms", "rotating equilibrium [ms]"),
    ):
        value = np.array([row[key] for row in rows])
        left.loglog(beads, value, "o-", label=f"{name}: slope {slope(rows, key):.2f}")
    left.set(xlabel="beads", title="Processor time, slopes from 100 beads on")
    left.legend(fontsize="small")
    right.semilogx(beads, [row["memory_mb"] for row in rows], "o-")
    right.set(xlabel="beads", ylabel="MB", title="Memory of the whole process", ylim=(0, None))
    figure.savefig(path, dpi=120)


def slope(rows, key):
    """Exponent of the growth of `key` from 100 beads on."""
    long = [row for row in rows if row["beads"] >= 100]
    return np.polyfit(*(np.log([row[k] for row in long]) for k in ("beads", key)), 1)[0]


def table(rows):
    """Lines of Markdown."""
    return [
        "| beads | rotating equilibrium [ms] | a step [ms] | an iteration in it [us] | iterations |"
        " memory [MB] |",
        "|---:|---:|---:|---:|---:|---:|",
        *(
            f"| {row['beads']} | {row['steady_ms']:.1f} | {row['step_ms']:.2f}"
            f" | {row['iteration_us']:.1f} | {row['iterations_per_step']:.1f}"
            f" | {row['memory_mb']:.0f} |"
            for row in rows
        ),
        "",
        "From 100 beads on a step grows like beads to the power of"
        f" {slope(rows, 'step_ms'):.2f}, the equilibrium like {slope(rows, 'steady_ms'):.2f}.",
    ]


def main():
    """Print the rows and the table as JSON, telling each row as it comes, and draw them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--png", metavar="FILE")
    parser.add_argument("--one", type=int, metavar="BEADS", help="measure one ring, print its JSON")
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.one)))
        return
    rows = []
    for beads in BEADS:
        answer = subprocess.run(
            [sys.executable, "-m", "benchmarks.growth", "--one", str(beads)],
            check=True,
            stdout=subprocess.PIPE,
        )
        rows.append(json.loads(answer.stdout))
        print(rows[-1], file=sys.stderr, flush=True)
    print(json.dumps({"rows": rows, "markdown": table(rows)}, indent=1))
    if options.png:
        draw(rows, options.png)


if __name__ == "__main__":
    main()
