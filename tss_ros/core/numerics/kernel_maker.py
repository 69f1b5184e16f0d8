"""The maker of kernels: source code of values and of Taylor series, from expressions.

Series follow from recurrences of the coefficients (A. Jorba and M. Zou, "A software package for the
numerical integration of ODEs by means of high-order Taylor methods", Exp. Math. 14 (2005) 99-117),
one for each product, quotient, power and function. All sums of one order share a single loop.
"""

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
    parts,
    power,
    varies,
)
from tss_ros.core.numerics.simd import WIDTH

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
            terms = [_times(factor, self.value(term)) for term, factor in expression.terms]
            return _joined(([repr(expression.number)] if expression.number else []) + terms)
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
        if not _of_roots(exponent):
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


def _of_roots(exponent):
    """Whether a few square roots and products make this power."""
    return (64.0 * exponent).is_integer()


def _times(factor, value):
    if factor == 1.0:
        return value
    return f"-{value}" if factor == -1.0 else f"{factor!r} * {value}"


def _joined(terms):
    text = terms[0]
    for term in terms[1:]:
        text += f" - {term[1:]}" if term.startswith("-") else f" + {term}"
    return text


class SeriesProgram:
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

    def __init__(self, inputs, constants, outputs, kept=(), starts=None):
        self.inputs, self.outputs = inputs, outputs
        self.starts = starts or {}
        self.first, self.stride, self.slots = 0, None, {}
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

    # -- the graph ---------------------------------------------------------------------------

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
            if varies(base) and not _of_roots(exponent):
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

    # -- the source --------------------------------------------------------------------------

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
                source = _joined([
                    _times(factor, self._first(code, known, term))
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
                    self._zero(t) if varies(t) else _times(f, self.constants.value(t))
                    for t, f in expression.terms
                ]  # fmt: skip
                source = _joined(terms + ([repr(expression.number)] if expression.number else []))
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
        return _joined(sources)

    def _share_now(self, term, factor, order):
        """Source of a term of a sum: numbers and constants are multiplied once."""
        kind, *operands = self.nodes.get(term, ("",))
        if kind != "scaled":
            return _times(factor, self._now(term, order))
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
        return _joined(early + late)

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
