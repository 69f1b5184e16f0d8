"""The elements of the orbit that the formation's nominal centre follows."""

from tss_ros.core.model.contract import LawParameter

#: Beside the height of the perigee, `System.orbit_altitude_m`. On a circle the perigee is where
#: the centre is at time 0, less the true anomaly.
ELEMENTS = (
    LawParameter(
        "eccentricity", "Eccentricity of the orbit", "-",
        minimum=0.0, maximum=0.999, default=0.0, note="0 is a circle",
    ),
    LawParameter(
        "true_anomaly_deg", "True anomaly at time 0", "deg",
        minimum=-360.0, maximum=360.0, default=0.0, note="0 is the perigee",
    ),
    LawParameter(
        "inclination_deg", "Inclination of the orbit against the equator", "deg",
        minimum=0.0, maximum=180.0, default=0.0,
    ),
    LawParameter(
        "raan_deg", "Right ascension of the ascending node at time 0", "deg",
        minimum=-360.0, maximum=360.0, default=0.0,
    ),
    LawParameter(
        "argument_of_perigee_deg", "Argument of the perigee at time 0", "deg",
        minimum=-360.0, maximum=360.0, default=0.0,
    ),
)  # fmt: skip
