"""Four numbers side by side in one register, a type for kernels compiled by numba.

Three beads, or three tethers, take little longer this way than one. LLVM vectorises loops only
where many turns of them follow each other; the recurrences of Taylor series have few.
"""

from __future__ import annotations

import hashlib
import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.caching import IndexDataCacheFile
from numba.core.registry import CPUDispatcher
from numba.core.typeconv import Conversion
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import (
    intrinsic,
    lower_builtin,
    lower_cast,
    models,
    overload,
    register_model,
)

from tss_ros.core.fingerprint import KERNELS, NUMERICS, OWN_LAWS, fingerprint


def _compiled(cache=True, python=False, **options):
    """A decorator like `njit`, for functions that Python calls or that only compiled code calls.

    An entrance for Python takes longer to compile than most kernels.
    """
    jit = njit(
        cache=cache, nogil=True, error_model="numpy", no_cfunc_wrapper=True,
        no_cpython_wrapper=not python, **options,
    )  # fmt: skip

    def decorate(function):
        dispatcher = jit(function)
        if cache:
            dispatcher._cache._cache_file = _CacheFile(dispatcher._cache._cache_file, function)
        if not python:
            dispatcher.__class__ = _Inner
        return dispatcher

    return decorate


class _CacheFile(IndexDataCacheFile):
    """A kernel's cache, which holds for as long as nothing that kernels are made of has changed.

    numba itself looks only at the file of the function, not at what is inlined into it. With laws
    of users there are files of their own. The stamp is in the data, too: another process, with
    another version of a law, may replace them as soon as the index has been read.
    """

    def __init__(self, file, function):
        self.__dict__ |= vars(file)
        in_numerics = function.__module__ == __name__ or ".numerics." in function.__module__
        self._packages, self._settled = NUMERICS if in_numerics else KERNELS, False

    def _load_index(self):
        if not self._settled:  # users' laws are known by the first use
            self._source_stamp, self._settled = fingerprint(self._packages), True
            if OWN_LAWS and self._packages == KERNELS:
                names = hashlib.sha256(repr(sorted(OWN_LAWS)).encode()).hexdigest()[:8]
                base = f"{self._index_name.removesuffix('.nbi')}-{names}"
                super().__init__(self._cache_path, base, self._source_stamp)
        return super()._load_index()

    def _save_data(self, name, data):
        super()._save_data(name, (self._source_stamp, data))

    def _load_data(self, name):
        stamp, data = super()._load_data(name)
        if stamp != self._source_stamp:
            raise OSError(f"{name} was replaced")  # which is taken as if there were none
        return data


class _Inner(CPUDispatcher):
    """A compiled function without an entrance for Python."""

    def __call__(self, *_, **__):
        raise TypeError(f"{self.__name__} can be called by compiled code only")


def is_cached(kernel: CPUDispatcher) -> bool:
    """Whether a kernel is compiled, in this process or in the cache for a processor like this."""
    here = kernel.targetctx.codegen().magic_tuple()
    return bool(kernel.overloads) or any(
        key[1] == here for key in kernel._cache._cache_file._load_index()
    )


#: Kernels that allocate nothing, nor do those they call. Counting references to their arrays, which
#: numba does otherwise, takes as long as a short kernel itself.
_NO_ALLOCATION = {"fastmath": {"contract"}, "_nrt": False}
#: Decorates such kernels; and those of them that Python calls, too.
kernel = _compiled(**_NO_ALLOCATION)
python_kernel = _compiled(python=True, **_NO_ALLOCATION)

#: The same for made kernels, which have no file for numba's cache; those that call them have.
uncached = _compiled(cache=False, **_NO_ALLOCATION)

#: Decorates large kernels that LLVM shall not merge with their caller: the loops of either would
#: have too few registers.
separate_kernel = _compiled(forceinline=False, **_NO_ALLOCATION)

#: Decorates kernels without allocation where products are rounded before they are added.
rounded_kernel = _compiled(_nrt=False, fastmath=False)

