"""How long the multipliers of the 3-star ring at 200 spin rates take, corrected, warm.

Run as `python -m benchmarks.sweeping [COUNT]`; prints JSON.
"""

import json
import sys
import time
from collections import Counter

import numpy as np

from tss_ros.core import FloquetJob, TssError, ring, sweep

RATES = (-3.5, -1.5)
WORKERS = (1, 2)


def measure(count=200):
    """Seconds and outcomes by the number of workers."""
    system = ring()
    jobs = [FloquetJob(system, float(rate)) for rate in np.linspace(*RATES, count)]
    list(sweep(jobs[:2]))  # warm
    table = {}
    for workers in WORKERS:
        begun = time.perf_counter()
        outcomes = dict(sweep(jobs, workers))
        seconds = time.perf_counter() - begun
        verdicts = Counter(
            "failed" if isinstance(found, TssError) else found.verdict
            for found in outcomes.values()
        )
        table[str(workers)] = {"s": seconds, "rates": count, "outcomes": dict(verdicts)}
    return table


if __name__ == "__main__":
    print(json.dumps(measure(*map(int, sys.argv[1:]))))
