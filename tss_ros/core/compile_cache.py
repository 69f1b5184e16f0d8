"""Compile every kernel once so that later processes load them from numba's cache.

Run as ``python -m tss_ros.core.compile_cache``; the set-up does.
"""

import numpy as np

from tss_ros.core import Propagator, compute_floquet, disturbed, initial_state, ring


def main() -> None:
    """Run each kernel on the smallest system that reaches it."""
    system = ring()
    compute_floquet(system, -2.5)
    start = initial_state(system, -2.2)
    Propagator(system, -2.2, disturbed(start, 10.0)).sample(np.array([0.0, 10.0]))


if __name__ == "__main__":
    main()
