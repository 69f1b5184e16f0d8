"""Expressions: formulas as graphs, with their derivatives.

A formula is written once with + - * / and powers. `value_maker` and `series_maker` turn it, and
what is derived from it here, into compiled code. Equal expressions are the same object, and so are
simple ones of the same value (x x and x^2, a/b/b and a/b^2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import count
from typing import Any

_serials = count()


@dataclass(frozen=True, eq=False)
class Expression:
    """A formula; the operators + - * / ** make larger ones. Equal ones are the same object."""

    serial: int = field(default_factory=_serials.__next__, init=False, repr=False)

    def __add__(self, other):
        return add(self, other)

    def __sub__(self, other):
        return add(self, multiply(-1.0, other))

    def __mul__(self, other):
        return multiply(self, other)

    def __truediv__(self, other):
        return multiply(self, power(other, -1.0))

    def __pow__(self, exponent):
        return power(self, exponent)

    def __neg__(self):
        return multiply(-1.0, self)

    def __bool__(self):
        raise TypeError("a formula is neither true nor false: it holds for all values at once")

    __radd__ = __add__
    __rmul__ = __mul__

    def __rsub__(self, other):
        return add(other, multiply(-1.0, self))

    def __rtruediv__(self, other):
        return multiply(other, power(self, -1.0))


@dataclass(frozen=True, eq=False)
class Symbol(Expression):
    """A quantity with a name; `varies` says whether it changes with time."""

    name: str
    varies: bool


@dataclass(frozen=True, eq=False)
class Sum(Expression):
    """A number plus terms, each times a number."""

    number: float
    terms: tuple[tuple[Expression, float], ...]


@dataclass(frozen=True, eq=False)
class Product(Expression):
    """Factors, each to the power of a number."""

    factors: tuple[tuple[Expression, float], ...]


@dataclass(frozen=True, eq=False)
class Function(Expression):
    """What no product or sum is: of one argument, `name` one of exp, rate, excess.

    rate is the derivative by time. excess is (1 + x)^exponent - 1, without cancellation for small
    x; its exponent is a multiple of one half.
    """

    name: str
    argument: Expression
    exponent: float


@cache
def _only(kind, *fields):
    """The one expression of a kind with these fields."""
    return kind(*fields)


def symbol(name: str, varies: bool = True) -> Symbol:
    """A quantity with a name; `varies` says whether it changes with time."""
    return _only(Symbol, name, varies)


def _ordered(pairs):
    kept = [(e, number) for e, number in pairs.items() if number != 0.0]
    return tuple(sorted(kept, key=lambda pair: pair[0].serial))


def _parts(value):
    """Number and terms of a value, as a sum."""
    if isinstance(value, Sum):
        return value.number, value.terms
    if isinstance(value, Expression):
        return 0.0, ((value, 1.0),)
    return float(value), ()


def _sum(number, terms):
    terms = _ordered(terms)
    if number == 0.0 and len(terms) == 1 and terms[0][1] == 1.0:
        return terms[0][0]
    return _only(Sum, number, terms)


def add(*values: Any) -> Expression:
    """The sum of expressions and numbers."""
    number, terms = 0.0, {}
    for value in values:
        more, others = _parts(value)
        number += more
        for term, factor in others:
            terms[term] = terms.get(term, 0.0) + factor
    return _sum(number, terms)


def as_number(value: Any) -> float | None:
    """The number that an expression is, None if it is none."""
    number, terms = _parts(value)
    return None if terms else number


def multiply(*values: Any) -> Expression:
    """The product of expressions and numbers."""
    number, factors = 1.0, {}
    for value in values:
        more, terms = _parts(value)
        if not terms:
            number *= more
            continue
        if more == 0.0 and len(terms) == 1:
            value, more = terms[0]
            number *= more
        for base, exponent in value.factors if isinstance(value, Product) else ((value, 1.0),):
            factors[base] = factors.get(base, 0.0) + exponent
    factors = _ordered(factors)
    if not factors or number == 0.0:
        return _sum(number, {})
    one = len(factors) == 1 and factors[0][1] == 1.0
    product = factors[0][0] if one else _only(Product, factors)
    if isinstance(product, Sum):
        return _sum(product.number * number, {t: f * number for t, f in product.terms})
    return _sum(0.0, {product: number})


def power(value: Any, exponent: float) -> Expression:
    """A power with a number as exponent; (x^a)^b is taken for x^(a b), as for positive x."""
    number, terms = _parts(value)
    whole = float(exponent).is_integer()
    if not terms:
        if number < 0.0 and not whole:
            raise ValueError(f"there is no ({number:g})^{exponent:g}")
        return _sum(number**exponent, {})
    if number == 0.0 and len(terms) == 1 and (whole or terms[0][1] > 0.0):
        base, factor = terms[0]
        if factor != 1.0:
            return multiply(factor**exponent, power(base, exponent))
        if isinstance(base, Product):
            return multiply(*(power(b, e * exponent) for b, e in base.factors))
    return multiply(_only(Product, ((value, float(exponent)),)))


def sqrt(value: Any) -> Expression:
    """Square root."""
    return power(value, 0.5)


def exp(value: Any) -> Expression:
    """Exponential function."""
    return _only(Function, "exp", add(value), 0.0)


def excess(value: Any, exponent: float) -> Expression:
    """(1 + x)^exponent - 1 without cancellation."""
    if not float(2.0 * exponent).is_integer() or exponent == 0.0:
        raise ValueError(f"exponent must be a multiple of 1/2 but not 0, got {exponent:g}")
    return _only(Function, "excess", add(value), float(exponent))


def rate(value: Any) -> Expression:
    """Derivative by time; 0 of what does not vary."""
    value = add(value)
    return _only(Function, "rate", value, 0.0) if varies(value) else add(0.0)


def dot(a: tuple, b: tuple) -> Expression:
    """Scalar product."""
    return add(*(multiply(x, y) for x, y in zip(a, b)))


def cross(a: tuple, b: tuple) -> tuple[Expression, Expression, Expression]:
    """Vector product."""
    return tuple(
        add(multiply(a[i], b[j]), multiply(-1.0, a[j], b[i])) for i, j in ((1, 2), (2, 0), (0, 1))
    )


def parts(expression: Expression) -> tuple[Expression, ...]:
    """What an expression is made of directly."""
    if isinstance(expression, Sum):
        return tuple(term for term, _ in expression.terms)
    if isinstance(expression, Product):
        return tuple(base for base, _ in expression.factors)
    return (expression.argument,) if isinstance(expression, Function) else ()


@cache
def varies(expression: Expression) -> bool:
    """Whether an expression changes with time."""
    if isinstance(expression, Symbol):
        return expression.varies
    return any(varies(part) for part in parts(expression))


def symbols(*expressions: Expression) -> set[Symbol]:
    """All symbols in some expressions."""
    found, left = set(), list(expressions)
    seen = set()
    while left:
        expression = left.pop()
        if expression in seen:
            continue
        seen.add(expression)
        if isinstance(expression, Symbol):
            found.add(expression)
        left.extend(parts(expression))
    return found


@cache
def derivative(expression: Expression, by: Symbol) -> Expression:
    """Partial derivative; of rate() it is refused, since a rate is a quantity of its own.

    Raises
    ------
    ValueError
        For a rate of something that contains the symbol.
    """
    if expression == by:
        return add(1.0)
    if isinstance(expression, Sum):
        return add(*(multiply(f, derivative(t, by)) for t, f in expression.terms))
    if isinstance(expression, Product):
        return add(*(
            multiply(e, expression, power(b, -1.0), derivative(b, by))
            for b, e in expression.factors if by in symbols(b)
        ))  # fmt: skip
    if not isinstance(expression, Function) or by not in symbols(expression.argument):
        return add(0.0)
    inner = derivative(expression.argument, by)
    if expression.name == "exp":
        return multiply(expression, inner)
    if expression.name == "excess":
        over = power(add(1.0, expression.argument), -1.0)
        return multiply(expression.exponent, add(1.0, expression), over, inner)
    raise ValueError(f"the rate of {expression.argument} has no derivative by {by.name}")


def substitute(expression: Expression, values: Mapping[Symbol, Any]) -> Expression:
    """The expression with symbols replaced by expressions or numbers."""
    known: dict[Expression, Any] = dict(values)

    def replaced(e):
        if e not in known:
            if isinstance(e, Sum):
                known[e] = add(e.number, *(multiply(f, replaced(t)) for t, f in e.terms))
            elif isinstance(e, Product):
                known[e] = multiply(*(power(replaced(b), x) for b, x in e.factors))
            elif isinstance(e, Function):
                inner = replaced(e.argument)
                kind = {"exp": exp, "rate": rate}.get(e.name)
                known[e] = kind(inner) if kind else excess(inner, e.exponent)
            else:
                known[e] = e
        return known[e]

    return add(replaced(expression))


def distributed(expression: Expression) -> Expression:
    """The expression with products of sums written as sums of products, so that terms cancel."""
    if isinstance(expression, Sum):
        return add(expression.number, *(multiply(f, distributed(t)) for t, f in expression.terms))
    if not isinstance(expression, Product):
        return expression
    terms = [add(1.0)]
    for base, exponent in expression.factors:
        base = distributed(base)
        if not (isinstance(base, Sum) and exponent == int(exponent) and 0 < exponent < 4):
            terms = [multiply(term, power(base, exponent)) for term in terms]
            continue
        for _ in range(int(exponent)):
            terms = [
                multiply(term, more)
                for term in terms
                for more in (base.number, *(multiply(f, t) for t, f in base.terms))
            ]
    return add(*terms)
