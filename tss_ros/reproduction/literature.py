"""Formations of other papers: what their public abstracts claim, computed, with a verdict each."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tss_ros import core
from tss_ros.core import Satellite, State, System, Tether
from tss_ros.core.model.axes import spin_axis_of
from tss_ros.scenarios import scenario

#: Random chains of the first claim: how many, and from how few to how many bodies.
CHAINS, BODIES = 200, (2, 6)
#: Kilograms and metres of the bunch of deputies, and over how many orbits it is watched.
MAIN_KG, DEPUTY_KG, TETHER_M, ORBITS = 1000.0, 50.0, 1000.0, 20.0
#: Amplitudes of the deputies' curves over the tether length.
AMPLITUDES = (0.05, 0.1, 0.2, 0.3, 0.4)
#: Rates over Omega at which hubs are asked about, and rings beside a rigid body.
HUB_RATES = tuple((np.arange(-16, 17) / 2.0).tolist())
HUB_SATELLITES = (3, 4, 5, 6)
TILT_RATES = (-2.2, -2.5, -3.0, -4.0, -6.0, -8.0, -12.0)
PYRAMID_RATES = (1.0, 2.0, 3.0, 3.5, 4.0, 5.0, 8.0, 12.0, 16.0, 20.0)
#: Shipped scenarios about axes other than the orbit normal, and rates over Omega at which they are
#: asked about.
TILTED = {
    "ring_inclined": tuple((-np.arange(1.3, 2.01, 0.1)).round(2).tolist()),
    "tetrahedron": tuple(np.arange(1.0, 5.1, 0.5).tolist()),
    "closed_hub_earth_facing": tuple(np.arange(1.0, 5.1, 0.5).tolist()),
    "double_pyramid_earth_facing": tuple(np.arange(1.0, 10.1, 1.0).tolist()),
    "hub_and_spoke_earth_facing": tuple(np.arange(0.4, 2.1, 0.2).round(2).tolist()),
}
#: A claim holds, does not, or cannot be judged from what is public.
REPRODUCED, PARTLY, NOT = "reproduced", "in part", "not reproduced"


@dataclass(frozen=True)
class Source:
    """A publication and where its claims can be read.

    Attributes
    ----------
    key : str
    citation, read_from : str
    """

    key: str
    citation: str
    read_from: str


SOURCES = {
    source.key: source
    for source in (
        Source(
            "misra_modi",
            "A. K. Misra, V. J. Modi, Three-dimensional dynamics and control of tether-connected"
            " N-body systems, Acta Astronautica 26 (1992)",
            "its abstract",
        ),
        Source(
            "lissajous",
            "D. Yarotsky, V. Sidorenko, D. Pritykin, Three-dimensional multi-tethered satellite"
            " formation with the elements moving along Lissajous curves, Celestial Mechanics and"
            " Dynamical Astronomy 125 (2016), arXiv:1603.05244",
            "its abstract",
        ),
        Source(
            "correa",
            "Correa and others, the vertical chain of four, reference 24 of the paper",
            "the paper's introduction",
        ),
        Source(
            "pizarro_misra",
            "A. Pizarro-Chong, A. K. Misra, Dynamics of multi-tethered satellite formations"
            " containing a parent body, Acta Astronautica 63 (2008), reference 25 of the paper",
            "the paper's introduction",
        ),
        Source(
            "tragesser",
            "S. G. Tragesser, closed rings in the cylindrical equilibrium, reference 26 of the"
            " paper",
            "the paper's introduction",
        ),
        Source(
            "pyramid",
            "the Earth-facing double pyramid, reference 21 of the paper",
            "the paper's introduction",
        ),
    )
}


@dataclass(frozen=True)
class Claim:
    """A claim and what was found.

    Attributes
    ----------
    source : Source
    says : str
        The claim, in our words.
    found : str
    verdict : str
        `REPRODUCED`, `PARTLY` or `NOT`.
    """

    source: Source
    says: str
    found: str
    verdict: str


# -- hanging chains --------------------------------------------------------------------------------


def hanging_chain(masses: Sequence[float], lengths: Sequence[float]) -> System:
    """A chain along the vertical with stiff tethers of these lengths [m]."""
    heights = np.concatenate([[0.0], -np.cumsum(lengths)])
    heights -= np.average(heights, weights=masses)
    bodies = [
        Satellite(f"body_{i + 1}", m, (0.0, h, 0.0))
        for i, (m, h) in enumerate(zip(masses, heights))
    ]
    tethers = [
        Tether(f"tether_{i + 1}", (i, i + 1), (length,), (1e9,), (0.0,))
        for i, length in enumerate(lengths)
    ]
    return core.assemble(bodies, tethers, linear_gravity=True)


def librations(system: System) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies over Omega of a chain's librations in the orbit plane and out of it, sorted.

    Those of the centre of mass and of stretching tethers are left out.
    """
    result = core.compute_floquet(system, 0.0, certify=False)
    rate = np.abs(result.exponent.imag) / system.orbit_rate_rad_s
    of_chain = np.array([family != "centre of mass" for family in result.family])
    above = np.sum(np.abs(result.vectors[2::3]) ** 2, axis=0) > 0.5
    slow = rate < 100.0
    # Each comes as a conjugate pair.
    return tuple(np.sort(rate[of_chain & slow & side])[::2] for side in (~above, above))


