"""What computes a result: versions, and a digest of the core's own source."""

import functools
from importlib.metadata import version

from tss_ros.core.fingerprint import fingerprint


@functools.cache
def versions() -> dict[str, str]:
    """What results to the last bit depend on, beside the kind of processor.

    Returns
    -------
    dict of str to str
        By name; "core" is a digest, so that a core that was changed in a checkout is told apart.
    """
    packages = ("tss_ros", "numpy", "scipy", "numba")
    return {**{name: version(name) for name in packages}, "core": fingerprint()[:12]}


def differences(there: dict[str, str], here: dict[str, str]) -> str:
    """In words, what differs between two sets of `versions`; "" if nothing does."""
    return ", ".join(
        f"{name} is {there.get(name)} there and {here[name]} here"
        for name in here
        if there.get(name) != here[name]
    )
