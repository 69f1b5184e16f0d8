"""Snapshots: they hold all that the integrator remembers, and say of which version they are."""

import numpy as np
import pytest

from tss_ros.core import Propagator, TssError, disturbed, initial_state, ring
from tss_ros.simulator import snapshot
from tss_ros.simulator.checkpoint import make_checkpoint, resume

RING = ring(satellite_mass_kg=100.0)
#: So slow that tethers go slack again and again: steps of both kinds are made.
RATIO = -1.6
PLACE = {"index": 9, "base_ns": 5, "since_ns": 3}
COMMANDS = {
    "when_and_where": np.array([[10, 1, 2], [20, 0, -1]]),
    "force_n": np.ones((2, 3)),
    "failures": np.array([[10, 1, 2, 1]]),
    "held": np.ones((1, 9)),
    "due": np.array([True, False, True]),
    "reel_heads": np.array([[30, 2, 0, 1, 0]]),
    "reel_limits": np.array([[1.0, 1.0, 0.0]]),
    "reel_points": np.array([[5.0, 0.0, -0.5]]),
    "reel_since_ns": np.array([0, 7, 9]),
    "reel_cubic": np.array(3 * [[9e3, 0.5, 0.0, 0.0]]),
    "law_left": np.array([4]),
}


@pytest.fixture
def propagator():
    """A function that makes integrators of the same disturbed motion."""
    start = disturbed(initial_state(RING, RATIO), 10.0, 3)
    return lambda: Propagator(RING, RATIO, start)


@pytest.fixture
def written(tmp_path, propagator):
    """A snapshot's file, and what was written to it."""
    original = propagator()
    original.sample(2.0 * np.arange(8))
    file, identity = str(tmp_path / "kept.npz"), {"mass_kg": RING.mass_kg}
    kept = make_checkpoint(original, 7)
    snapshot.write(file, identity, PLACE, kept, COMMANDS)
    return file, identity, kept


def changed(file, tmp_path, **entries):
    """Another snapshot with entries changed, or left out where they are None."""
    with np.load(file) as archive:
        content = {**archive, **entries}
    other = str(tmp_path / "changed.npz")
    np.savez(other, **{name: value for name, value in content.items() if value is not None})
    return other


@pytest.mark.parametrize("samples", [1, 50, 777])
def test_a_resumed_integrator_goes_on_bit_for_bit(propagator, samples):
    original, other = propagator(), propagator()
    original.sample(2.0 * np.arange(samples))
    resume(other, make_checkpoint(original, samples - 1))
    later = 2.0 * np.arange(samples, samples + 400)
    for expected, found in zip(original.sample(later), other.sample(later)):
        np.testing.assert_array_equal(found, expected)
    assert (other.steps, other.switches) == (original.steps, original.switches)
    assert original.switches > 0


def test_a_checkpoint_does_not_change_with_its_integrator(propagator):
    original = propagator()
    kept = make_checkpoint(original, 0)
    before = {name: array.copy() for name, array in kept.arrays.items()}
    original.sample(2.0 * np.arange(100))
    for name, array in kept.arrays.items():
        np.testing.assert_array_equal(array, before[name])


def test_what_was_written_is_read_again(written):
    file, identity, kept = written
    place, found, commands = snapshot.read(file, identity, kept, furthest=256)
    assert place == PLACE and found.index == kept.index
    for name, array in COMMANDS.items():
        np.testing.assert_array_equal(commands[name], array)
    assert found.arrays.keys() == kept.arrays.keys()
    for name, array in kept.arrays.items():
        np.testing.assert_array_equal(found.arrays[name], array)


@pytest.mark.parametrize(
    ("version", "shown"), [(None, "1"), (2, "2"), (0.5, "0.5"), ("two", "two"), ([2, 2], "[2 2]")]
)
def test_other_versions_are_refused_by_number(written, tmp_path, version, shown):
    file, identity, kept = written
    other = changed(file, tmp_path, format_version=version)
    with pytest.raises(TssError) as caught:
        snapshot.read(other, identity, kept, furthest=256)
    assert str(caught.value) == f"snapshot {other!r} has format version {shown}; allowed: 5"


def test_a_missing_entry_is_damage(written, tmp_path):
    file, identity, kept = written
    for name in kept.arrays:
        other = changed(file, tmp_path, **{f"integrator_{name}": None})
        with pytest.raises(TssError, match="is damaged"):
            snapshot.read(other, identity, kept, furthest=256)