def chains(cancelled: Callable[[], bool]) -> dict[str, Any]:
    """Librations of random chains, and verdicts on chains of equal bodies."""
    random, inside, outside = np.random.default_rng(1), [], []
    for _ in range(CHAINS):
        count = int(random.integers(BODIES[0], BODIES[1] + 1))
        masses = random.uniform(10.0, 1000.0, count)
        lengths = random.uniform(100.0, 10_000.0, count - 1)
        in_plane, out_of_plane = librations(hanging_chain(masses, lengths))
        if len(in_plane) != count - 1 or len(out_of_plane) != count - 1:
            raise core.TssError(f"a chain of {count} has {len(in_plane)} librations in the plane")
        inside += in_plane.tolist()
        outside += out_of_plane.tolist()
        if cancelled():
            raise core.Cancelled("stopped among the chains")
    inside, outside = np.array(inside), np.array(outside)
    verdicts = {}
    for count in range(2, 11):
        result = core.compute_floquet(core.formation("chain", count), 0.0, certify=False)
        verdicts[count] = result.verdict
    return {
        "in_plane": inside, "out_of_plane": outside,
        "error": float(np.max(np.abs(outside**2 - inside**2 - 1.0))), "verdicts": verdicts,
    }  # fmt: skip


# -- deputies on Lissajous curves ------------------------------------------------------------------


def bunch(deputies: int) -> tuple[System, float]:
    """A main body over deputies on tethers of their own, and its share of the mass."""
    share = MAIN_KG / (MAIN_KG + deputies * DEPUTY_KG)
    bodies = [Satellite("main", MAIN_KG, (0.0, TETHER_M * (1.0 - share), 0.0))]
    bodies += [
        Satellite(f"deputy_{i + 1}", DEPUTY_KG, (0.0, -TETHER_M * share, 0.0))
        for i in range(deputies)
    ]
    tethers = [
        Tether(f"tether_{i + 1}", (0, i + 1), (TETHER_M,), (5e5,), (0.0,)) for i in range(deputies)
    ]
    return core.assemble(bodies, tethers), share


def lissajous_start(system: System, share: float, amplitude_m: float) -> State:
    """Deputies spread in phase on one Lissajous curve, so that their pulls across cancel.

    In linear gravity a deputy swings along the flight at sqrt(3 q) Omega and across it at
    sqrt(1 + 3 q) Omega, q being the main body's share of the mass.
    """
    rest = core.initial_state(system, 0.0)
    r, v = np.array(rest.position_m), np.zeros_like(rest.position_m)
    phase = 2.0 * np.pi * np.arange(system.n - 1) / (system.n - 1)
    along, across = (math.sqrt(k + 3.0 * share) * system.orbit_rate_rad_s for k in (0.0, 1.0))
    length = r[0, 1] - r[1, 1]
    r[1:, 0], v[1:, 0] = amplitude_m * np.cos(phase), -amplitude_m * along * np.sin(phase)
    r[1:, 2], v[1:, 2] = amplitude_m * np.sin(phase), amplitude_m * across * np.cos(phase)
    height = np.sqrt(length**2 - r[1:, 0] ** 2 - r[1:, 2] ** 2)
    r[1:, 1] = r[0, 1] - height
    v[1:, 1] = (r[1:, 0] * v[1:, 0] + r[1:, 2] * v[1:, 2]) / height
    r -= system.mass_kg @ (r - rest.position_m) / np.sum(system.mass_kg)
    v -= system.mass_kg @ v / np.sum(system.mass_kg)
    return State(r, v)


