"""Kernels made of the laws: values, Jacobians and Taylor series, for tethers and for beads.

Every function here is a piece to be inlined into the kernels of `forces`, `taylor_motion` and
`taylor_variations`; which law acts is looked up in `KernelArrays` while they run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from tss_ros.core.model.laws import BEAD_LAWS, LAW_PARAMETERS, TETHER_LAWS
from tss_ros.core.model.stated import (
    MEAN_MOTION,
    RADIUS,
    RATE,
    SKY,
    STRETCHED,
    TURNING,
    UP,
    R,
    V,
    acceleration_in_sky,
    acceleration_of,
    energy_of,
    tension_of,
)
from tss_ros.core.numerics import simd
from tss_ros.core.numerics.expressions import (
    add,
    as_number,
    derivative,
    distributed,
    dot,
    rate,
    sqrt,
    substitute,
    symbol,
)
from tss_ros.core.numerics.series_maker import SeriesProgram
from tss_ros.core.numerics.simd import WIDTH
from tss_ros.core.numerics.value_maker import INDENT, compiled_source, function_of

#: What the source of numbers may call.
SCALARS = {"sqrt": math.sqrt, "exp": math.exp}
_ARRAYS = {"sqrt": np.sqrt, "exp": np.exp}
_LANES = {**SCALARS, "load": simd.load, "store": simd.store, "splat": simd.splat}

#: Sources of the parameters of laws, in the kernels.
CONSTANT_SOURCES = {
    symbol(p.name, varies=False): f"arrays.constants[{i}]" for i, p in enumerate(LAW_PARAMETERS)
}
_ORBIT = {
    RADIUS: "arrays.radius", MEAN_MOTION: "arrays.mean_motion", RATE: "arrays.rate",
    **CONSTANT_SOURCES,
}  # fmt: skip


# -- functions of values ---------------------------------------------------------------------------


def _choice(name, arguments, pieces, condition, names):
    """A function that does what the law in force says, by the source of each law's statement."""
    lines = [f"def {name}({arguments}):"]
    for i, piece in enumerate(pieces):
        last = i == len(pieces) - 1
        test = "else:" if last and i else f"{'elif' if i else 'if'} {condition.format(i)}:"
        lines += [INDENT + test, *(2 * INDENT + line for line in piece)]
    return compiled_source(name, "\n".join([*lines, INDENT + "return result"]) + "\n", names)


def sum_of_laws(
    name: str, laws: Sequence, outputs: Sequence, seen: tuple[str, Mapping], acting: str
) -> Callable:
    """A function of the sums over the laws that act of each one's expressions.

    Parameters
    ----------
    name : str
    laws : sequence of laws
    outputs : sequence of sequence of Expression
        As many of each law; where they are 0 for all of them, so is the sum.
    seen : tuple
        The function's arguments, as source, and what the symbols are in it.
    acting : str
        Source of which of the laws act, one bit each.
    """
    arguments, inputs = seen
    sums = [f"s{k}" for k in range(len(outputs[0]))]
    functions, lines = {}, [f"def {name}({arguments}):", f"{INDENT}{' = '.join(sums)} = 0.0"]
    for i, (law, expressions) in enumerate(zip(laws, outputs)):
        own = f"{name}_{law.name}"
        there = {s: e for s, e in zip(sums, expressions) if as_number(e) != 0.0}
        if not there:
            continue
        made = function_of(own, arguments, inputs, there.values(), SCALARS)
        functions[own] = simd.inlined(made)
        lines.append(f"{INDENT}if {acting} & {1 << i}:")
        lines.append(f"{2 * INDENT}d = {own}({arguments})")
        value = "d[{}]" if len(there) > 1 else "d"
        lines += [f"{2 * INDENT}{s} += {value.format(k)}" for k, s in enumerate(there)]
    lines.append(f"{INDENT}return {', '.join(sums)}")
    return simd.inlined(compiled_source(name, "\n".join(lines) + "\n", functions))


_TETHER_VALUE = "arrays, length, rate, rest, stiffness, damping"
#: Laws of the same tension share their code: the index into `TENSIONS` of every law's tension.
TENSIONS = tuple(dict.fromkeys(tension_of(law) for law in TETHER_LAWS))
TENSION_INDEX = {law.name: TENSIONS.index(tension_of(law)) for law in TETHER_LAWS}


def _tether_inputs():
    names = ("length", "rate", "rest", "stiffness", "damping")
    return {**{getattr(STRETCHED, name): name for name in names}, **CONSTANT_SOURCES}


