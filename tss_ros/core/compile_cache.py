"""Compile every kernel once so that later processes load them from numba's cache.

`tss compile` does, and so does the set-up, by ``python -m tss_ros.core.compile_cache``.
"""

from collections.abc import Callable

import numpy as np

from tss_ros.core import Propagator, compute_floquet, disturbed, initial_state, ring
from tss_ros.core.motion import compilation, integrate
from tss_ros.core.numerics.simd import is_cached


def main(show: Callable[[float], None]) -> bool:
    """Run each kernel on the smallest system that reaches it.

    Parameters
    ----------
    show : callable
        Called with the share that is done, from 0 to 1.

    Returns
    -------
    bool
        Whether the integrator, which takes most of the time, had to be compiled.
    """
    compiled = not is_cached(integrate.advance)
    compilation.Progress.show = staticmethod(show)
    system = ring()
    compute_floquet(system, -2.5)
    start = initial_state(system, -2.2)
    Propagator(system, -2.2, disturbed(start, 10.0)).sample(np.array([0.0, 10.0]))
    return compiled


if __name__ == "__main__":
    main(lambda share: print(f"{100 * share:.0f} %", flush=True))
