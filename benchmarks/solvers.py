"""Every solver that is measured, by the name it has in the tables."""

from collections import namedtuple

from benchmarks import array_peers, heyoka_peer, peers, variations
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.shooting import integrate_turn

#: make(problem, tolerance, **options) gives a function that runs the case; events: whether it
#: locates slack/taut switches; loosest, tightest: exponents of the tolerances tried.
Solver = namedtuple("Solver", "make options events loosest tightest")


def ours(problem, tolerance, **options):
    """This package's integrator, as `core.motion.propagator.Integrator` with these options."""
    integrator = Integrator(problem.system, problem.spin, tolerance, problem.radius, **options)

    def run():
        motion = integrator.begin(problem.start)
        integrator.advance(motion, problem.end_s)
        run.switches = motion.switches
        return problem.from_turning([*motion.v.ravel(), *motion.r.ravel()])

    return run


def our_monodromy(problem, tolerance, segments=1, **options):
    """This package's monodromy matrix, `core.stability.shooting.integrate_turn`."""
    integrator = Integrator(problem.system, problem.spin, tolerance, problem.radius, **options)

    def run():
        found = integrate_turn(integrator, problem.start, segments=segments)
        run.switches = found.switches
        return found.matrix

    return run


def _peer(make, events=False, loosest=6, tightest=15, **options):
    return Solver(make, options, events, loosest, tightest)


OURS = "tss_ros"
MOTION = {
    OURS: Solver(ours, {}, True, 5, 13),
    "heyoka, orbit frame": _peer(heyoka_peer.motion, True, tightest=16),
    "heyoka, turning frame": _peer(heyoka_peer.motion, True, tightest=16, frame="turning"),
    "heyoka, high accuracy": _peer(heyoka_peer.motion, True, tightest=16, high_accuracy=True),
    "CVODE BDF": _peer(peers.cvode, True, 9),
    "CVODE Adams": _peer(peers.cvode, True, 9, method="Adams"),
    "CyRK Radau": _peer(peers.cyrk, loosest=8, method="Radau"),
    "CyRK DOP853": _peer(peers.cyrk, loosest=8, method="DOP853"),
    "scipy Radau, compiled": _peer(peers.scipy_compiled, loosest=8, method="Radau"),
    "scipy DOP853, compiled": _peer(peers.scipy_compiled, loosest=8, method="DOP853"),
    "scipy LSODA, compiled": _peer(peers.scipy_compiled, loosest=9, method="LSODA"),
    "diffrax Kvaerno5": _peer(array_peers.diffrax_motion, loosest=11, method="Kvaerno5"),
    "diffrax Dopri8": _peer(array_peers.diffrax_motion, loosest=9, method="Dopri8"),
    "CasADi CVODES": _peer(array_peers.casadi_motion, loosest=9),
    "scipy Radau, numpy": _peer(peers.scipy_numpy, loosest=9, method="Radau"),
    "scipy DOP853, numpy": _peer(peers.scipy_numpy, loosest=9, method="DOP853"),
    "scipy LSODA, numpy": _peer(peers.scipy_numpy, loosest=9, method="LSODA"),
}
LAW_MOTION = {
    name: MOTION[name]
    for name in (
        OURS,
        *(name for name in MOTION if name.startswith("heyoka")),
        *("CVODE Adams", "CyRK DOP853", "scipy DOP853, compiled"),
    )
}
ORBIT_MOTION = {
    OURS: MOTION[OURS],
    "heyoka, inertial": _peer(heyoka_peer.motion, True, tightest=16, frame="inertial"),
    **{name: MOTION[name] for name in ("CVODE BDF", "CyRK Radau", "CyRK DOP853")},
}
FORMATION_MOTION = {**ORBIT_MOTION, "heyoka, orbit frame": MOTION["heyoka, orbit frame"]}
LONG_MOTION = {
    OURS: MOTION[OURS],
    "CVODE BDF": MOTION["CVODE BDF"],
    "heyoka, orbit frame": _peer(heyoka_peer.motion, True, tightest=16, compact_mode=True),
    "scipy Radau, compiled": MOTION["scipy Radau, compiled"],
    "scipy LSODA, compiled": MOTION["scipy LSODA, compiled"],
}
MONODROMY = {
    OURS: Solver(our_monodromy, {}, True, 5, 13),
    "heyoka, variational": _peer(heyoka_peer.monodromy, True, tightest=15),
    "scipy LSODA, augmented": _peer(variations.augmented, method="LSODA"),
    "scipy Radau, augmented": _peer(variations.augmented, loosest=5, method="Radau"),
    "scipy DOP853, augmented": _peer(variations.augmented, method="DOP853"),
    "diffrax Kvaerno5": _peer(array_peers.diffrax_monodromy, method="Kvaerno5"),
    "CasADi CVODES, sensitivities": _peer(array_peers.casadi_monodromy, loosest=8),
    "differences, heyoka": _peer(variations.differences, True, 13, 15, motion=heyoka_peer.motion),
    "differences, CyRK Radau": _peer(
        variations.differences, False, 11, 14, motion=peers.cyrk, method="Radau"
    ),
}
ORBIT_MONODROMY = {
    OURS: MONODROMY[OURS],
    "heyoka, inertial, variational": _peer(heyoka_peer.monodromy, True, frame="inertial"),
    **{name: MONODROMY[name] for name in ("scipy LSODA, augmented", "scipy DOP853, augmented")},
}
FORMATION_MONODROMY = {
    **ORBIT_MONODROMY,
    **{name: MONODROMY[name] for name in ("heyoka, variational", "differences, CyRK Radau")},
}
LONG_MONODROMY = {
    OURS: MONODROMY[OURS],
    "scipy LSODA, augmented": MONODROMY["scipy LSODA, augmented"],
    "differences, CVODE BDF": _peer(variations.differences, True, 11, 14, motion=peers.cvode),
}
