"""The maker of kernels' Taylor series: source code of one order, from expressions.

Series follow from recurrences of the coefficients (A. Jorba and M. Zou, "A software package for the
numerical integration of ODEs by means of high-order Taylor methods", Exp. Math. 14 (2005) 99-117),
one for each product, quotient, power and function. All sums of one order share a single loop.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from tss_ros.core.numerics.expressions import Expression, Sum, multiply, varies
from tss_ros.core.numerics.series_graph import SeriesGraph
from tss_ros.core.numerics.simd import WIDTH
from tss_ros.core.numerics.value_maker import INDENT, Values, compiled_source, joined, times


class SeriesProgram(SeriesGraph):
    """Source of one order of the Taylor series of expressions, in lanes.

    Parameters
    ----------
    inputs : mapping
        For every varying symbol the source of its coefficient, with `{}` for the order.
    constants : mapping
        Source of every constant symbol.
    outputs : mapping
        Expressions by name.
    kept : iterable of Expression
        Those with a place of their own: given the first slots, in this order.
    starts : mapping
        For some of the expressions another form of the same value, used for order 0, where it
        cancels less.

    The coefficients that later ones need lie in an array `room`, from `at` on: order by order, slot
    by slot, each a register wide.
    """

    first, stride = 0, None

    def lie(self, first: int, stride: int) -> None:
        """Say where the first slot is among so many of each order; its own ones if never said."""
        self.first, self.stride = first, stride

    def at(self, slot: int, order: str) -> str:
        """Source that loads a coefficient."""
        return f"load(room, {self._place(slot, order)})"

    def _place(self, slot, order):
        stride = len(self.slots) if self.stride is None else self.stride
        return f"at + {stride * WIDTH} * ({order}) + {(self.first + slot) * WIDTH}"

    def _coefficient(self, expression, order):
        """Source of an earlier coefficient of an operand."""
        expression = self._alias(expression)
        if expression in self.inputs:
            return self.inputs[expression].format(order)
        return self.at(self.slots[expression], order)

    def function(self, name: str, arguments: str, names: Mapping[str, Any]) -> Callable:
        """The function of one order k: fills slots and returns the outputs' coefficients.

        Parameters
        ----------
        name, arguments : str
        names : mapping
            What the source may call: load, store, splat, sqrt, exp and WIDTH of `simd`.
        """
        start, later = self._start(), self._later()
        body = [*self.constants.lines, "if k == 0:", *(INDENT + line for line in start), "else:"]
        body += [INDENT + line for line in later]
        body.append(f"return {', '.join(f'out_{name}' for name in self.outputs)}")
        lines = [f"def {name}({arguments}):", *body]
        return compiled_source(name, f"\n{INDENT}".join(lines) + "\n", names)

    def _keep(self, lines, expression, order, value):
        if expression in self.slots:
            place = self._place(self.slots[expression], order)
            lines.append(f"store(room, {place}, {value})")

    def _start(self):
        """Lines for order 0, and order 1 of what is known one order ahead."""
        code = Values(self.constants.known, "v")
        known = {}
        for symbol, source in self.inputs.items():
            code.known[symbol] = known[symbol, 0] = code.name(source.format("0"))
        for expression, (kind, *operands) in self.nodes.items():
            if kind == "rate":
                code.known[expression] = code.name(self._first(code, known, operands[0]))
            value = code.value(self.starts.get(expression, expression))
            code.known[expression] = value
            self._keep(code.lines, expression, "0", value)
        for expression in self.ahead:
            self._keep(code.lines, expression, "1", self._first(code, known, expression))
        for name, expression in self.outputs.items():
            value = code.value(expression)
            code.lines.append(f"out_{name} = {value if varies(expression) else f'splat({value})'}")
        return code.lines

    def _first(self, code, known, expression):
        """Source of the first coefficient of an expression."""
        if (expression, 1) in known:
            return known[expression, 1]
        if expression in self.inputs:
            source = self.inputs[expression].format("1")
        else:
            kind, *operands = self.nodes[expression]
            if kind == "sum":
                source = joined([
                    times(factor, self._first(code, known, term))
                    for term, factor in expression.terms if varies(term)
                ])  # fmt: skip
            elif kind == "product" and operands[0] is operands[1]:
                one = self._first(code, known, operands[0])
                source = f"2.0 * ({code.value(operands[0])} * {one})"
            elif kind == "product":
                ones = [self._first(code, known, operand) for operand in operands]
                zeros = [code.value(operand) for operand in operands]
                source = f"{zeros[0]} * {ones[1]} + {ones[0]} * {zeros[1]}"
            else:
                raise ValueError(f"the rate of a {kind} is not made")
        known[expression, 1] = code.name(source)
        return known[expression, 1]

    def _later(self):
        """Lines for an order k from 1 on: one loop over earlier orders, then what is left."""
        self.loop: dict[str, str] = {}
        self.lines, self.sums, self.weights = [], [], {}
        self.tail, self.now, self.zeros, self.inverses = [], {}, {}, {}
        self.counter, self.within = 0, self._products_within()
        for expression in self.nodes:
            self._advance(expression)
        for name, expression in self.outputs.items():
            self.tail.append(f"out_{name} = {self._now(expression)}")
        lines = [f"s{i} = splat(0.0)" for i in range(len(self.sums))]
        lines += [f"{name} = splat({begin})" for name, begin, _ in self.weights.values()]
        body = [f"{name} = {source}" for source, name in self.loop.items()]
        body += [f"s{i} += {' + '.join(terms)}" for i, terms in enumerate(self.sums)]
        body += [f"{name} += {more!r}" for name, _, more in self.weights.values()]
        if self.sums:
            lines += ["for b in range(1, k):", *(INDENT + line for line in body)]
        return lines + self.tail

    def _named(self, source, prefix="n"):
        self.counter += 1
        self.tail.append(f"{prefix}{self.counter} = {source}")
        return f"{prefix}{self.counter}"

    def _order(self, expression):
        return "k + 1" if expression in self.ahead else "k"

    def _loaded(self, expression, order):
        """Name, within the loop, of a coefficient of order b or of what b leaves of another."""
        return self.loop.setdefault(self._coefficient(expression, order), f"b{len(self.loop)}")

    def _sum(self, *sources):
        self.sums.append(sources)
        return f"s{len(self.sums) - 1}"

    def _weight(self, by_b, by_k):
        """Name, within the loop, of by_b b + by_k k."""
        begin = f"{by_b!r} + {by_k!r} * k"
        return self.weights.setdefault(begin, (f"w{len(self.weights)}", begin, by_b))[0]

    def _zero(self, expression):
        """Name of the coefficient of order 0."""
        if expression not in self.zeros:
            if isinstance(expression, Sum) and self._alias(expression) is not expression:
                terms = [
                    self._zero(t) if varies(t) else times(f, self.constants.value(t))
                    for t, f in expression.terms
                ]  # fmt: skip
                source = joined(terms + ([repr(expression.number)] if expression.number else []))
            else:
                source = self._coefficient(expression, "0")
            self.zeros[expression] = self._named(source, "z")
        return self.zeros[expression]

    def _inverse(self, source):
        if source not in self.inverses:
            self.inverses[source] = self._named(f"1.0 / {source}", "i")
        return self.inverses[source]

    def _now(self, expression, order="k"):
        """Name of a coefficient of the order being computed."""
        if (expression, order) not in self.now:
            if not varies(expression):
                return "splat(0.0)"
            if expression in self.inputs:
                self.now[expression, order] = self._named(self._coefficient(expression, order))
            elif order == "k" and expression in self.ahead:
                return self._coefficient(expression, order)
            else:
                raise ValueError(f"coefficient {order} of {expression} is not known")
        return self.now[expression, order]

    def _advance(self, expression):
        """Compute one coefficient of one node, keep it, and note its share of the loop."""
        kind, *operands = self.nodes[expression]
        order = self._order(expression)
        if expression in self.within:
            return
        if kind == "sum":
            source = self._sum_now(expression, order)
        elif kind == "scaled":
            constant = self.constants.value(operands[0])
            source = f"{constant} * {self._now(operands[1], order)}"
        elif kind == "rate":
            source = f"(k + 1.0) * {self._now(operands[0], 'k + 1')}"
        elif kind == "product":
            source = self._products_now([operands], order)
        else:
            source = self._recurrence(expression, kind, operands)
        name = self.now[expression, order] = self._named(source)
        self._keep(self.tail, expression, order, name)

    def _products_within(self):
        """Products that only one sum needs, which then adds them up itself, like scalar products.

        Returns a set of them; they must have the factor 1 there and no slot.
        """
        users: dict[Expression, list] = {}
        for expression, (kind, *operands) in self.nodes.items():
            inner = expression.terms if kind == "sum" else [(o, 0.0) for o in operands]
            for term, factor in inner:
                users.setdefault(term, []).append(factor)
        outputs = set(self.outputs.values()) | set(self.slots)
        return {
            e for e, (kind, *_) in self.nodes.items()
            if kind == "product" and users.get(e) == [1.0] and e not in outputs
        }  # fmt: skip

    def _sum_now(self, expression, order):
        inner = [term for term, _ in expression.terms if term in self.within]
        others = [(t, f) for t, f in expression.terms if varies(t) and t not in self.within]
        others.sort(key=lambda term: term[0] in self.late)
        sources = [self._share_now(term, factor, order) for term, factor in others]
        if inner:
            sources.insert(0, self._products_now([self.nodes[t][1:] for t in inner], order))
        return joined(sources)

    def _share_now(self, term, factor, order):
        """Source of a term of a sum: numbers and constants are multiplied once."""
        kind, *operands = self.nodes.get(term, ("",))
        if kind != "scaled":
            return times(factor, self._now(term, order))
        constant = self.constants.value(multiply(factor, operands[0]))
        return f"{constant} * {self._now(operands[1], order)}"

    def _products_now(self, pairs, order):
        """Coefficient of a sum of products; what is known last is added last."""
        early, late = [self._sum(*(self._pair(x, y, order) for x, y in pairs))], []
        for x, y in pairs:
            if order == "k + 1":
                early.append(f"{self._coefficient(x, 'k')} * {self._coefficient(y, '1')}")
            for one, other, twice in ((x, y, x is y), (y, x, False)):
                zero = self._zero(one)
                zero = self._named(f"2.0 * {zero}") if twice else zero
                new = late if self._alias(other) in self.late or order == "k + 1" else early
                new.append(f"{zero} * {self._now_of(other, order)}")
                if x is y:
                    break
        return joined(early + late)

    def _pair(self, x, y, order):
        """What a product adds within the loop: the way round for which more is loaded already."""
        ways = [(x, y)] if order == "k + 1" else [(x, y), (y, x)]
        orders = "b", f"{order} - b"
        missing = [
            sum(self._coefficient(e, o) not in self.loop for e, o in zip(way, orders))
            for way in ways
        ]
        x, y = ways[missing.index(min(missing))]
        return f"{self._loaded(x, 'b')} * {self._loaded(y, f'{order} - b')}"

    def _now_of(self, expression, order):
        return self._now(self._alias(expression), order)

    def _recurrence(self, expression, kind, operands):
        if expression in self.ahead:
            raise ValueError(f"the rate of a {kind} is not made")
        base = operands[1] if kind == "quotient" else operands[0]
        x, z = self._loaded(base, "b"), self._loaded(expression, "k - b")
        if kind == "quotient":
            total = self._sum(f"{x} * {z}")
            over, under = operands[0], self._now_of(base, "k")
            inverse = factor = self._inverse(self._zero(base))
            known = self._named(f"({total} + {under} * {self._zero(expression)}) * {inverse}")
            if self.nodes.get(over, ("",))[0] == "rate":
                factor, over = self._named(f"(k + 1.0) * {inverse}"), self.nodes[over][1]
            order = "k + 1" if factor != inverse else "k"
            return f"{self._now(over, order)} * {factor} - {known}"
        under = self._now_of(base, "k")
        share = self._weight_of_order()
        if kind == "exp":
            total = self._sum(f"{self._weight(1.0, 0.0)} * ({x} * {z})")
            return f"{total} * {share} + {under} * {self._zero(expression)}"
        exponent = operands[1] if kind == "power" else expression.exponent
        weight = self._weight(exponent + 1.0, -1.0)
        total = self._sum(f"{weight} * ({x} * {z})")
        zero, first = self._zero(expression), self._zero(base)
        if kind == "excess":
            zero, first = f"(1.0 + {zero})", f"(1.0 + {first})"
        inverse = self._inverse(first)
        return f"({total} * {share} + {exponent!r} * ({under} * {zero})) * {inverse}"

    def _weight_of_order(self):
        if "1 / k" not in self.inverses:
            self.inverses["1 / k"] = self._named("1.0 / k", "i")
        return self.inverses["1 / k"]
