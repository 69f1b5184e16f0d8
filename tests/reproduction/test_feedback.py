"""The page on feedback says how its numbers are made, and they are made so."""

import re
import subprocess
import textwrap
from pathlib import Path

import numpy as np
import pytest
from ros_harness import SWEEP

from tss_ros.core import compute_floquet
from tss_ros.reproduction.feedback import RATE, WATCHED, shipped, six_beads, three_star
from tss_ros.reproduction.feedback_report import _wrapped, settings
from tss_ros.scenarios import scenario

PAGE = (Path(__file__).parents[2] / "docs" / "feedback.md").read_text(encoding="utf-8")


def written(first):
    """A command of the page, from its first words to the end of its block."""
    block = next(part for part in PAGE.split("\n\n") if part.startswith(f"    {first}"))
    return textwrap.dedent(block)


def test_the_page_says_which_ring_its_six_beads_are():
    own, ring = (compute_floquet(of(WATCHED), RATE, certify=False) for of in (shipped, six_beads))
    parts = settings({"rows": [{"gain": WATCHED, "result": ring}], "shipped": own})
    assert "\n\n".join(_wrapped(part) for part in parts) in PAGE
    of_page = scenario.load("six_bead").build(
        {"damping_n_s_per_m": 100.0, "rotation_damping_n_s_per_m": WATCHED}
    )
    same(of_page, six_beads(WATCHED))


def test_the_page_says_which_ring_its_three_satellites_are():
    assert "the scenario `three_star` with the `tether_law` tension_only" in " ".join(PAGE.split())
    same(scenario.load("three_star").build({"tether_law": "tension_only"}), three_star(0.0))


def same(one, other):
    for name in ("mass_kg", "rest_length_m", "axial_stiffness_n", "damping_n_s_per_m"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert one.orbit_rate_rad_s == other.orbit_rate_rad_s
    assert one.tether_law == other.tether_law


def test_the_commands_of_the_page_give_its_numbers():
    table = re.search(rf"\| {WATCHED:g} \| asymptotically stable \| ([0-9.]+) \|", PAGE)[1]
    own = re.search(r"own C, without the last word, gives ([0-9.]+)\.\n", PAGE)[1]
    words = written("tss sweep").replace("\\\n", " ").split()[2:]
    assert words[-1].startswith("damping_n_s_per_m=") and own != table
    for asked, told in ((words, table), (words[:-1], own)):
        done = subprocess.run([*SWEEP, *asked], capture_output=True, text=True, timeout=120)
        found = float(re.search(r"by shape ([0-9.]+)", done.stdout)[1])
        assert found == pytest.approx(float(told), abs=6e-6), done.stderr
