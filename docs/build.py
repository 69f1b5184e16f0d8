"""Builds the HTML pages into docs/_build/html; `make docs` runs it in an activated shell.

Sphinx and its extensions come from requirements/docs.txt into a folder of their own,
.docs-packages, which Python sees in front of what the workspace has. Nothing is installed into
.venv, and what .venv has already is not installed twice.
"""

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PACKAGES = ROOT / ".docs-packages"
LOCK, BASE_LOCK = (ROOT / "requirements" / name for name in ("docs.txt", "python.txt"))


def missing_requirements():
    """Return the lines of the docs' lock that the workspace's own does not have."""
    present = set(BASE_LOCK.read_text(encoding="utf-8").splitlines())
    return [x for x in LOCK.read_text(encoding="utf-8").splitlines() if x not in present]


def install():
    """Make the folder of packages afresh if the lock or the Python has changed."""
    lines = missing_requirements()
    wanted = hashlib.sha256("\n".join([sys.version, *lines]).encode()).hexdigest()
    stamp = PACKAGES / ".stamp"
    if stamp.is_file() and stamp.read_text() == wanted:
        return
    print(f"installing Sphinx into {PACKAGES.name}", flush=True)
    shutil.rmtree(PACKAGES, ignore_errors=True)
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
        file.write("\n".join(lines) + "\n")
        file.flush()
        pip = [sys.executable, "-m", "pip", "install", "-qq", "--no-deps", "--only-binary", ":all:"]
        subprocess.run([*pip, "--target", PACKAGES, "-r", file.name], check=True)
    stamp.write_text(wanted)


def main():
    """Install what is missing and run Sphinx; a warning is an error."""
    install()
    path = [str(PACKAGES), os.environ.get("PYTHONPATH", "")]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, path)), "MPLBACKEND": "agg"}
    sphinx = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html"]
    sphinx += ["-d", DOCS / "_build" / "doctrees", DOCS, DOCS / "_build" / "html"]
    status = subprocess.run([*sphinx, *sys.argv[1:]], env=env).returncode
    if status == 0:
        print("docs/_build/html/index.html")
    return status


if __name__ == "__main__":
    sys.exit(main())
