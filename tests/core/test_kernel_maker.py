"""Made kernels against arithmetic of fifty digits, for formulas at random."""

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest
from formulas import DIGITS, Series, exact, expression_of, interpreted, random_formula
from numba import njit

from tss_ros.core.numerics import simd
from tss_ros.core.numerics.expressions import (
    derivative,
    distributed,
    dot,
    excess,
    exp,
    power,
    rate,
    sqrt,
    symbol,
)
from tss_ros.core.numerics.series_maker import SeriesProgram
from tss_ros.core.numerics.simd import WIDTH
from tss_ros.core.numerics.value_maker import function_of

VARYING, CONSTANT = ("x", "y", "z"), ("c", "d")
SYMBOLS = {name: symbol(name, varies=name in VARYING) for name in (*VARYING, *CONSTANT)}
X, Y, Z, C, D = SYMBOLS.values()
SCALARS = {"sqrt": math.sqrt, "exp": math.exp}
ORDER = 9
#: Room that a program must leave alone, before its own.
BEFORE = 5


def splat(value):
    return np.full(WIDTH, value)


def store(array, at, value):
    array[at : at + WIDTH] = value


#: Lanes of numpy, quicker tried than compiled.
NUMPY_LANES = {
    "load": lambda array, at: array[at : at + WIDTH].copy(),
    "store": store, "splat": splat, "sqrt": np.sqrt, "exp": np.exp, "WIDTH": WIDTH,
}  # fmt: skip
LANES = {name: getattr(simd, name, getattr(math, name, None)) for name in NUMPY_LANES}
INPUTS = {
    SYMBOLS[name]: f"load(s, {len(VARYING) * WIDTH} * ({{0}}) + {i * WIDTH})"
    for i, name in enumerate(VARYING)
}
SCALAR_CONSTANTS = {SYMBOLS[name]: f"c[{WIDTH * i}]" for i, name in enumerate(CONSTANT)}
LANE_CONSTANTS = {SYMBOLS[name]: f"load(c, {WIDTH * i})" for i, name in enumerate(CONSTANT)}


class Motion:
    """Series of the symbols at random, of their own in every lane, with the same constants."""

    def __init__(self, rng, orders=ORDER + 2, scalar=True):
        self.series = rng.normal(0.0, 0.3, (orders, len(VARYING), WIDTH))
        self.series[0] = rng.uniform(0.5, 2.0, (len(VARYING), 1)) * rng.uniform(
            0.97, 1.03, (len(VARYING), WIDTH)
        )
        constants = rng.uniform(0.5, 2.0, (len(CONSTANT), WIDTH))
        self.constants = constants[:, :1] + 0.0 * constants if scalar else constants

    def lane(self, i, orders=None):
        """Series of all symbols in one lane, by name."""
        known = self.series[:orders, :, i]
        size = known.shape[0]
        lane = {name: Series(known[:, k]) for k, name in enumerate(VARYING)}
        return lane | {
            name: Series.of(self.constants[k, i], size) for k, name in enumerate(CONSTANT)
        }

    def lanes(self, orders=None):
        return [self.lane(i, orders) for i in range(WIDTH)]


def compiled(function):
    """A function of three outputs in registers, compiled, that returns them as an array."""
    made = njit(error_model="numpy")(function)

    @njit
    def kernel(s, c, room, at, k):
        out = np.empty(3 * WIDTH)
        one, two, three = made(s, c, room, at, k)
        simd.store3(out, 0, one, two, three)
        return out

    return kernel


def coefficients(program, motion, ahead, names=NUMPY_LANES, wrapped=lambda function: function):
    """All coefficients that a program makes, (orders, outputs, W), and its room.

    It is shown no coefficient that it may not need, and room full of what is no number.
    """
    function = wrapped(program.function("made", "s, c, room, at, k", names))
    constants = np.ascontiguousarray(motion.constants.ravel())
    room = np.full(BEFORE + len(program.slots) * WIDTH * (ORDER + 3), np.nan)
    made = []
    for k in range(ORDER + 1):
        known = np.full_like(motion.series, np.nan)
        known[: k + 1 + ahead] = motion.series[: k + 1 + ahead]
        made.append(function(known.ravel(), constants, room, BEFORE, k))
    assert np.isnan(room[:BEFORE]).all()
    return np.reshape(made, (ORDER + 1, -1, WIDTH)), room


