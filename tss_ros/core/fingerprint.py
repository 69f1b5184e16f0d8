"""A digest of the core's source, by which results and compiled kernels are told apart."""

import hashlib
from functools import cache
from pathlib import Path

#: Where compiled kernels, and all that they are made of, stand; and what knows no laws of these.
KERNELS, NUMERICS = ("numerics", "model", "motion"), ("numerics",)
#: What laws of users state, by name; told by `model.own_laws`.
OWN_LAWS: dict[str, str] = {}


@cache
def _files(packages):
    digest, folder = hashlib.sha256(), Path(__file__).parent
    for package in packages:
        for path in sorted((folder / package).rglob("*.py")):
            digest.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def fingerprint(packages: tuple[str, ...] = ("",)) -> str:
    """Of all modules of the core or of some of its packages, and of users' laws; hexadecimal."""
    files = _files(packages)
    if packages == NUMERICS or not OWN_LAWS:
        return files
    return hashlib.sha256(repr((files, sorted(OWN_LAWS.items()))).encode()).hexdigest()
