"""Arrays of lanes, with which kernels written for numbers work on four systems at once.

Their elements are `simd.Lanes`, or complex numbers of which real and imaginary parts are lanes.
Kernels index such an array like one of numbers; whatever arithmetic they do is done lane by lane.
They must not branch on the elements.
"""

import operator

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import (
    AbstractTemplate,
    AttributeTemplate,
    ConcreteTemplate,
    infer_getattr,
    infer_global,
    signature,
)
from numba.extending import intrinsic, lower_builtin, lower_getattr, models, register_model

from tss_ros.core.numerics.simd import LANES, VECTOR, WIDTH, spread


class ComplexLanes(types.Type):
    """Numba's type of `WIDTH` complex numbers in two registers."""

    def __init__(self):
        super().__init__("ComplexLanes")


COMPLEX_LANES = ComplexLanes()


@register_model(ComplexLanes)
class _ComplexLanesModel(models.StructModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, [("real", LANES), ("imag", LANES)])


class LaneArray(types.Type):
    """Numba's type of an array of lanes, of which only the first axis has any length.

    Parameters
    ----------
    element : Lanes or ComplexLanes
    inner : int
        Number of the other axes, of length three each.
    """

    def __init__(self, element: types.Type, inner: int):
        self.element, self.inner = element, inner
        super().__init__(f"LaneArray({element}, {inner})")


@register_model(LaneArray)
class _LaneArrayModel(models.StructModel):
    def __init__(self, manager, kind):
        members = [("data", types.CPointer(types.float64)), ("size", types.intp)]
        super().__init__(manager, kind, members)


@intrinsic
def in_lanes(_, array, group):
    """The part array[group] of an array (groups, n, 3, W), (groups, n, 3, 2, W) or
    (groups, n, 3, 3, 2, W) as a `LaneArray` of n rows; the axis of length 2 is for complex numbers.
    """
    element = LANES if array.ndim == 4 else COMPLEX_LANES
    result = LaneArray(element, 2 if array.ndim == 6 else 1)

    def code(context, builder, sig, args):
        whole = context.make_array(sig.args[0])(context, builder, args[0])
        size = cgutils.unpack_tuple(builder, whole.shape)[1]
        part = cgutils.create_struct_proxy(result)(context, builder)
        start = builder.mul(args[1], builder.mul(size, _length(context, result)))
        part.data, part.size = builder.gep(whole.data, [start]), size
        return part._getvalue()

    return result(array, types.intp), code


@intrinsic
def complex_lanes(_, real, imag):
    """Complex numbers from lanes of real and of imaginary parts."""

    def code(context, builder, sig, args):
        value = cgutils.create_struct_proxy(COMPLEX_LANES)(context, builder)
        value.real, value.imag = args
        return value._getvalue()

    return COMPLEX_LANES(LANES, LANES), code


def _length(context, kind):
    """Doubles in one row."""
    width = WIDTH * 3**kind.inner * (2 if kind.element == COMPLEX_LANES else 1)
    return context.get_constant(types.intp, width)


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, args, kws):
        if isinstance(args[0], LaneArray):
            return _item(*args)(*args)


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    def generic(self, args, kws):
        if isinstance(args[0], LaneArray):
            return signature(types.none, args[0], args[1], _item(*args[:2]))


def _item(array, index):
    """Type of an element or of a part."""
    given = len(index) if isinstance(index, types.BaseTuple) else 1
    left = array.inner - given
    return array.element if left < 0 else LaneArray(array.element, left)


def _place(context, builder, kinds, args):
    """Where an element or part begins."""
    (kind, index_kind), at = kinds[:2], args[1]
    many = isinstance(index_kind, types.BaseTuple)
    indices = cgutils.unpack_tuple(builder, at) if many else [at]
    index_kinds = list(index_kind) if many else [index_kind]
    place = cgutils.create_struct_proxy(kind)(context, builder, args[0]).data
    for taken, (index, its_kind) in enumerate(zip(indices, index_kinds)):
        index = context.cast(builder, index, its_kind, types.intp)
        row = _length(context, LaneArray(kind.element, kind.inner - taken))
        place = builder.gep(place, [builder.mul(index, row)])
    return place


