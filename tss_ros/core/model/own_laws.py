"""Laws of users: found, checked, and made part of what compiled kernels hang on.

An installed package names them as entry points of the group `tss_ros.laws`. The environment
variable TSS_ROS_LAWS names others as module:NAME, several with commas between them.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points

import numpy as np

from tss_ros.core.errors import TssError
from tss_ros.core.fingerprint import OWN_LAWS
from tss_ros.core.model.contract import Law, LawParameter, ReelLaw, TetherLaw, ThrustLaw
from tss_ros.core.model.stated import (
    OF_BEADS,
    OF_REELS,
    OF_SATELLITES,
    OF_TETHERS,
    PLACE,
    SHAPE,
    SKY,
    SPEED,
    TURN,
    TURNING,
    R,
    V,
    acceleration_in_sky,
    energy_of,
    of_parameters,
    reel_force_of,
    tension_of,
    thrust_of,
)
from tss_ros.core.numerics.expressions import Product, add, derivative, parts, symbols
from tss_ros.core.numerics.value_maker import Values, function_of, of_roots

GROUP, VARIABLE = "tss_ros.laws", "TSS_ROS_LAWS"
#: What may differ by rounding between numbers that ought to be equal, over the largest of them.
ROUNDING = 1e-9
_ROOTS = {"sqrt": math.sqrt, "exp": math.exp}


def own_laws(laws: Sequence[Law], others: Sequence[LawParameter]) -> tuple[Law, ...]:
    """The users' laws.

    Parameters
    ----------
    laws : sequence
        Those of the package.
    others : sequence of LawParameter
        Parameters that no law has for itself.

    Returns
    -------
    tuple

    Raises
    ------
    TssError
        If one of them cannot be loaded, or is no law that kernels can be made of.
    """
    found: list[Law] = []
    for where, entry in _declared():
        try:
            law = entry.load()
        except Exception as error:  # whatever a user's module raises
            raise TssError(
                f"{where} could not be loaded: {type(error).__name__}: {error}; of tss_ros its"
                " module may import tss_ros.core.model.contract and"
                " tss_ros.core.numerics.expressions only"
            ) from error
        if not isinstance(law, Law):
            raise TssError(
                f"{where} must be a BeadLaw, TetherLaw, ThrustLaw or ReelLaw, got"
                f" {type(law).__name__}"
            )
        try:
            _check_names(law, (*laws, *found), others)
            OWN_LAWS[law.name] = statement(law)
        except Exception as error:
            raise TssError(f"{where}, law {law.name!r}: {error}") from error
        found.append(law)
    return tuple(found)


def _declared():
    """What names each law, in words, and an entry point for it."""
    installed = sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, entry.value))
    for entry in dict.fromkeys(installed):
        yield f"{entry.value}, entry point {entry.name!r} of {GROUP},", entry
    for value in filter(None, map(str.strip, os.environ.get(VARIABLE, "").split(","))):
        if not re.fullmatch(r"[\w.]+:[\w.]+", value):
            raise TssError(f"{VARIABLE} must have the form module:NAME,module:NAME, got {value!r}")
        yield f"{value} of {VARIABLE}", EntryPoint(value, value, GROUP)


#: Names of all that laws may use beside their own parameters.
_SYMBOLS = {s.name for s in (*OF_TETHERS, *OF_BEADS, *OF_SATELLITES, *OF_REELS)}

# -- names -----------------------------------------------------------------------------------------


def _check_names(law, laws, others):
    kind = "law" if isinstance(law, TetherLaw) else "parameter"
    if not isinstance(law.name, str) or not law.name.isidentifier():
        raise TssError(f"its name must be a word like my_law, got {law.name!r}")
    if law.name in {other.name for other in laws}:
        raise TssError("another law has this name already")
    if kind == "parameter" and not law.parameters:
        raise TssError("needs a parameter: the law acts where the first one is not zero")
    taken = {p.name for p in (*others, *(p for other in laws for p in other.parameters))}
    for i, p in enumerate(law.parameters):
        if not isinstance(p, LawParameter):
            raise TssError(f"its parameters must be LawParameters, got {p!r:.80}")
        if not p.name.isidentifier():
            raise TssError(f"names of parameters must be words like my_gain, got {p.name!r}")
        if p.name in taken or p.name in _SYMBOLS:
            raise TssError(f"its parameter needs another name: {p.name!r} is taken")
        taken.add(p.name)
        if not -math.inf < p.minimum <= p.default <= p.maximum < math.inf:
            raise TssError(
                f"the default of {p.name}, {p.default:g}, must lie in its range, from"
                f" {p.minimum:g} to {p.maximum:g}"
            )
        if i == 0 and kind == "parameter" and p.default:
            raise TssError(
                f"acts where {p.name} is not zero: its default must be 0, got {p.default:g}"
            )


# -- what laws declare -----------------------------------------------------------------------------


def statement(law: Law) -> str:
    """All that kernels are made of, as text, after it has been held to what the law declares.

    Raises
    ------
    TssError
        If it is not what it has to be.
    """
    if isinstance(law, TetherLaw):
        known, outputs = OF_TETHERS, (tension_of(law), energy_of(law))
    elif isinstance(law, ThrustLaw):
        known, outputs = OF_SATELLITES, _vector("thrust", lambda: thrust_of(law))
    elif isinstance(law, ReelLaw):
        known, outputs = OF_REELS, _stated("force", lambda: [reel_force_of(law)])
    else:
        known, outputs = OF_BEADS, _vector("acceleration", lambda: acceleration_in_sky(law))
    own = set(of_parameters(law).values())
    if foreign := symbols(*outputs) - set(known) - own:
        raise TssError(f"is stated by symbols that nothing is known of: {_listed(foreign)}")
    if odd := {x for e in _all_parts(outputs) if isinstance(e, Product) for _, x in e.factors
               if not of_roots(x)}:  # fmt: skip
        raise TssError(f"has a power of {odd.pop():g}: exponents must be multiples of 1/64")
    _Held(law, known).to_its_word(outputs)
    code = Values({s: s.name for s in (*known, *own)})
    results = [code.value(output) for output in outputs]
    declared = [
        (name, value if isinstance(value, str | bool | float | int) else None)
        for name, value in vars(law).items() if name != "parameters"
    ]  # fmt: skip
    return "\n".join([repr((type(law).__name__, declared, law.parameters)), *code.lines, *results])


def _all_parts(expressions):
    """Some expressions and all that they are made of."""
    found, left = set(), list(expressions)
    while left:
        if (expression := left.pop()) not in found:
            found.add(expression)
            left += parts(expression)
    return found


def _listed(those):
    return ", ".join(sorted(s.name for s in those))


def _vector(what, stated):
    """Three components, or what is wrong with them."""
    vector = _stated(what, stated)
    if len(vector) != 3:
        raise TssError(f"its {what} must have three components, got {len(vector)}")
    return vector


def _stated(what, stated):
    """What a law states, or what is wrong with it."""
    advice = "write + - * /, ** with a number, and sqrt, exp, excess of numerics.expressions"
    try:
        return tuple(map(add, stated()))
    except Exception as error:
        raise TssError(f"its {what} failed: {type(error).__name__}: {error}; {advice}") from error


class _Held:
    """A law held to what it declares, by numbers."""

    def __init__(self, law, known):
        rng = np.random.default_rng(1)
        self.law, self.known = law, known
        self.values = {
            s: p.default or p.minimum + 0.01 * (p.maximum - p.minimum)
            for p, s in zip(law.parameters, of_parameters(law).values())
        } | {s: float(x) for s, x in zip(known, rng.uniform(0.5, 1.5, len(known)))}

    def numbers(self, expressions, more=None):
        """Values of expressions, with some symbols of other values."""
        values = self.values | (more or {})
        outputs = [add(0.0), *expressions]
        inputs = {s: repr(float(x)) for s, x in values.items()}
        try:
            found = np.array(function_of("own_law", "", inputs, outputs, _ROOTS)())[1:]
        except ArithmeticError as error:
            raise TssError(f"has no value where it needs one: {error}") from error
        if not np.isrealobj(found) or not np.isfinite(found).all():
            raise TssError("has no finite value where it needs one")
        return found

    def to_its_word(self, outputs):
        """Hold it to all that laws of its kind declare."""
        if isinstance(self.law, TetherLaw):
            self._tether(*outputs)
        elif isinstance(self.law, ThrustLaw):
            self._thrust(outputs)
        elif isinstance(self.law, ReelLaw):
            self._reel(*outputs)
        else:
            self._bead(outputs)

    def _tether(self, tension, energy):
        length, growth, rest, stiffness, damping = OF_TETHERS
        at = {growth: 0.0, rest: 1e4, stiffness: 5.0, damping: 100.0}
        (slack,) = self.numbers([tension], at | {length: 1e4})
        if not abs(slack) < ROUNDING * 5e4:
            raise TssError(f"the tension at the rest length must be 0, got {slack:g} N")
        slopes = [derivative(tension, length), derivative(energy, length), tension]
        for strain in (1e-6, 1e-3, 0.1):
            slope, force, pull = self.numbers(slopes, at | {length: 1e4 * (1.0 + strain)})
            if not slope > 0.0:
                raise TssError(f"the tension must grow with length; not at a strain of {strain:g}")
            if not abs(force - pull) < 1e-6 * pull:
                raise TssError(
                    f"the energy's slope must be the tension at rate 0: at a strain of {strain:g}"
                    f" they are {force:g} and {pull:g} N"
                )

    def _turned(self, values, vectors):
        """Values with vectors turned about z by an angle of 1."""
        turned, c, s = dict(values), math.cos(1.0), math.sin(1.0)
        for x, y, _ in vectors:
            turned |= {x: c * values[x] - s * values[y], y: s * values[x] + c * values[y]}
        return turned

    def _turns_along(self, outputs, turned):
        x, y, z = self.numbers(outputs)
        c, s = math.cos(1.0), math.sin(1.0)
        missed = self.numbers(outputs, turned) - (c * x - s * y, s * x + c * y, z)
        return np.abs(missed).max() <= ROUNDING * np.abs((x, y, z)).max()

    def _thrust(self, outputs):
        rest = {p: self.values[there] for p, there in zip(PLACE, SHAPE)}
        rest |= dict.fromkeys((*SPEED, TURN), 0.0)
        slopes = [derivative(a, b) for a in outputs for b in (*PLACE, *SPEED, *SHAPE)]
        try:
            self.numbers([*outputs, *slopes], rest)
        except TssError as error:
            raise TssError(f"in the steady turn the thrust {error}: make it smooth") from None
        if not self._turns_along(outputs, self._turned(self.values, (PLACE, SPEED, SHAPE))):
            raise TssError("the thrust must turn with the satellites: x and y are no directions")

    def _reel(self, force):
        rest, slopes = dict.fromkeys(OF_REELS, 0.0), [derivative(force, by) for by in OF_REELS]
        try:
            held, *_ = self.numbers([force, *slopes], rest)
        except TssError as error:
            raise TssError(f"where the reel stands the force {error}: make it smooth") from None
        if not abs(held) < ROUNDING:
            raise TssError(
                f"the force must be 0 where nothing is paid out and the reel stands, got {held:g} N"
            )

    def _bead(self, outputs):
        law, felt = self.law, symbols(*outputs)
        if law.orbit is not None:
            raise TssError("cannot bend the reference orbit: leave `orbit` out")
        by_r, by_v = ([[derivative(a, b) for b in by] for a in outputs] for by in (R, V))
        if felt & set(SKY[12:]) and not law.feels_stars:
            raise TssError("knows the direction of the Sun: say feels_stars=True")
        if felt & set(SKY[9:12]) and law.feels_pole not in ("axis", "sense"):
            raise TssError('knows the Earth\'s axis: say feels_pole="axis", or "sense"')
        if felt & set(V) and not law.by_velocity:
            raise TssError("depends on the velocity: say by_velocity=True, from_potential=False")
        matrix = self.numbers([a for row in by_r for a in row]).reshape(3, 3)
        if law.from_potential and np.abs(matrix - matrix.T).max() > ROUNDING * np.abs(matrix).max():
            raise TssError("is no gradient of a potential: say from_potential=False")
        level = dict.fromkeys((R[2], V[2], SKY[2], SKY[8], SKY[9], SKY[10]), 0.0) | {SKY[11]: 1.0}
        plane = self.numbers(outputs, level)
        if law.keeps_plane and abs(plane[2]) > ROUNDING * np.abs(plane).max():
            raise TssError("takes beads out of the orbit plane: say keeps_plane=False")
        # Seen from axes that are turned, and that turn faster.
        x, y, vx, vy, turning = (self.values[one] for one in (*R[:2], *V[:2], TURNING))
        faster = self.values | {V[0]: vx + 0.5 * y, V[1]: vy - 0.5 * x, TURNING: turning + 0.5}
        vectors = R, V, *(SKY[k : k + 3] for k in (0, 6, 9, 12))
        if not self._turns_along(outputs, self._turned(faster, vectors)):
            raise TssError(
                "must be the same in axes that turn otherwise: take directions from `up`, `pole`,"
                " and velocities with `turning` z x position"
            )
