"""The maker of kernels' values: source code that computes expressions."""

from __future__ import annotations

import linecache
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from tss_ros.core.numerics.expressions import (
    Expression,
    Function,
    Product,
    Sum,
    Symbol,
    as_number,
    multiply,
    power,
    varies,
)

INDENT = "    "


def compiled_source(name: str, source: str, names: Mapping[str, Any]) -> Callable:
    """The function of that name in a piece of made source; tracebacks show its lines."""
    file = f"<made: {name}>"
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)
    space = dict(names)
    exec(compile(source, file, "exec"), space)
    return space[name]


def function_of(
    name: str,
    arguments: str,
    inputs: Mapping[Symbol, str],
    outputs: Iterable[Expression],
    names: Mapping[str, Any],
) -> Callable:
    """A function of values.

    Parameters
    ----------
    name, arguments : str
        Its name and what stands between its parentheses.
    inputs : mapping
        Source of every symbol that occurs.
    outputs : iterable of Expression
        What it returns, as a tuple if there are several.
    names : mapping
        What the source may call: sqrt and exp, of math, numpy or `simd`.

    Returns
    -------
    callable
        Plain Python, to be compiled or used with arrays.
    """
    code = Values(inputs)
    results = [code.value(output) for output in outputs]
    lines = [f"def {name}({arguments}):", *code.lines, f"return {', '.join(results)}"]
    return compiled_source(name, f"\n{INDENT}".join(lines) + "\n", names)


class Values:
    """Lines of source that compute expressions from their parts, each part once.

    Parameters
    ----------
    inputs : mapping
        Source of what is known already, by expression.
    prefix : str
        What the names of its variables begin with.
    """

    def __init__(self, inputs: Mapping[Expression, str], prefix: str = "t"):
        self.known = dict(inputs)
        self.lines: list[str] = []
        self.prefix = prefix

    def name(self, source: str) -> str:
        """A variable that holds the value of this source."""
        variable = f"{self.prefix}{len(self.lines)}"
        self.lines.append(f"{variable} = {source}")
        return variable

    def value(self, expression: Expression) -> str:
        """Source of a value, a variable or a number."""
        number = as_number(expression)
        if number is not None:
            return repr(number)
        if expression not in self.known:
            self.known[expression] = self.name(self._source(expression))
        return self.known[expression]

    def _source(self, expression):
        if isinstance(expression, Sum):
            terms = [times(factor, self.value(term)) for term, factor in expression.terms]
            return joined(([repr(expression.number)] if expression.number else []) + terms)
        if isinstance(expression, Product):
            factors = sorted(expression.factors, key=lambda f: (varies(f[0]), -f[0].serial))
            over = [(base, exponent) for base, exponent in factors if exponent > 0.0]
            under = [(base, -exponent) for base, exponent in factors if exponent < 0.0]
            if not under:
                return self._chain(over, whole=True)
            inverse = multiply(*(power(base, -exponent) for base, exponent in under))
            if inverse not in self.known:
                self.known[inverse] = self.name(f"1.0 / {self._chain(under)}")
            inverse = self.known[inverse]
            return f"{self._chain(over)} * {inverse}" if over else inverse
        if isinstance(expression, Function) and expression.name == "exp":
            return f"exp({self.value(expression.argument)})"
        if isinstance(expression, Function) and expression.name == "excess":
            return self._excess(self.value(expression.argument), expression.exponent)
        raise ValueError(f"nothing is known of {expression}")

    def _chain(self, factors, whole=False):
        """A product of positive powers, so that those that begin alike share their beginnings."""
        pieces = []
        for base, exponent in factors:
            for _ in range(int(exponent)):
                pieces.append(base)
            if exponent != int(exponent):
                pieces.append(power(base, exponent - int(exponent)))
        done = pieces[0]
        for count, piece in enumerate(pieces[1:], 2):
            before = self._piece(done)
            done = multiply(done, piece)
            if done not in self.known:
                source = f"{before} * {self._piece(piece)}"
                if whole and count == len(pieces):
                    return source
                self.known[done] = self.name(source)
        return self._piece(done)

    def _piece(self, expression):
        if expression not in self.known and isinstance(expression, Product):
            (base, exponent), *others = expression.factors
            if not others and 0.0 < exponent < 1.0:
                self.known[expression] = self.name(self._root(base, exponent))
        return self.value(expression)

    def _root(self, base, exponent):
        """A power between 0 and 1, of square roots if they make it: registers have no others."""
        if not of_roots(exponent):
            return f"{self.value(base)} ** {exponent!r}"
        if exponent <= 0.5:
            return f"sqrt({self._piece(power(base, 2.0 * exponent))})"
        return f"{self._piece(power(base, 0.5))} * {self._piece(power(base, exponent - 0.5))}"

    def _excess(self, x, exponent):
        """(1 + x)^(n/2) - 1 as ((1 + x)^n - 1) / ((1 + x)^(n/2) + 1), where nothing cancels."""
        twice = round(abs(2.0 * exponent))
        polynomial = "1.0"
        for i in range(twice - 1, 0, -1):
            polynomial = f"({math.comb(twice, i)}.0 + {x} * {polynomial})"
        base = self.name(f"1.0 + {x}")
        whole = " * ".join([base] * (twice // 2) + [f"sqrt({base})"] * (twice % 2))
        p = self.name(whole)
        under = f"({p} * (1.0 + {p}))" if exponent < 0.0 else f"(1.0 + {p})"
        return f"{'-' if exponent < 0.0 else ''}{x} * {polynomial} / {under}"


def of_roots(exponent: float) -> bool:
    """Whether a few square roots and products make this power."""
    return (64.0 * exponent).is_integer()


def times(factor: float, value: str) -> str:
    """Source of a value times a number."""
    if factor == 1.0:
        return value
    return f"-{value}" if factor == -1.0 else f"{factor!r} * {value}"


def joined(terms: list[str]) -> str:
    """Source of a sum."""
    text = terms[0]
    for term in terms[1:]:
        text += f" - {term[1:]}" if term.startswith("-") else f" + {term}"
    return text