def assert_close(made, series, rtol):
    """Coefficients of one lane, to so much of the largest one up to each."""
    largest = Decimal(0)
    for k, ours in enumerate(made):
        largest = max(largest, abs(series.c[k]))
        assert abs(Decimal(float(ours)) - series.c[k]) <= Decimal(rtol) * largest, f"order {k}"


# -- values ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(60))
def test_values_are_those_of_the_formula(seed):
    rng = np.random.default_rng(seed)
    points = Motion(rng, 2, scalar=False).lanes()
    formula = random_formula(rng, points, 8, VARYING)
    outputs = [expression_of(formula, SYMBOLS), X + Y, expression_of(formula, SYMBOLS) / Z]
    inputs = {s: name for name, s in SYMBOLS.items()}
    made = function_of("made", "x, y, z, c, d", inputs, outputs, SCALARS)
    arrays = function_of("made", "x, y, z, c, d", inputs, outputs, {"sqrt": np.sqrt, "exp": np.exp})
    several = arrays(*(np.array([float(p[name].c[0]) for p in points]) for name in SYMBOLS))
    for i, point in enumerate(points):
        values = made(*(float(point[name].c[0]) for name in SYMBOLS))
        with localcontext(prec=DIGITS):
            expected = exact(formula, point).c[0]
            expected = expected, point["x"].c[0] + point["y"].c[0], expected / point["z"].c[0]
        np.testing.assert_allclose(values, [float(e) for e in expected], rtol=2e-13)
        np.testing.assert_allclose([v[i] for v in several], values, rtol=1e-14)


@pytest.mark.parametrize("seed", range(20))
def test_values_of_derivatives_are_those_of_differences(seed):
    rng = np.random.default_rng(seed)
    (point,) = Motion(rng, 2).lanes()[:1]
    formula = random_formula(rng, [point], 6, VARYING)
    slopes = [derivative(expression_of(formula, SYMBOLS), s) for s in SYMBOLS.values()]
    inputs = {s: name for name, s in SYMBOLS.items()}
    values = function_of("made", "x, y, z, c, d", inputs, slopes, SCALARS)(
        *(float(point[name].c[0]) for name in SYMBOLS)
    )
    h = Decimal(10) ** -16
    for name, ours in zip(SYMBOLS, values):
        sides = [exact(formula, point | {name: point[name] + s * h}).c[0] for s in (1, -1)]
        with localcontext(prec=DIGITS):
            slope = float((sides[0] - sides[1]) / (2 * h))
        assert ours == pytest.approx(slope, rel=1e-12, abs=1e-12), name


@pytest.mark.parametrize("exponent", [-5.5, -3.0, -2.5, -1.5, -0.5, 0.5, 1.0, 1.5, 2.0, 4.5])
@pytest.mark.parametrize("x", [1e-14, -3e-9, 2e-4, -0.4, 1.7])
def test_an_excess_does_not_cancel(exponent, x):
    made = function_of("made", "x", {X: "x"}, [excess(X, exponent)], SCALARS)
    expected = float(Series([x]).excess(exponent).c[0])
    assert made(x) == pytest.approx(expected, rel=3e-15, abs=0.0)


def test_what_is_common_is_computed_once():
    made = function_of(
        "made", "x, y", {X: "x", Y: "y"}, [sqrt(X * Y + 1.0), 1.0 / sqrt(X * Y + 1.0)],
        {"sqrt": lambda x: calls.append(x) or math.sqrt(x)},
    )  # fmt: skip
    calls = []
    assert made(2.0, 4.0) == (3.0, 1.0 / 3.0)
    assert calls == [9.0]


