"""The graph of operations that a Taylor series is made by, and what of it has to be remembered."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from tss_ros.core.numerics.expressions import (
    Expression,
    Function,
    Product,
    Sum,
    Symbol,
    multiply,
    parts,
    power,
    varies,
)
from tss_ros.core.numerics.value_maker import Values, of_roots


class SeriesGraph:
    """Operations in the order in which they are done, each on two operands or one.

    Parameters and attributes are those of `series_maker.SeriesProgram`.
    """

    def __init__(
        self,
        inputs: Mapping[Expression, str],
        constants: Mapping[Symbol, str],
        outputs: Mapping[str, Expression],
        kept: Iterable[Expression] = (),
        starts: Mapping[Expression, Expression] | None = None,
    ):
        self.inputs, self.outputs = inputs, outputs
        self.starts = starts or {}
        self.slots: dict[Expression, int] = {}
        self.constants = Values(constants, "c")
        self.nodes: dict[Expression, tuple] = {}
        for expression in kept:
            self._stored(expression)
        for expression in kept:
            self._node(expression)
        for output in outputs.values():
            self._node(output)
        self.ahead = set()
        for kind, *operands in list(self.nodes.values()):
            if kind == "rate":
                self._mark_ahead(operands[0])
        for expression in self._used_behind():
            self._stored(expression)
        #: What depends on coefficients known one order ahead, the last to be known.
        self.late = set(self.ahead)
        for expression in self.nodes:
            if self.late & {*parts(expression), *self.nodes[expression][1:]}:
                self.late.add(expression)

    def _node(self, expression):
        """Take an expression, and what it is made of, into the graph."""
        if not varies(expression) or expression in self.nodes or expression in self.inputs:
            return expression
        if isinstance(expression, Sum):
            for term, _ in expression.terms:
                self._node(term)
            entry = ("sum",)
        elif isinstance(expression, Function):
            operand = self._node(expression.argument)
            entry = (expression.name, operand)
            if expression.name != "rate":
                self._history(operand)
                self._history(expression)
        elif isinstance(expression, Product):
            entry = self._product(expression)
        else:
            raise ValueError(f"nothing is known of {expression}")
        self.nodes[expression] = entry
        return expression

    def _product(self, expression):
        for base, exponent in expression.factors:
            if varies(base) and not of_roots(exponent):
                raise ValueError(
                    f"series have powers made of square roots, got exponent {exponent:g} of {base}"
                )
        constant = [(b, e) for b, e in expression.factors if not varies(b)]
        if constant:
            rest = multiply(*(power(b, e) for b, e in expression.factors if varies(b)))
            return "scaled", multiply(*(power(b, e) for b, e in constant)), self._node(rest)
        # What is made of much comes first: more products begin with it than end with it.
        factors = sorted(expression.factors, key=lambda f: -f[0].serial)
        if len(factors) == 1 and (factors[0][1] != int(factors[0][1]) or factors[0][1] < 0.0):
            base = self._node(factors[0][0])
            self._history(base)
            self._history(expression)
            return "power", base, factors[0][1]
        pieces, under = [], []
        for base, exponent in factors:
            whole = int(exponent) if exponent > 0.0 else 0
            pieces += [base] * whole
            if exponent == -1.0:
                under.append(base)
            elif exponent != whole:
                pieces.append(power(base, exponent - whole))
        if under and len(pieces) == len(under) == 1:
            over, base = self._node(pieces[0]), self._node(under[0])
            self._history(base)
            self._history(expression)
            return "quotient", over, base
        for i, base in enumerate(under):
            if i < len(pieces):
                pieces[i] = multiply(pieces[i], power(base, -1.0))
            else:
                pieces.append(power(base, -1.0))
        last = self._node(pieces[-1])
        first = self._node(multiply(*pieces[:-1]))
        self._history(first)
        self._history(last)
        return "product", first, last

    def _alias(self, expression):
        """Of coefficients from the first order on, where they are those of something else."""
        while isinstance(expression, Sum) and expression not in self.slots:
            (term, factor), *others = [(t, f) for t, f in expression.terms if varies(t)]
            if others or factor != 1.0:
                break
            expression = term
        return expression

    def _history(self, expression):
        expression = self._alias(expression)
        if expression not in self.inputs:
            self._stored(expression)

    def _stored(self, expression):
        self.slots.setdefault(expression, len(self.slots))

    def _mark_ahead(self, expression):
        if expression in self.ahead or not varies(expression) or expression in self.inputs:
            return
        self.ahead.add(expression)
        for part in parts(expression):
            self._mark_ahead(part)
        for operand in self.nodes.get(expression, ())[1:]:
            if isinstance(operand, Expression):
                self._mark_ahead(operand)

    def _used_behind(self):
        """What is known one order ahead and used, too, by what is not: it must be remembered."""
        used = set(self.outputs.values())
        for expression, (kind, *operands) in self.nodes.items():
            if expression not in self.ahead and kind != "rate":
                used.update(parts(expression) if kind == "sum" else operands)
        return [expression for expression in self.nodes if expression in self.ahead & used]