def _tether_function(name, outputs, mathematics, decorate):
    """A function of values of a tether, with an expression of each law."""
    functions, lines = {}, []
    for i, expressions in enumerate(outputs):
        own = f"{name}_{i}"
        made = function_of(own, _TETHER_VALUE, _tether_inputs(), expressions, mathematics)
        functions[own] = decorate(made)
        lines.append([f"result = {own}({_TETHER_VALUE})"])
    return decorate(_choice(name, _TETHER_VALUE, lines, "arrays.tension == {}", functions))


def _by_rest(tension):
    """Derivative of a tension by L, where EA and C L stay."""
    s = STRETCHED
    changes = {s.rest: 1.0, s.stiffness: -s.stiffness / s.rest, s.damping: -s.damping / s.rest}
    return add(*(derivative(tension, by) * change for by, change in changes.items()))


_WITH_SLOPE = [(t, derivative(t, STRETCHED.length)) for t in TENSIONS]
#: Tension [N] of a taut tether, and its derivative by length [N/m]; that by rate is the damping.
tension = _tether_function("tension", [(t,) for t in TENSIONS], SCALARS, simd.inlined)
tension_and_slope = _tether_function("tension_and_slope", _WITH_SLOPE, SCALARS, simd.inlined)
#: How it grows with a rest length that takes the material of the tether along [N/m].
tension_by_rest = _tether_function(
    "tension_by_rest", [(_by_rest(t),) for t in TENSIONS], SCALARS, simd.inlined
)
#: `tension_and_slope` for numpy arrays.
tension_and_slope_of_arrays = _tether_function(
    "tension_and_slope_of_arrays", _WITH_SLOPE, _ARRAYS, lambda function: function
)
_ENERGIES = {TENSION_INDEX[law.name]: energy_of(law) for law in TETHER_LAWS}
#: Elastic energy [J] of taut tethers, for numpy arrays.
energy_of_arrays = _tether_function(
    "energy_of_arrays", [(_ENERGIES[i],) for i in range(len(TENSIONS))], _ARRAYS,
    lambda function: function,
)  # fmt: skip

_BEAD_VALUE = "arrays, x, y, z, vx, vy, vz, upx, upy, turning"
_LEVEL_UP = (*UP, 0.0)
_SKY_VALUE = "arrays, x, y, z, vx, vy, vz, sky, turning"
_CIRCLE_LAWS = tuple(law for law in BEAD_LAWS if not law.feels_stars)


def _entries(law, a, by):
    """Derivatives that make up a law's Jacobian, by place; those that are always zero left out."""
    symmetric = law.from_potential
    found = {
        (p, q): derivative(a[p], by[q]) for p in range(3) for q in range(p if symmetric else 0, 3)
    }
    return {place: entry for place, entry in found.items() if as_number(entry) != 0.0}


def _mirrored(law, place):
    """Both places of an entry of a symmetric Jacobian."""
    return {place, place[::-1]} if law.from_potential else {place}


def _of_laws(name, arguments, contribution, laws, names, zero="", more=()):
    """A function that lets the acting ones of some laws contribute, as `_of_all_laws`."""
    lines = [f"def {name}({arguments}):"]
    lines += [f"{INDENT}ax = ay = az = {zero}"] if zero else []
    for law in laws:
        functions, own = contribution(law)
        names |= functions
        if not own:  # a law whose derivatives are zero everywhere
            continue
        lines.append(f"{INDENT}if arrays.acting & {1 << BEAD_LAWS.index(law)}:")
        lines += [2 * INDENT + line for line in own]
    lines += [*more, f"{INDENT}return ax, ay, az"] if zero else more
    return compiled_source(name, "\n".join(lines) + "\n", names)


def _of_all_laws(name, arguments, contribution, zero=""):
    """A function that lets every acting law contribute, given a law's functions and lines.

    With a `zero`, these add to ax, ay, az, which begin there and are returned. The first law, which
    nearly always acts, is inlined; the others are called.
    """

    def define(name, laws, names, more=()):
        return _of_laws(name, arguments, contribution, laws, names, zero, more)

    others = f"{name}_others"
    kernel = simd.uncached(define(others, _CIRCLE_LAWS[1:], dict(_LANES)))
    lines = [f"{INDENT}if arrays.acting > 1:"]
    if zero:
        lines += [f"{2 * INDENT}dx, dy, dz = {others}({arguments})", f"{2 * INDENT}{_ADD}"]
    else:
        lines += [f"{2 * INDENT}{others}({arguments})"]
    return simd.inlined(define(name, BEAD_LAWS[:1], {**_LANES, others: kernel}, lines))