def _registers(builder, place, count):
    at = builder.bitcast(place, VECTOR.as_pointer())
    return [builder.gep(at, [ir.Constant(ir.IntType(64), i)]) for i in range(count)]


def _get(context, builder, sig, args):
    result, place = sig.return_type, _place(context, builder, sig.args, args)
    if result == LANES:
        return builder.load(*_registers(builder, place, 1), align=8)
    value = cgutils.create_struct_proxy(result)(context, builder)
    if result == COMPLEX_LANES:
        real, imag = _registers(builder, place, 2)
        value.real, value.imag = builder.load(real, align=8), builder.load(imag, align=8)
    else:
        value.data, value.size = place, context.get_constant(types.intp, 3)
    return value._getvalue()


def _set(context, builder, sig, args):
    place, kind = _place(context, builder, sig.args, args), sig.args[2]
    parts = [args[2]] if kind == LANES else _parts(context, builder, kind, args[2])
    for at, part in zip(_registers(builder, place, len(parts)), parts):
        builder.store(part, at, align=8)
    return context.get_dummy_value()


lower_builtin(operator.getitem, LaneArray, types.Any)(_get)
lower_builtin(operator.setitem, LaneArray, types.Any, types.Any)(_set)


@infer_getattr
class _Attributes(AttributeTemplate):
    key = LaneArray

    def resolve_shape(self, kind):
        return types.UniTuple(types.intp, 1)


@lower_getattr(LaneArray, "shape")
def _shape(context, builder, kind, value):
    size = cgutils.create_struct_proxy(kind)(context, builder, value).size
    return context.make_tuple(builder, types.UniTuple(types.intp, 1), [size])


def _parts(context, builder, kind, x):
    """Real and imaginary lanes of a complex number, or a real number in all lanes."""
    if kind != COMPLEX_LANES:
        return [spread(builder, x)]
    value = cgutils.create_struct_proxy(kind)(context, builder, x)
    return [value.real, value.imag]


def _sum(builder, x, y):
    imag = builder.fadd(x[1], y[1]) if len(x) == len(y) else (x + y[1:])[1]
    return builder.fadd(x[0], y[0]), imag


def _difference(builder, x, y):
    return _sum(builder, x, [builder.fneg(part) for part in y])


def _product(builder, x, y):
    if len(x) < len(y):
        x, y = y, x
    real, imag = builder.fmul(x[0], y[0]), builder.fmul(x[1], y[0])
    if len(y) > 1:
        real = builder.fsub(real, builder.fmul(x[1], y[1]))
        imag = builder.fadd(imag, builder.fmul(x[0], y[1]))
    return real, imag


def _quotient(builder, x, y):
    """A real number over a complex one."""
    square = builder.fadd(builder.fmul(y[0], y[0]), builder.fmul(y[1], y[1]))
    share = builder.fdiv(x[0], square)
    return builder.fmul(share, y[0]), builder.fneg(builder.fmul(share, y[1]))


def _define(rule, kinds, *functions):
    class Signatures(ConcreteTemplate):
        cases = [signature(COMPLEX_LANES, *pair) for pair in kinds]

    def code(context, builder, sig, args):
        x, y = (_parts(context, builder, *each) for each in zip(sig.args, args))
        value = cgutils.create_struct_proxy(COMPLEX_LANES)(context, builder)
        value.real, value.imag = rule(builder, x, y)
        return value._getvalue()

    for function in functions:
        infer_global(function)(Signatures)
        for pair in kinds:
            lower_builtin(function, *pair)(code)


_BOTH, _LEFT = (COMPLEX_LANES, COMPLEX_LANES), (COMPLEX_LANES, types.float64)
_RIGHT = (types.float64, COMPLEX_LANES)
_define(_sum, (_BOTH, _LEFT, _RIGHT), operator.add, operator.iadd)
_define(_difference, (_BOTH, _LEFT), operator.sub, operator.isub)
_define(_product, (_BOTH, _LEFT, _RIGHT), operator.mul, operator.imul)
_define(_quotient, (_RIGHT,), operator.truediv)