# -- series ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(40))
def test_series_are_those_of_the_formula(seed):
    """With constants as numbers and as lanes, and rates of polynomials in every second one."""
    rng = np.random.default_rng(seed)
    with_rates, scalar = seed % 2 == 1, seed % 4 < 2
    motion = Motion(rng, scalar=scalar)
    lanes = motion.lanes()
    formula = random_formula(rng, motion.lanes(2), 7, VARYING, rates=with_rates)
    # Alone, in a product with a sum, and as a part of something that is needed as well.
    other = ("+", ("*", formula, ("symbol", "x")), ("*", ("symbol", "y"), ("symbol", "z")))
    formulas = [("*", formula, ("symbol", "y")), other]
    outputs = {f"o{i}": expression_of(f, SYMBOLS) for i, f in enumerate(formulas)}
    constants = SCALAR_CONSTANTS if scalar else LANE_CONSTANTS
    made, _ = coefficients(SeriesProgram(INPUTS, constants, outputs), motion, ahead=with_rates)
    for i, lane in enumerate(lanes):
        for j, f in enumerate(formulas):
            assert_close(made[:, j, i], exact(f, lane), 2e-11)


@pytest.mark.parametrize("seed", range(2))
def test_compiled_series_are_those_of_the_formula(seed):
    """In registers; what is no number in one lane stays in that lane."""
    rng = np.random.default_rng(100 + seed)
    motion = Motion(rng, scalar=False)
    idle = int(rng.integers(0, WIDTH))
    lanes = motion.lanes()
    formulas = [random_formula(rng, motion.lanes(2), 5, VARYING, rates=True) for _ in range(3)]
    formulas = [("*", f, ("symbol", "y")) for f in formulas]
    outputs = {f"o{i}": expression_of(f, SYMBOLS) for i, f in enumerate(formulas)}
    # Tethers that are not there have no length.
    motion.series[:, :, idle] = 0.0
    program = SeriesProgram(INPUTS, LANE_CONSTANTS, outputs)
    made, _ = coefficients(program, motion, True, LANES, compiled)
    for i, lane in enumerate(lanes):
        for j, f in enumerate(formulas):
            if i != idle:
                assert_close(made[:, j, i], exact(f, lane), 2e-11)


def a_tether(stiffness=C, rest=D):
    """Squared length and tension over length, as laws of tethers have them."""
    square = dot((X, Y, Z), (X, Y, Z))
    length = sqrt(square)
    over_length = stiffness * (length - rest) / length
    return square, over_length, 0.7 * (rate(square) / (2.0 * sqrt(square))) / sqrt(square)


@pytest.mark.parametrize("scalar", [True, False])
def test_series_of_a_damped_tether(scalar):
    """The rate of the squared length is needed one order ahead of everything else."""
    motion = Motion(np.random.default_rng(5), scalar=scalar)
    square, elastic, damper = a_tether()
    pull = distributed(elastic + damper)
    program = SeriesProgram(
        INPUTS, SCALAR_CONSTANTS if scalar else LANE_CONSTANTS,
        {"x": pull * X, "y": pull * Y, "z": pull * Z}, kept=(square, pull),
    )  # fmt: skip
    made, room = coefficients(program, motion, ahead=1)
    orders = room[BEFORE:].reshape(-1, len(program.slots), WIDTH)
    assert [program.slots[square], program.slots[pull]] == [0, 1]
    for i, lane in enumerate(motion.lanes()):
        lane = {SYMBOLS[name]: s for name, s in lane.items()}
        for j, s in enumerate((X, Y, Z)):
            assert_close(made[:, j, i], interpreted((elastic + damper) * s, lane), 1e-12)
        assert_close(orders[: ORDER + 2, 0, i], interpreted(square, lane), 1e-13)
        assert_close(orders[: ORDER + 1, 1, i], interpreted(elastic + damper, lane), 1e-12)


def test_what_is_known_ahead_is_known_where_it_is_used_otherwise():
    """Products in a rate are computed one order before they are needed elsewhere."""
    motion = Motion(np.random.default_rng(3))
    xy = X * Y
    outputs = [rate(xy) * Z + xy, 2.0 * xy / Z + rate(xy + Z), C * xy, xy + 1.0]
    program = SeriesProgram(INPUTS, SCALAR_CONSTANTS, dict(zip("abcd", outputs)))
    made, _ = coefficients(program, motion, ahead=1)
    for i, lane in enumerate(motion.lanes()):
        lane = {SYMBOLS[name]: s for name, s in lane.items()}
        for j, output in enumerate(outputs):
            assert_close(made[:, j, i], interpreted(output, lane), 1e-13)