_ADD = "ax, ay, az = ax + dx, ay + dy, az + dz"


def _bead_function(law, name, outputs, value=_BEAD_VALUE):
    inputs = {s: s.name for s in (*R, *V, *UP, TURNING)} | _ORBIT
    inputs |= {s: f"sky[{i}]" for i, s in enumerate(SKY)}
    # Short functions that are called together are compiled together.
    decorate = simd.leaf if law is BEAD_LAWS[0] and value == _BEAD_VALUE else simd.inlined
    return {name: decorate(function_of(name, value, inputs, outputs, SCALARS))}


#: How laws are seen: a prefix for names, arguments, and the acceleration by a law.
_ON_CIRCLE = "", _BEAD_VALUE, lambda law: acceleration_of(law, _LEVEL_UP)
_IN_SKY = "sky_", _SKY_VALUE, acceleration_in_sky


def _acceleration(law, seen=_ON_CIRCLE):
    prefix, arguments, of = seen
    name = f"{prefix}acceleration_{law.name}"
    lines = [f"dx, dy, dz = {name}({arguments})", _ADD]
    return _bead_function(law, name, of(law), arguments), lines


def _jacobian(law, seen=_ON_CIRCLE):
    functions, lines, (prefix, arguments, of) = {}, [], seen
    a = of(law)
    for matrix, by in (("by_r", R), ("by_v", V)):
        entries = _entries(law, a, by)
        if not entries:
            continue
        if matrix == "by_v" and not law.by_velocity:
            raise ValueError(f"bead law {law.name!r} depends on the velocity: say by_velocity=True")
        name = f"{prefix}{matrix}_{law.name}"
        functions |= _bead_function(law, name, entries.values(), arguments)
        lines.append(f"d = {name}({arguments})")
        for k, place in enumerate(entries):
            value = f"d[{k}]" if len(entries) > 1 else "d"
            lines += [f"{matrix}[{p}, {q}] += {value}" for p, q in sorted(_mirrored(law, place))]
    return functions, lines


#: Acceleration [m/s^2] of a bead by all acting laws.
bead_acceleration = _of_all_laws("bead_acceleration", _BEAD_VALUE, _acceleration, zero="0.0")
#: Adds its derivatives by position and velocity to matrices (3, 3).
bead_jacobian = _of_all_laws("bead_jacobian", f"{_BEAD_VALUE}, by_r, by_v", _jacobian)
#: The same on orbits that are no circles.
acceleration_of_bead_in_sky, jacobian_of_bead_in_sky = (
    simd.uncached(_of_laws(name, arguments, partial(of, seen=_IN_SKY), BEAD_LAWS, {**_LANES}, zero))
    for name, arguments, of, zero in (
        ("bead_acceleration_in_sky", _SKY_VALUE, _acceleration, "0.0"),
        ("bead_jacobian_in_sky", f"{_SKY_VALUE}, by_r, by_v", _jacobian, ""),
    )
)

# -- Taylor series ---------------------------------------------------------------------------------

_TETHER_LENGTH_2 = dot(R, R)
_AS_SERIES = {
    STRETCHED.length: sqrt(_TETHER_LENGTH_2),
    STRETCHED.rate: rate(_TETHER_LENGTH_2) / (2.0 * sqrt(_TETHER_LENGTH_2)),
}
#: Slots of `taylor_motion.Series.tethers` that all tether laws share: squared length, tension over
#: length, and what of the latter's variation goes with that of the squared length's logarithm.
SQUARE, PULL, BY_LOGARITHM = range(3)


def _tether_program(tension):
    over_length = tension / STRETCHED.length
    slope = 0.5 * (
        derivative(over_length, STRETCHED.length) * STRETCHED.length
        + derivative(over_length, STRETCHED.rate) * STRETCHED.rate
    )
    pull, share = (distributed(substitute(e, _AS_SERIES)) for e in (over_length, slope))
    inputs = {s: f"load(e, three + 3 * {WIDTH} * ({{}}) + {c * WIDTH})" for c, s in enumerate(R)}
    rows = {"stiffness": 1, "damping": 2, "rest": 3}
    constants = {
        getattr(STRETCHED, name): f"load(tether, row + {k * WIDTH})" for name, k in rows.items()
    }
    return SeriesProgram(
        inputs, constants | CONSTANT_SOURCES,
        dict(zip("xyz", (pull * s for s in R))),
        kept=(_TETHER_LENGTH_2, pull, share),
        starts={pull: substitute(over_length, _AS_SERIES)},
    )  # fmt: skip


