"""Expressions against arithmetic of fifty digits, for formulas at random."""

from decimal import Decimal, localcontext

import numpy as np
import pytest
from formulas import DIGITS, Series, exact, expression_of, interpreted, random_formula

from tss_ros.core.numerics.expressions import (
    add,
    as_number,
    derivative,
    distributed,
    dot,
    excess,
    exp,
    power,
    rate,
    sqrt,
    substitute,
    symbol,
    symbols,
    varies,
)

NAMES = ("x", "y", "z", "c", "d")
SYMBOLS = {name: symbol(name, varies=name in "xyz") for name in NAMES}
X, Y, Z, C, D = SYMBOLS.values()


def a_formula(seed, size=6):
    """A formula and the values of its symbols."""
    rng = np.random.default_rng(seed)
    point = {name: Series([rng.uniform(0.5, 2.0), 0]) for name in NAMES}
    return random_formula(rng, [point], size, ["x", "y", "z"]), point


def by_symbol(point):
    return {SYMBOLS[name]: series for name, series in point.items()}


def close(a, b, rtol):
    return abs(a - b) <= Decimal(rtol) * max(abs(a), abs(b))


@pytest.mark.parametrize("seed", range(60))
def test_an_expression_keeps_the_value_of_its_formula(seed):
    """However it was put in order; numbers are folded in doubles."""
    formula, point = a_formula(seed)
    value = interpreted(expression_of(formula, SYMBOLS), by_symbol(point))
    assert close(value.c[0], exact(formula, point).c[0], 1e-13)


@pytest.mark.parametrize("seed", range(60))
def test_a_derivative_is_the_limit_of_differences(seed):
    formula, point = a_formula(seed)
    expression, h = expression_of(formula, SYMBOLS), Decimal(10) ** -16
    for name in NAMES:
        ours = interpreted(derivative(expression, SYMBOLS[name]), by_symbol(point)).c[0]
        sides = []
        for sign in (1, -1):
            moved = point | {name: point[name] + sign * h}
            sides.append(interpreted(expression, by_symbol(moved)).c[0])
        with localcontext(prec=DIGITS):
            slope = (sides[0] - sides[1]) / (2 * h)
        assert abs(ours - slope) <= Decimal(1e-12) * (1 + abs(slope)), name


@pytest.mark.parametrize("seed", range(30))
def test_replacing_symbols_is_replacing_their_values(seed):
    formula, point = a_formula(seed, 4)
    inner, _ = a_formula(seed + 1000, 3)
    inner_value = exact(inner, point)
    put = expression_of(inner, SYMBOLS)
    replaced = substitute(expression_of(formula, SYMBOLS), {X: put, C: 1.75})
    known = point | {"x": inner_value, "c": Series([1.75, 0])}
    expected = exact(formula, known).c[0]
    value = interpreted(replaced, by_symbol(point))
    assert close(value.c[0], expected, 1e-12)
    assert not (symbols(replaced) & {X, C}) - symbols(put)


@pytest.mark.parametrize("seed", range(30))
def test_distributing_products_keeps_the_value(seed):
    rng = np.random.default_rng(seed)
    formula, point = a_formula(seed, 4)
    one = expression_of(formula, SYMBOLS)
    two = (one + float(rng.uniform(0.5, 1.0)) * Y) ** int(rng.integers(1, 4)) * (Z - one) / D
    series = by_symbol(point)
    value, expected = interpreted(distributed(two), series), interpreted(two, series)
    # What cancels between the terms costs digits of the numbers folded in doubles.
    assert abs(value.c[0] - expected.c[0]) <= Decimal(1e-10) * (1 + abs(expected.c[0]))


def test_distributing_lets_terms_cancel():
    assert distributed((X + Y) ** 2 - 2.0 * X * Y - Y * Y) is X**2
    assert as_number(distributed((X - Y) * (X + Y) - X * X + Y**2)) == 0.0
    assert distributed((X - Y) / X) is distributed(1.0 - Y / X)


@pytest.mark.parametrize(
    "one, other",
    [
        (X * X, X**2),
        (X * Y, Y * X),
        (X + Y + 1.0, 1.0 + Y + X),
        (X / C / C, X / C**2),
        (sqrt(X) * sqrt(X), X),
        (power(power(X, 3.0), 0.5), power(X, 1.5)),
        (X - X, add(0.0)),
        (X / X, add(1.0)),
        (2.0 * (3.0 * X), 6.0 * X),
        (-(X - Y), Y - X),
        (sqrt(4.0 * X), 2.0 * sqrt(X)),
        (dot((X, Y), (X, Y)), X**2 + Y**2),
        (exp(X + Y), exp(Y + X)),
        (excess(X, 1.5), excess(X, 1.5)),
        (1.0 / (1.0 / X), X),
        (rate(C * D), add(0.0)),
    ],
)
def test_equal_expressions_are_one_object(one, other):
    assert one is other


def test_different_expressions_are_different_objects():
    made = [X, Y, C, X + Y, X - Y, X * Y, X / Y, X**2, exp(X), excess(X, 0.5), excess(X, 1.5),
            rate(X), symbol("x", varies=False)]  # fmt: skip
    assert len({id(e) for e in made}) == len(made)


def test_the_root_of_something_negative_times_a_number_is_not_torn_apart():
    """sqrt(-x) is meant for x below zero: it has no factor sqrt(-1)."""
    value = interpreted(sqrt(-2.0 * X), {X: Series([-8.0])})
    assert value.c[0] == 4
    with pytest.raises(ValueError, match=r"there is no \(-2\)\^0.5"):
        power(-2.0, 0.5)


def test_what_varies_is_known():
    assert varies(X * C) and varies(exp(C + X)) and varies(rate(X))
    assert not varies(C / D) and not varies(exp(C)) and not varies(add(2.0))


def test_a_rate_cannot_be_differentiated_by_what_it_is_the_rate_of():
    with pytest.raises(ValueError, match="the rate of .* has no derivative by x"):
        derivative(Y + rate(X * Y), X)
    assert derivative(Y * rate(X), Y) is rate(X)


@pytest.mark.parametrize("exponent", [0.3, 0.0, -1.25])
def test_an_excess_of_another_exponent_is_refused(exponent):
    with pytest.raises(ValueError, match=f"multiple of 1/2 but not 0, got {exponent:g}"):
        excess(X, exponent)