#: Decorates kernels that allocate; and those of them that Python calls, too. What is not said here
#: would follow from the kernel that calls them first.
allocating = _compiled(_nrt=True)
python_allocating = _compiled(python=True, _nrt=True)
#: The same as `allocating` where products may be added without rounding in between.
allocating_contracted = _compiled(fastmath={"contract"}, _nrt=True)

#: Decorates small pieces of kernels that take whole tuples of arrays: to pass those takes longer
#: than their work.
inlined = njit(inline="always")

#: The same for pieces without such tuples. These are compiled by themselves, which takes less time,
#: and then inlined by LLVM.
leaf = _compiled(cache=False, forceinline=True, **_NO_ALLOCATION)

#: The same for the one large piece that is called once a step.
inlined_by_llvm = _compiled(forceinline=True, **_NO_ALLOCATION)

WIDTH = 4
#: LLVM's type of a register.
VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
_OPERATORS = {
    operator.add: "fadd", operator.sub: "fsub", operator.mul: "fmul", operator.truediv: "fdiv",
    operator.iadd: "fadd", operator.isub: "fsub", operator.imul: "fmul", operator.itruediv: "fdiv",
}  # fmt: skip


class Lanes(types.Type):
    """Numba's type of `WIDTH` doubles in a register; + - * / work lane by lane."""

    def __init__(self):
        super().__init__("Lanes")

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Conversion | None:
        """Numbers become lanes where a variable may be either."""
        return Conversion.safe if other == types.float64 else None

    def unify(self, typingctx: Any, other: types.Type) -> types.Type | None:
        """The type of a variable that may be either."""
        return self if other == types.float64 else None


LANES = Lanes()


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, VECTOR)


def _place(context, builder, kind, array, index):
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), VECTOR.as_pointer())


def spread(builder: ir.IRBuilder, x: ir.Value) -> ir.Value:
    """Instructions that put a number into all lanes."""
    first = ir.Constant(ir.IntType(32), 0)
    vector = builder.insert_element(ir.Constant(VECTOR, ir.Undefined), x, first)
    everywhere = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(vector, vector, everywhere)


@lower_cast(types.float64, Lanes)
def _from_number(context, builder, kind, lanes, x):
    return spread(builder, x)


@intrinsic
def load(_, array, index):
    """The lanes from a flat index on in a contiguous array of doubles."""

    def code(context, builder, sig, args):
        return builder.load(_place(context, builder, sig.args[0], *args), align=8)

    return LANES(array, types.intp), code


@intrinsic
def store(_, array, index, value):
    """Write the lanes from a flat index on into a contiguous array of doubles."""

    def code(context, builder, sig, args):
        builder.store(args[2], _place(context, builder, sig.args[0], *args[:2]), align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, LANES), code


@intrinsic
def number(_, array, index):
    """The number at a flat index of a contiguous array of doubles."""

    def code(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.load(builder.gep(data, [args[1]]))

    return types.float64(array, types.intp), code


@leaf
def load3(array, index):
    """Three lots of lanes that follow each other: x, y and z."""
    return load(array, index), load(array, index + WIDTH), load(array, index + 2 * WIDTH)


@leaf
def store3(array, index, x, y, z):
    """Write three lots of lanes that follow each other."""
    store(array, index, x)
    store(array, index + WIDTH, y)
    store(array, index + 2 * WIDTH, z)


@intrinsic
def lane(_, x, index):
    """The number in one lane."""

    def code(context, builder, sig, args):
        return builder.extract_element(args[0], args[1])

    return types.float64(LANES, types.intp), code


@intrinsic
def side_by_side(_, a, b, c, d):
    """Tuples of numbers as one tuple of lanes."""
    kind = types.UniTuple(LANES, a.count)

    def code(context, builder, sig, args):
        values = []
        for k in range(a.count):
            value = ir.Constant(VECTOR, ir.Undefined)
            for i, one in enumerate(args):
                at = ir.Constant(ir.IntType(32), i)
                value = builder.insert_element(value, builder.extract_value(one, k), at)
            values.append(value)
        return context.make_tuple(builder, kind, values)

    return kind(a, b, c, d), code


def lane_by_lane(function: CPUDispatcher) -> Callable:
    """A kernel (arrays, number), which returns a tuple of numbers, that takes lanes as well."""

    def stands_for(arrays, x):
        raise TypeError("to be called by compiled code only")

    @overload(stands_for, jit_options={"nogil": True, "error_model": "numpy", **_NO_ALLOCATION})
    def choose(arrays, x):
        if not isinstance(x, Lanes):
            return lambda arrays, x: function(arrays, x)
        return lambda arrays, x: side_by_side(
            function(arrays, lane(x, 0)), function(arrays, lane(x, 1)),
            function(arrays, lane(x, 2)), function(arrays, lane(x, 3)),
        )  # fmt: skip

    return stands_for


@intrinsic
def splat(_, x):
    """A number in all lanes."""
    return LANES(types.float64), lambda context, builder, sig, args: spread(builder, args[0])


def _by_llvm(name, count):
    def code(context, builder, sig, args):
        kind = ir.FunctionType(VECTOR, [VECTOR] * count)
        full = f"llvm.{name}.v{WIDTH}f64"
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, full), args)

    return LANES(*[LANES] * count), code