_TETHER_SERIES = "arrays, e, three, tether, row, room, at, k"
_TETHER_PROGRAMS = [_tether_program(t) for t in TENSIONS]
TETHER_SLOTS = max(len(program.slots) for program in _TETHER_PROGRAMS)


def _tether_series():
    functions, pieces = {}, []
    for i, program in enumerate(_TETHER_PROGRAMS):
        name = f"tether_series_{i}"
        program.lie(0, TETHER_SLOTS)
        functions[name] = simd.leaf(program.function(name, _TETHER_SERIES, _LANES))
        pieces.append([f"result = {name}({_TETHER_SERIES})"])
    return simd.inlined(
        _choice("tether_series", _TETHER_SERIES, pieces, "arrays.tension == {}", functions)
    )


#: Coefficient k of tension over length times the vectors along a block of tethers; fills the slots.
tether_series = _tether_series()

_UPRIGHT = (0.0, 1.0, 0.0)
_STEP = 3 * WIDTH
_BEAD_INPUTS = {
    **{s: f"load(r, three + {_STEP} * ({{0}}) + {c * WIDTH})" for c, s in enumerate(R)},
    **{
        s: f"(({{0}}) + 1.0) * load(r, three + {_STEP} * (({{0}}) + 1) + {c * WIDTH})"
        for c, s in enumerate(V)
    },
}


def _lie_together(programs):
    """Give the programs of all laws places beside each other; returns how many slots that takes."""
    slots = sum(len(program.slots) for program in programs)
    first = 0
    for program in programs:
        program.lie(first, slots)
        first += len(program.slots)
    return slots


_ROUND_ORBIT = _ORBIT | {TURNING: "arrays.rate"}
_BEAD_PROGRAMS = {
    law.name: SeriesProgram(
        _BEAD_INPUTS, _ROUND_ORBIT, dict(zip("xyz", acceleration_of(law, _UPRIGHT)))
    )
    for law in _CIRCLE_LAWS
}
BEAD_SLOTS = _lie_together(_BEAD_PROGRAMS.values())
_BEAD_SERIES = "arrays, r, three, room, at, k"


def _bead_series(law):
    name = f"series_{law.name}"
    function = _BEAD_PROGRAMS[law.name].function(name, _BEAD_SERIES, _LANES)
    lines = [f"dx, dy, dz = {name}({_BEAD_SERIES})", _ADD]
    return {name: simd.leaf(function)}, lines


#: Coefficient k of the acceleration of a block of beads by all acting laws; fills the slots.
bead_series = _of_all_laws("bead_series", _BEAD_SERIES, _bead_series, zero="splat(0.0)")


def _gradient_program(law):
    """Entries of a law's Jacobians by matrix and place, and the program that makes them."""
    motion = _BEAD_PROGRAMS[law.name]
    known = {
        expression: motion.at(slot, "{0}").replace("room", "nodes").replace("at +", "from_ +")
        for expression, slot in motion.slots.items()
    }
    entries = {
        (matrix, *place): entry
        for matrix, by in (("by_r", R), ("by_v", V))
        for place, entry in _entries(law, acceleration_of(law, _UPRIGHT), by).items()
    }
    outputs = {f"{matrix}{p}{q}": entry for (matrix, p, q), entry in entries.items()}
    return entries, SeriesProgram(_BEAD_INPUTS | known, _ROUND_ORBIT, outputs)


_GRADIENT_PROGRAMS = {law.name: _gradient_program(law) for law in _CIRCLE_LAWS}
GRADIENT_SLOTS = _lie_together([program for _, program in _GRADIENT_PROGRAMS.values()])
_GRADIENT_SERIES = "arrays, r, three, nodes, from_, room, at, k"


def _gradient_series(law):
    name = f"gradient_{law.name}"
    entries, program = _GRADIENT_PROGRAMS[law.name]
    if not entries:
        return {}, []
    function = program.function(name, _GRADIENT_SERIES, _LANES)
    lines = [f"d = {name}({_GRADIENT_SERIES})"]
    for i, (matrix, *place) in enumerate(entries):
        value = f"d[{i}]" if len(entries) > 1 else "d"
        for p, q in sorted(_mirrored(law, tuple(place))):
            where = f"{matrix}, to + {(3 * p + q) * WIDTH}"
            lines.append(f"store({where}, load({where}) + {value})")
    return {name: simd.leaf(function)}, lines


#: Adds coefficient k of a block's Jacobians, (3, 3, W) from `to` on, by all acting laws.
bead_gradient_series = _of_all_laws(
    "bead_gradient_series", f"{_GRADIENT_SERIES}, by_r, by_v, to", _gradient_series
)
