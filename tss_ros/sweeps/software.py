"""What computes a result: versions, and a digest of the core's own source."""

import functools
import hashlib
from importlib.metadata import version
from pathlib import Path

from tss_ros import core


@functools.cache
def versions() -> dict[str, str]:
    """What results to the last bit depend on, beside the kind of processor.

    Returns
    -------
    dict of str to str
        By name; "core" is a digest, so that a core that was changed in a checkout is told apart.
    """
    digest = hashlib.sha256()
    folder = Path(core.__file__).parent
    for path in sorted(folder.rglob("*.py")):
        digest.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    packages = ("tss_ros", "numpy", "scipy", "numba")
    return {**{name: version(name) for name in packages}, "core": digest.hexdigest()[:12]}


def differences(there: dict[str, str], here: dict[str, str]) -> str:
    """In words, what differs between two sets of `versions`; "" if nothing does."""
    return ", ".join(
        f"{name} is {there.get(name)} there and {here[name]} here"
        for name in here
        if there.get(name) != here[name]
    )
