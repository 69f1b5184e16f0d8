"""Elements of an orbit: their axes, those of a state, and whether forces depend on time there."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tss_ros.core.arguments import checked, numbers
from tss_ros.core.errors import TssError
from tss_ros.core.model.system import MU_EARTH, RADIUS_EARTH_M, System

#: An eccentricity or inclination [rad] of a state below this is rounding.
NONE = 1e-11


def eccentric_anomaly(mean_anomaly: np.ndarray, eccentricity: float) -> np.ndarray:
    """E of M = E - e sin E [rad], Kepler's equation, by Newton's method; M from -pi to pi."""
    e, sense, m = eccentricity, np.sign(mean_anomaly), np.abs(mean_anomaly)
    # From above, where the curve bends so that Newton's method never overshoots.
    anomaly = np.minimum(m + e, math.pi)
    for _ in range(60):
        step = (anomaly - e * np.sin(anomaly) - m) / (1.0 - e * np.cos(anomaly))
        anomaly = anomaly - step
        if np.max(np.abs(step), initial=0.0) < 1e-16:
            break
    return sense * anomaly


def of_degrees(angle: float) -> tuple[float, float]:
    """Cosine and sine, exact at right angles."""
    quarters, rest = divmod(math.remainder(angle, 360.0) + 45.0, 90.0)
    x = math.radians(rest - 45.0)
    c, s = math.cos(x), math.sin(x)
    return ((c, s), (-s, c), (-c, -s), (s, -c))[int(quarters) % 4]


def axes_of(values: Mapping[str, float]) -> np.ndarray:
    """Columns: the axes of the orbit frame in inertial ones; see `orbits.ReferenceOrbit.axes`."""
    (cn, sn), (ci, si) = (of_degrees(values[k]) for k in ("raan_deg", "inclination_deg"))
    cu, su = of_degrees(values["argument_of_perigee_deg"] + values["true_anomaly_deg"])
    node, ahead = np.array([cn, sn, 0.0]), np.array([-sn * ci, cn * ci, si])
    up, forward = cu * node + su * ahead, cu * ahead - su * node
    return np.stack([-forward, up, [sn * si, -cn * si, ci]], axis=1)


@checked
def orbit_elements(position_m: np.ndarray, velocity_m_s: np.ndarray) -> dict[str, float]:
    """Elements of the orbit through a state, by the names of scenario files.

    Parameters
    ----------
    position_m, velocity_m_s : ndarray, shape (3,)
        From the Earth's centre, in Earth-centred inertial axes.

    Returns
    -------
    dict of str to float
        orbit_altitude_m of the perigee, eccentricity, inclination_deg, raan_deg,
        argument_of_perigee_deg and true_anomaly_deg. What a circle or the plane of the equator
        leaves open is 0; the true anomaly of a circle is measured from the node.

    Raises
    ------
    TssError
        If the orbit is not closed, or its perigee lies inside the Earth.
    """
    q, v = (numbers(name, x) for name, x in (("position_m", position_m),
                                             ("velocity_m_s", velocity_m_s)))  # fmt: skip
    for name, x in (("position_m", q), ("velocity_m_s", v)):
        if x.shape != (3,) or not np.isfinite(x).all():
            raise TssError(f"{name} must be three finite numbers x, y, z, got {x!r:.80}")
    radius, momentum = float(np.linalg.norm(q)), np.cross(q, v)
    h = float(np.linalg.norm(momentum))
    if not radius or not h:
        raise TssError("the state is on a straight line through the Earth's centre, no orbit")
    out = float(q @ v) / radius
    cosine, sine = h * h / (MU_EARTH * radius) - 1.0, h * out / MU_EARTH
    e = math.hypot(cosine, sine)
    if e >= 1.0:
        raise TssError(f"the orbit must be closed, an eccentricity below 1, got {e:.6g}")
    altitude = h * h / MU_EARTH / (1.0 + e) - RADIUS_EARTH_M
    if altitude < 0.0:
        raise TssError(
            f"the perigee must lie above the Earth, at least {RADIUS_EARTH_M / 1e3:g} km from its"
            f" centre, got {(altitude + RADIUS_EARTH_M) / 1e3:.6g} km"
        )
    normal = momentum / h
    inclination = math.atan2(math.hypot(normal[0], normal[1]), normal[2])
    level = math.sin(inclination) < NONE
    raan = 0.0 if level else math.atan2(normal[0], -normal[1])
    node = np.array([math.cos(raan), math.sin(raan), 0.0])
    # From the node to the place, in the sense of the flight.
    latitude = math.atan2(float(np.cross(normal, node) @ q), float(node @ q))
    anomaly = latitude if e < NONE else math.atan2(sine, cosine)
    angles = {
        "inclination_deg": inclination,
        "raan_deg": raan,
        "argument_of_perigee_deg": latitude - anomaly,
        "true_anomaly_deg": anomaly,
    }
    return {
        "orbit_altitude_m": altitude,
        "eccentricity": 0.0 if e < NONE else e,
        **{name: math.degrees(x) % 360.0 for name, x in angles.items()},
    }


def on_mean_circle(system: System, eccentricity: float = 0.0) -> System:
    """The system on another orbit of the same semi-major axis, without what depends on time."""
    axis = system.orbit_radius_m / (1.0 - system.law_parameters["eccentricity"])
    values = dict(system.law_parameters)
    for law in system.acting_laws:
        if law.parameters and (law.by_velocity or law.feels_stars or not eccentricity):
            values[law.parameters[0].name] = 0.0
    return replace(
        system,
        orbit_altitude_m=max(axis * (1.0 - eccentricity) - RADIUS_EARTH_M, 0.0),
        law_parameters={**values, "eccentricity": eccentricity},
    )


def why_not_autonomous(system: System) -> str:
    """Why forces in the orbit frame depend on time, in words with numbers; "" if they do not."""
    if system.autonomous:
        return ""
    values = system.law_parameters
    if values["eccentricity"]:
        return f"the orbit is an ellipse of eccentricity {values['eccentricity']:g}"
    if stars := [law.name for law in system.acting_laws if law.feels_stars]:
        return f"{stars[0]} acts, whose direction turns in the orbit frame"
    pole = next(law.name for law in system.acting_laws if law.feels_pole)
    return f"{pole} acts on an orbit that is inclined by {values['inclination_deg']:g} degrees"


def require_autonomous(system: System, asked: str) -> None:
    """Refuse what is only known where forces in the orbit frame do not depend on time.

    Raises
    ------
    TssError
        With what was asked, and why it cannot be answered.
    """
    if reason := why_not_autonomous(system):
        raise TssError(f"{asked} needs forces that rest in the orbit frame, but {reason}")
