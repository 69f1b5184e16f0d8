"""Values of scenarios that are allowed, but probably not what was meant."""

import math
from collections.abc import Collection, Iterator, Sequence

from tss_ros.core import LAW_PARAMETERS, Satellite, System, Tether

#: What may well be meant: lowest orbit [m], largest speed [m/s] in the orbit frame, largest factor
#: between the length of a tether and the distance of its ends.
LOWEST_ORBIT_M, FASTEST_M_S, MOST_STRETCH = 120e3, 1000.0, 10.0


class ImplausibleValue(UserWarning):
    """A value of a scenario is allowed, but probably not what was meant."""


def doubts(
    system: System,
    given: Collection[str],
    bodies: Sequence[Satellite],
    tethers: Sequence[Tether],
    velocities: Sequence[Sequence[float]],
) -> Iterator[str]:
    """What is probably not meant, in words.

    Parameters
    ----------
    system : System
    given : collection of str
        Names of the parameters that replace those of a scenario.
    bodies, tethers, velocities : sequence
        What a scenario spells out; empty if it names a formation.

    Yields
    ------
    str
        Naming the thing, its value and what is plausible.
    """
    if system.orbit_altitude_m < LOWEST_ORBIT_M:
        yield (
            f"orbit_altitude_m is {system.orbit_altitude_m:g}, where the air ends an orbit at once;"
            f" plausible: {LOWEST_ORBIT_M:g} and more, in metres"
        )
    for parameter in LAW_PARAMETERS:
        name, value = parameter.name, system.law_parameters[parameter.name]
        if name in system.idle_parameters and value != parameter.default:
            others = " or ".join(system.idle_parameters[name])
            yield f"{name} is {value:g}, which has no effect unless {others} is not 0"
    if "bead_mass_kg" in given and system.is_satellite.all():
        yield "bead_mass_kg has no effect unless beads_per_tether is above 0"
    for tether in tethers:
        first, last = (bodies[end] for end in tether.ends)
        length = sum(tether.length_m)
        apart = math.dist(first.position_m, last.position_m)
        if not length / MOST_STRETCH <= apart <= length * MOST_STRETCH:
            yield (
                f"tether {tether.name!r} is {length:g} m long, and {first.name!r} and"
                f" {last.name!r} are {apart:g} m apart"
            )
    for body, velocity in zip(bodies, velocities):
        if (speed := math.hypot(*velocity)) > FASTEST_M_S:
            yield (
                f"velocity_m_s of {body.name!r} is {speed:g} m/s; it is measured in the orbit"
                " frame, without the orbit's own speed"
            )