@intrinsic
def worse(_, x, y):
    """The larger one of each two errors, NaN being the worst."""
    return _by_llvm("maximum", 2)


@intrinsic
def worst(_, x):
    """The largest error of all lanes, NaN being the worst."""

    def code(context, builder, sig, args):
        kind = ir.FunctionType(ir.DoubleType(), [VECTOR])
        full = f"llvm.vector.reduce.fmaximum.v{WIDTH}f64"
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, full), args)

    return types.float64(LANES), code


@intrinsic
def fabs(_, x):
    """Absolute values."""
    return _by_llvm("fabs", 1)


@intrinsic
def smaller(_, x, y):
    """The smaller one of each two."""
    return _by_llvm("minnum", 2)


@intrinsic
def larger(_, x, y):
    """The larger one of each two."""
    return _by_llvm("maxnum", 2)


@intrinsic
def only_where(_, mask, x):
    """x where the mask is above 0, and 0 elsewhere, whatever x is there."""

    def code(context, builder, sig, args):
        zero = ir.Constant(VECTOR, [0.0] * WIDTH)
        return builder.select(builder.fcmp_ordered(">", args[0], zero), args[1], zero)

    return LANES(LANES, LANES), code


def _define(function, instruction):
    class Signatures(ConcreteTemplate):
        cases = [
            signature(LANES, *kinds)
            for kinds in ((LANES, LANES), (LANES, types.float64), (types.float64, LANES))
        ]

    def code(context, builder, sig, args):
        args = [x if kind == LANES else spread(builder, x) for kind, x in zip(sig.args, args)]
        return getattr(builder, instruction)(*args)

    infer_global(function)(Signatures)
    for case in Signatures.cases:
        lower_builtin(function, *case.args)(code)


for _function, _instruction in _OPERATORS.items():
    _define(_function, _instruction)


def _define_unary(function, code):
    case = signature(LANES, LANES)
    infer_global(function)(type("Signatures", (ConcreteTemplate,), {"cases": [case]}))
    lower_builtin(function, LANES)(code)


def _lane_by_lane(function):
    case = signature(types.float64, types.float64)

    def code(context, builder, sig, args):
        value, number = ir.Constant(VECTOR, ir.Undefined), context.get_function(function, case)
        for i in range(WIDTH):
            at = ir.Constant(ir.IntType(32), i)
            one = number(builder, [builder.extract_element(args[0], at)])
            value = builder.insert_element(value, one, at)
        return value

    return code


_define_unary(operator.neg, lambda context, builder, sig, args: builder.fneg(args[0]))
_define_unary(math.sqrt, _by_llvm("sqrt", 1)[1])
_define_unary(math.sin, _lane_by_lane(math.sin))
_define_unary(math.cos, _lane_by_lane(math.cos))
_define_unary(math.exp, _lane_by_lane(math.exp))