def bunches(cancelled: Callable[[], bool]) -> dict[str, Any]:
    """Four deputies on curves of several sizes, watched over many orbits."""
    system, share = bunch(4)
    verdict = core.compute_floquet(system, 0.0, certify=False)
    rows, paths = [], {}
    for part in AMPLITUDES:
        amplitude = part * TETHER_M
        seen = core.simulate(
            system, 0.0, turns=ORBITS, period_s=20.0, cancelled=cancelled,
            state=lissajous_start(system, share, amplitude),
        )  # fmt: skip
        apart = seen.position_m[:, 1:] - seen.position_m[:, :1]
        first, second = np.triu_indices(system.n - 1, 1)
        near = np.linalg.norm(apart[:, first] - apart[:, second], axis=-1).min()
        rows.append({
            "amplitude": part,
            "slack": float(np.mean((~seen.taut).any(axis=1))),
            "tension_n": [float(seen.tension_n.min()), float(seen.tension_n.max())],
            "main_m": float(np.abs(seen.position_m[:, 0, [0, 2]]).max()),
            "reach": float(np.abs(apart[:, :, [0, 2]]).max() / amplitude),
            "nearest": float(near / amplitude),
        })  # fmt: skip
        paths[part] = (seen.turns, apart[:, :, [0, 2]])
    return {"verdict": verdict.verdict, "rows": rows, "share": share, "paths": paths}


# -- hubs, rings, pyramids -------------------------------------------------------------------------


def hub(satellites: int, closed: bool) -> System:
    """A hub with tethers of 10 km, and with a ring that just fits them if closed."""
    spokes = [10e3] * satellites
    if not closed:
        return core.formation("hub_and_spoke", satellites, tether_length_m=spokes)
    ring = [20e3 * math.sin(math.pi / satellites)] * satellites
    return core.formation("closed_hub_and_spoke", satellites, tether_length_m=spokes + ring)


def hubs(cancelled: Callable[[], bool]) -> dict[str, Any]:
    """Verdicts on hubs with 3 to 6 satellites, open and closed, over the rate."""
    found = {}
    for closed in (False, True):
        for count in HUB_SATELLITES:
            system = hub(count, closed)
            found[closed, count] = [
                core.compute_floquet(system, rate, certify=False, cancelled=cancelled).verdict
                for rate in HUB_RATES
            ]
    return found


def tilt_frequencies(rate: float) -> np.ndarray:
    """The two frequencies over Omega at which the axis of a rigid flat ring nods, ascending."""
    s = 1.0 + rate
    squares = np.roots([1.0, (2 * s - 1) ** 2 + 4, (2 * s - 1) * (2 * s + 2)])
    return np.sort(np.sqrt(-squares.real))


def rings(cancelled: Callable[[], bool]) -> list[dict[str, Any]]:
    """How far the axis tilt of rings is from a rigid body's, over the rate."""
    rows = []
    for count in range(3, 7):
        system = core.ring(count)
        for rate in TILT_RATES:
            result = core.compute_floquet(system, rate, certify=False, cancelled=cancelled)
            tilt = [m for m, f in zip(result.multiplier, result.family) if f == "axis tilt"]
            row = {"satellites": count, "rate": rate, "verdict": result.verdict}
            if tilt:
                expected = np.exp(2j * np.pi * tilt_frequencies(rate) / abs(rate))
                apart = np.abs(np.array(tilt)[:, None] - [*expected, *expected.conj()])
                row["apart"] = float(np.max(np.min(apart, axis=1)))
            rows.append(row)
    return rows


def pyramid() -> System:
    """Four satellites around the vertical, a heavy one above and one below them."""
    return core.formation(
        "double_pyramid", 4, satellite_mass_kg=[50.0] * 4 + [500.0] * 2,
        tether_length_m=[1414.0] * 4 + [3162.0] * 8, spin_axis=(0, 1, 0),
    )  # fmt: skip


def conical_tilt_deg(rate: float) -> float:
    """Angle from the vertical at which a rigid pyramid's axis rests: s3 = C w / 4 (A - C)."""
    system = pyramid()
    x, y, z = system.layout_m.T
    about = float(system.mass_kg @ (x * x + z * z))
    across = float(system.mass_kg @ (y * y + 0.5 * (x * x + z * z)))
    return math.degrees(math.asin(about * rate / (4.0 * (across - about))))


def pyramids(cancelled: Callable[[], bool]) -> list[dict[str, Any]]:
    """Where the axis of an Earth-facing double pyramid rests, and the verdicts there."""
    rows, system = [], pyramid()
    for rate in PYRAMID_RATES:
        result = core.compute_floquet(system, rate, certify=False, cancelled=cancelled)
        axis = spin_axis_of(system, result.state, system.spin_rate_rad_s(rate))
        tilt = math.degrees(math.acos(min(abs(axis[1]), 1.0)))
        rows.append({"rate": rate, "verdict": result.verdict, "tilt_deg": tilt})
    return rows


def tilted(cancelled: Callable[[], bool]) -> dict[str, list[str]]:
    """Verdicts on the shipped scenarios about other axes, over the rate."""
    found = {}
    for name, rates in TILTED.items():
        system = scenario.load(name).build()
        found[name] = [
            core.compute_floquet(system, rate, certify=False, cancelled=cancelled).verdict
            for rate in rates
        ]
    return found