def test_order_0_is_computed_in_the_form_that_cancels_less():
    """A length without rounding: (l - L)/l then keeps all digits, 1 - L/l ten of them."""
    motion = Motion(np.random.default_rng(1))
    motion.series[0] = np.array([3.0, 4.0, 0.0])[:, None] * 2e3 * (1.0 + 2.0**-20)
    motion.constants[1] = 1e4
    _, pull, _ = a_tether()
    distributed_pull, errors = distributed(pull), []
    expected = interpreted(pull * X, {SYMBOLS[n]: s for n, s in motion.lane(0).items()})
    for starts in ({}, {distributed_pull: pull}):
        outputs = {"o": distributed_pull * X}
        program = SeriesProgram(INPUTS, SCALAR_CONSTANTS, outputs, (distributed_pull,), starts)
        made, _ = coefficients(program, motion, ahead=0)
        errors.append(abs(float(Decimal(made[0, 0, 0]) / expected.c[0] - 1)))
    assert errors[0] > 1e-13
    assert errors[1] < 4e-16
    assert_close(made[:, 0, 0], expected, 1e-12)


def test_programs_that_share_room_leave_each_other_alone():
    motion = Motion(np.random.default_rng(2))
    outputs = [{"o": exp(X) / Y * sqrt(X + Z)}, {"o": excess(X * Y, -1.5) * Z}]
    alone, programs = [], [SeriesProgram(INPUTS, SCALAR_CONSTANTS, o) for o in outputs]
    for o in outputs:
        alone.append(coefficients(SeriesProgram(INPUTS, SCALAR_CONSTANTS, o), motion, 0)[0])
    first, stride = 0, sum(len(program.slots) for program in programs)
    for program in programs:
        program.lie(first, stride)
        first += len(program.slots)
    functions = [p.function("made", "s, c, room, at, k", NUMPY_LANES) for p in programs]
    room = np.full(stride * WIDTH * (ORDER + 1), np.nan)
    for k in range(ORDER + 1):
        for function, expected in zip(functions, alone):
            made = function(motion.series.ravel(), motion.constants.ravel(), room, 0, k)
            assert np.array_equal(made, expected[k, 0])
    assert np.isfinite(room).all()  # and there is no slot that nobody fills


# -- what is refused -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "expression, kind",
    [
        (rate(sqrt(X)), "power"),
        (rate(X / Y), "quotient"),
        (rate(exp(X)), "exp"),
        (rate(excess(X, 0.5)), "excess"),
        (rate(C * X), "scaled"),
        (rate(rate(X * X)), "rate"),
    ],
)
def test_rates_of_what_is_no_polynomial_are_refused(expression, kind):
    with pytest.raises(ValueError, match=f"the rate of a {kind} is not made"):
        SeriesProgram(INPUTS, SCALAR_CONSTANTS, {"o": expression * Y}).function(
            "made", "s, c, room, at, k", NUMPY_LANES
        )


def test_series_of_powers_that_roots_do_not_make_are_refused():
    """Registers have square roots; values have any power."""
    made = function_of("made", "x", {X: "x"}, [power(X, 1.3)], SCALARS)
    assert made(2.0) == pytest.approx(2.0**1.3, rel=1e-15)
    with pytest.raises(ValueError, match="made of square roots, got exponent 1.3"):
        SeriesProgram(INPUTS, SCALAR_CONSTANTS, {"o": power(X, 1.3) * Y})


def test_symbols_of_which_nothing_is_known_are_refused():
    with pytest.raises(ValueError, match="nothing is known of .*'w'"):
        function_of("made", "x", {X: "x"}, [X * symbol("w")], SCALARS)
    with pytest.raises(ValueError, match="nothing is known of .*rate"):
        function_of("made", "x", {X: "x"}, [X + rate(X)], SCALARS)
    with pytest.raises(ValueError, match="nothing is known of .*'w'"):
        SeriesProgram(INPUTS, SCALAR_CONSTANTS, {"o": X * symbol("w")})
    constant = SeriesProgram(INPUTS, SCALAR_CONSTANTS, {"o": X * symbol("v", varies=False)})
    with pytest.raises(ValueError, match="nothing is known of .*'v'"):
        constant.function("made", "s, c, room, at, k", NUMPY_LANES)
