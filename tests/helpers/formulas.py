"""Formulas at random, and what they are worth in arithmetic of fifty digits.

A formula is a nested tuple, apart from the project's expressions: its value and Taylor series come
from power series multiplied out term by term, with no recurrence.
"""

import operator
from decimal import Decimal, localcontext

from tss_ros.core.numerics import expressions
from tss_ros.core.numerics.expressions import Function, Product, Sum, Symbol

DIGITS = 50
EXPONENTS = (-3.0, -2.5, -1.5, -1.0, -0.5, 0.5, 1.5, 2.0, 2.5, 3.0)
OPERATORS = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
    "**": operator.pow,
}  # fmt: skip
FUNCTIONS = {"exp": expressions.exp, "excess": expressions.excess, "rate": expressions.rate}


class Series:
    """A power series of decimal numbers, cut off; one of a single coefficient is a value."""

    def __init__(self, coefficients):
        self.c = [Decimal(c) for c in coefficients]

    @staticmethod
    def of(value, size):
        return value if isinstance(value, Series) else Series([value] + [0] * (size - 1))

    def __add__(self, other):
        return Series([a + b for a, b in zip(self.c, Series.of(other, len(self.c)).c)])

    def __sub__(self, other):
        return self + Series.of(other, len(self.c)) * -1

    def __rsub__(self, other):
        return self * -1 + other

    def __mul__(self, other):
        with localcontext(prec=DIGITS):
            if not isinstance(other, Series):
                return Series([c * Decimal(other) for c in self.c])
            size = min(len(self.c), len(other.c))
            return Series(
                [sum(self.c[j] * other.c[k - j] for j in range(k + 1)) for k in range(size)]
            )

    def __truediv__(self, other):
        return self * Series.of(other, len(self.c)) ** -1

    def __rtruediv__(self, other):
        return self**-1 * other

    __radd__, __rmul__ = __add__, __mul__

    def __pow__(self, exponent):
        """By multiplication, or the binomial series of 1 + what follows the first coefficient."""
        exponent, result = Decimal(exponent), Series.of(1, len(self.c))
        with localcontext(prec=DIGITS):
            if exponent >= 0 and exponent == int(exponent):
                for _ in range(int(exponent)):
                    result = result * self
                return result
            more, power, weight = self._more(1 / self.c[0]), result, Decimal(1)
            for j in range(1, len(self.c)):
                weight *= (exponent - j + 1) / j
                power = power * more
                result = result + power * weight
            return result * self.c[0] ** exponent

    def exp(self):
        with localcontext(prec=DIGITS):
            more, power = self._more(Decimal(1)), Series.of(1, len(self.c))
            result, factorial = power, Decimal(1)
            for j in range(1, len(self.c)):
                power, factorial = power * more, factorial * j
                result = result + power * (1 / factorial)
            return result * self.c[0].exp()

    def excess(self, exponent):
        with localcontext(prec=DIGITS):
            return (self + 1) ** exponent - 1

    def rate(self):
        with localcontext(prec=DIGITS):
            return Series([(k + 1) * c for k, c in enumerate(self.c[1:])])

    def _more(self, scale):
        return Series([0] + [c * scale for c in self.c[1:]])


EXACT = {"exp": Series.exp, "excess": Series.excess, "rate": Series.rate}


def worth(formula, of, functions):
    """What a formula makes of the things that its symbols stand for."""
    kind, *parts = formula
    if kind == "number":
        return parts[0]
    if kind == "symbol":
        return of[parts[0]]
    values = [worth(p, of, functions) if isinstance(p, tuple) else p for p in parts]
    with localcontext(prec=DIGITS):
        return (OPERATORS.get(kind) or functions[kind])(*values)


def expression_of(formula, symbols):
    """The project's expression of a formula."""
    return worth(formula, symbols, FUNCTIONS)


def exact(formula, series):
    """Its power series, given those of its symbols by name."""
    return worth(formula, series, EXACT)


def interpreted(expression, series):
    """The power series of an expression, by the graph that it is, given those of its symbols."""
    known = dict(series)
    size = min(len(s.c) for s in known.values())

    def value(e):
        if e in known:
            return known[e]
        if isinstance(e, Sum):
            total = Series.of(e.number, size)
            for term, factor in e.terms:
                total = value(term) * factor + total
        elif isinstance(e, Product):
            total = Series.of(1, size)
            for base, exponent in e.factors:
                total = value(base) ** exponent * total
        elif isinstance(e, Function):
            more = (e.exponent,) if e.name == "excess" else ()
            total = EXACT[e.name](value(e.argument), *more)
        else:
            assert isinstance(e, Symbol)
            raise KeyError(e.name)
        known[e] = total
        return total

    with localcontext(prec=DIGITS):
        return value(expression)


def random_formula(rng, points, size, varying, rates=False):
    """A formula of so many operations that is worth 0.05 to 20 at all points.

    Parameters
    ----------
    rng : numpy.random.Generator
    points : list of dict
        Series of at least two coefficients by name of symbol.
    size : int
    varying : list of str
        Names of symbols whose rates may occur.
    rates : bool
        Whether rates do occur.
    """
    names = sorted(points[0])

    def fits(formula):
        values = [exact(formula, point).c[0] for point in points]
        return all(0.05 <= v <= 20 for v in values)

    def polynomial():
        """A polynomial with numbers as coefficients."""
        terms = []
        for _ in range(rng.integers(1, 4)):
            term = ("symbol", str(rng.choice(varying)))
            for _ in range(rng.integers(0, 3)):
                factor = ("symbol", str(rng.choice(varying)))
                if rng.random() < 0.2:
                    factor = ("+", factor, ("number", round(rng.uniform(0.2, 1.0), 2)))
                term = ("*", term, factor)
            if rng.random() < 0.5:
                term = ("*", ("number", round(rng.uniform(-1.0, 1.0), 2) or 0.5), term)
            terms.append(term)
        result = terms[0]
        for term in terms[1:]:
            result = ("+", result, term)
        return result

    def candidate(size):
        kinds = ["+", "-", "*", "/", "+", "*", "**", "**", "excess", "exp", "rate"]
        kind = str(rng.choice(kinds[: None if rates else -1]))
        first = grow(size - 1)
        if kind == "rate":
            part = ("*" if rng.random() < 0.5 else "/", ("rate", polynomial()), first)
            return ("+", part, ("number", round(rng.uniform(0.5, 3.0), 2)))
        if kind in ("**", "excess"):
            exponent = float(rng.choice(EXPONENTS))
            result = (kind, first, exponent)
            return ("-", ("number", 1.25), result) if kind == "excess" and exponent < 0 else result
        if kind == "exp":
            return ("exp", ("*", ("number", round(rng.uniform(-1.0, 1.0), 2) or 0.5), first))
        if rng.random() < 0.25:
            second = ("number", round(rng.uniform(0.2, 3.0), 2))
        else:
            second = grow(int(rng.integers(0, size)))
        return (kind, first, second) if rng.random() < 0.6 else (kind, second, first)

    def grow(size):
        for _ in range(20 if size > 0 else 0):
            formula = candidate(size)
            if fits(formula):
                return formula
        return ("symbol", str(rng.choice(names)))

    return grow(size)
