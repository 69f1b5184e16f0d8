"""Public functions name an argument that is of a wrong type, and show no names but their own."""

import inspect
from fractions import Fraction

import numpy as np
import pytest

from tss_ros import core
from tss_ros.core.arguments import checked

RING = core.ring()
START = core.initial_state(RING, -2.5)
POSITION_M, VELOCITY_M_S = START.position_m, START.velocity_m_s


def refused(call):
    with pytest.raises(core.TssError) as error:
        call()
    return str(error.value)


WRONG = {
    "spin_rate_ratio must be a number, got 'fast'": lambda: core.compute_floquet(RING, "fast"),
    "spin_rate_ratio must be a number, got True": lambda: core.initial_state(RING, True),
    "system must be a System, got 'three_star'": lambda: core.compute_floquet("three_star", -2.5),
    "state must be a State or None, got ndarray": lambda: core.compute_floquet(
        RING, -2.5, state=POSITION_M
    ),
    "certify must be True or False, got 1": lambda: core.compute_floquet(RING, -2.5, certify=1),
    "leading must be a whole number or None, got 1.5": lambda: core.compute_floquet(
        RING, -2.5, leading=1.5
    ),
    "cancelled must be a function or None, got 'no'": lambda: core.confirm(
        RING, -2.5, cancelled="no"
    ),
    "turns must be a whole number, got 2.5": lambda: core.confirm(RING, -2.5, turns=2.5),
    "turns must be a number, got None": lambda: core.simulate(RING, -2.5, turns=None),
    "period_s must be a number or None, got 'short'": lambda: core.simulate(
        RING, -2.5, period_s="short"
    ),
    "parameter must be a text, got 3": lambda: core.follow(RING, 3, -2.5, -2.4),
    "branch must be a SpecialPoint or None, got -2.3": lambda: core.follow(
        RING, "spin_rate_ratio", -2.5, -2.4, branch=-2.3
    ),
    "result must be a FloquetResult, got System <System of 3": lambda: core.compute_modes(
        RING, RING
    ),
    "jobs must be an iterable, got 3": lambda: next(core.sweep(3)),
    "jobs[1] must have a method run, got 'job'": lambda: list(
        core.sweep([core.FloquetJob(RING, -2.5), "job"], workers=1)
    ),
    "position_m must be an array of numbers, got 'here'": lambda: core.tether_state(
        RING, "here", VELOCITY_M_S
    ),
    "times_s must be an array of numbers, got list ['now']": lambda: core.Propagator(
        RING, -2.5, START
    ).sample(["now"]),
    "seed must be a whole number, got 1.0": lambda: core.disturbed(START, 1.0, 1.0),
    "satellites must be a sequence of Satellites, got list [1]": lambda: core.assemble([1], []),
    "linear_gravity must be True or False, got 'no'": lambda: core.ring(linear_gravity="no"),
    "position_m must be x, y, z of each bead, got shape (2,)": lambda: core.State([1, 2], [3, 4]),
    "velocity_m_s must be an array of numbers, got 'fast'": lambda: core.State([[0, 0, 0]], "fast"),
    "name must be a text, got 5": lambda: core.parameter_of(RING, 5),
}


@pytest.mark.parametrize("words", WRONG)
def test_a_wrong_argument_is_named_with_its_value_and_what_is_allowed(words):
    assert refused(WRONG[words]).startswith(words)


def test_arrays_of_systems_are_named():
    values = dict.fromkeys(("is_satellite", "mass_kg"), [1, 1])
    values |= dict.fromkeys(("rest_length_m", "axial_stiffness_n", "damping_n_s_per_m"), [1.0])
    values |= {"tether_ends": [[0, 1]], "layout_m": [[0, 0, 0], [0, 0, 1]]}
    names = {"bead_name": ("a", "b"), "tether_name": ("t",)}
    core.System(**names, **values)
    for name, wrong in (("mass_kg", ["heavy", 1]), ("layout_m", "flat"), ("tether_ends", [[0], 1])):
        words = refused(lambda given={name: wrong}: core.System(**names, **(values | given)))
        assert words.startswith(f"{name} must be an array of numbers, got {wrong!r}")


def test_numbers_of_any_kind_and_lists_for_arrays_are_taken():
    first = core.disturbed(START, 10.0, 1)
    kinds = (np.float32(10.0), 10, np.int64(10), Fraction(10), np.array(10.0))
    for size in kinds:
        again = core.disturbed(START, size, np.int64(1))
        np.testing.assert_array_equal(again.position_m, first.position_m)
    listed = core.tether_state(RING, POSITION_M.tolist(), VELOCITY_M_S.tolist())
    for found, expected in zip(listed, core.tether_state(RING, POSITION_M, VELOCITY_M_S)):
        np.testing.assert_array_equal(found, expected)


def test_python_names_the_function_where_arguments_are_missing_or_unknown():
    with pytest.raises(TypeError, match=r"compute_floquet\(\) missing 1 required .*ratio"):
        core.compute_floquet(RING)
    with pytest.raises(TypeError, match=r"confirm\(\) got an unexpected keyword argument 'turn'"):
        core.confirm(RING, -2.5, turn=3)


def test_checked_functions_keep_their_signature_and_text():
    for function in (core.compute_floquet, core.simulate, core.Propagator.__init__):
        assert "System" in str(inspect.signature(function))
    assert core.confirm.__doc__.startswith("Simulate a disturbed formation")


def test_keyword_arguments_of_any_name_are_held_to_their_hint():
    @checked
    def total(first: int, **others: float) -> float:
        return first + sum(others.values())

    assert total(1, a=2.5) == 3.5
    assert refused(lambda: total(1, a="x")) == "a must be a number, got 'x'"


def test_the_core_shows_its_public_names_alone():
    assert dir(core) == sorted(core.__all__)
    assert all(hasattr(core, name) for name in dir(core))
