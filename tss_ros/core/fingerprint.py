"""A digest of the core's source, by which results and compiled kernels are told apart."""

import hashlib
from functools import cache
from pathlib import Path

#: Where compiled kernels, and all that they are made of, stand.
KERNELS = ("numerics", "model", "motion")


@cache
def fingerprint(packages: tuple[str, ...] = ("",)) -> str:
    """Of all modules of the core or of some of its packages, places and contents; hexadecimal."""
    digest, folder = hashlib.sha256(), Path(__file__).parent
    for package in packages:
        for path in sorted((folder / package).rglob("*.py")):
            digest.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
