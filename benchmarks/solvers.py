"""The motion of Table 1's ring by this package's integrator and by public ones, side by side.

Ten turns (B1 two) of a disturbed start, taut (A: rate -2.9, pushed by 0.05 m) and through
slack/taut switches (B: rate -2.2, 10 m), with damping of 1, 100 and 2000 N s/m. Every solver is
run at falling tolerances until its largest error, of position over R_1 and of velocity over the
rim speed, is below 1e-8; the time given is the best of three warm runs at that tolerance.

The reference is this package's integrator with nine stages at 1e-13, checked against heyoka's
Taylor method at 1e-18 with its events: their distance is printed and bounds what errors mean.
"""

import argparse
import json
import math
import time

import numpy as np

from tss_ros.core import State, forces, initial_state, ring
from tss_ros.core.motion import Flow

ENOUGH = 1e-8
GIVE_UP_S = 60.0
CASES = {
    f"{name}{damping}": (rate, float(damping), push, 2 if (name, damping) == ("B", 1) else 10)
    for name, rate, push in (("A", -2.9, 0.05), ("B", -2.2, 10.0))
    for damping in (1, 100, 2000)
}


class Problem:
    """One case: system, start and end time."""

    def __init__(self, rate, damping, push, turns):
        self.system = ring(damping_n_s_per_m=damping)
        self.spin = self.system.spin_rate_rad_s(rate)
        state = initial_state(self.system, rate)
        offset = np.sin(1.0 + np.arange(9))
        offset *= push / np.linalg.norm(offset)
        self.start = State(state.position_m + offset.reshape(3, 3), state.velocity_m_s)
        self.radius = np.linalg.norm(state.position_m[0])
        self.end_s = turns * 2.0 * math.pi / abs(self.spin)

    def distance(self, one, other):
        """Largest distance of two final states (positions, velocities), scaled."""
        return max(
            np.linalg.norm(one[0] - other[0], axis=1).max() / self.radius,
            np.linalg.norm(one[1] - other[1], axis=1).max() / (abs(self.spin) * self.radius),
        )

    def turning(self):
        """Start (18,) in the turning frame, velocities first."""
        r, v = self.start.position_m, np.array(self.start.velocity_m_s)
        v[:, 0] += self.spin * r[:, 1]
        v[:, 1] -= self.spin * r[:, 0]
        return np.concatenate([v.ravel(), r.ravel()])

    def from_turning(self, x):
        """Final state in the orbit frame, where all solvers meet; whole turns need no rotation."""
        v, r = np.array(x[:9]).reshape(3, 3), np.array(x[9:]).reshape(3, 3)
        return r, v + self.spin * np.stack([-r[:, 1], r[:, 0], np.zeros(3)], axis=1)


def ours(problem, tolerance, stages=7):
    """This package's integrator: Radau in the turning frame, switches located."""
    flow = Flow(problem.system, problem.spin, tolerance, problem.radius, stages=stages)

    def run():
        motion = flow.begin(problem.start)
        flow.advance(motion, problem.end_s)
        return problem.from_turning(np.concatenate([motion.v.ravel(), motion.r.ravel()]))

    return run


def heyoka(problem, tolerance):
    """heyoka's Taylor method in the orbit frame, slack and taut switches as terminal events."""
    import heyoka as hy

    system = problem.system
    names = [f"{kind}{axis}{i}" for kind in "vr" for i in range(3) for axis in "xyz"]
    symbol = dict(zip(names, hy.make_vars(*names)))
    rate, radius = system.orbit_rate_rad_s, system.orbit_radius_m
    mu = rate**2 * radius**3
    r = [[symbol[f"r{axis}{i}"] for axis in "xyz"] for i in range(3)]
    v = [[symbol[f"v{axis}{i}"] for axis in "xyz"] for i in range(3)]
    a = []
    for i in range(3):
        x, y, z = r[i]
        cube = (x * x + (y + radius) * (y + radius) + z * z) ** 1.5
        a.append(
            [
                rate**2 * x - mu * x / cube + 2.0 * rate * v[i][1],
                rate**2 * (y + radius) - mu * (y + radius) / cube - 2.0 * rate * v[i][0],
                -mu * z / cube,
            ]
        )
    excess = []
    for k, (i, j) in enumerate(system.tether_ends):
        d = [p - q for p, q in zip(r[i], r[j])]
        closing = sum(p * (q - s) for p, q, s in zip(d, v[i], v[j]))
        length = hy.sqrt(hy.sum([p * p for p in d]))
        rest = system.rest_length_m[k]
        pull = hy.par[k] * (
            system.axial_stiffness_n[k] / rest * (1.0 - rest / length)
            + system.damping_n_s_per_m[k] * closing / (length * length)
        )
        for axis in range(3):
            a[i][axis] = a[i][axis] - pull * d[axis] / system.mass_kg[i]
            a[j][axis] = a[j][axis] + pull * d[axis] / system.mass_kg[j]
        excess.append(length - rest)

    def toggle(k):
        def callback(integrator, direction):
            integrator.pars[k] = 1.0 if direction > 0 else 0.0
            return True

        return hy.t_event(excess[k], callback=callback, cooldown=0.0)

    equations = [
        (symbol[f"{kind}{axis}{i}"], rate_of[i][p])
        for kind, rate_of in (("v", a), ("r", v))
        for i in range(3)
        for p, axis in enumerate("xyz")
    ]
    start = np.concatenate(
        [problem.start.velocity_m_s.ravel(), problem.start.position_m.ravel()]
    )
    ends = problem.start.position_m[system.tether_ends]
    taut = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) > system.rest_length_m
    integrator = hy.taylor_adaptive(
        equations, start, pars=taut.astype(float), tol=tolerance,
        t_events=[toggle(k) for k in range(3)],
    )

    def run():
        integrator.time = 0.0
        integrator.state[:] = start
        integrator.pars[:] = taut
        while integrator.propagate_until(problem.end_s)[0] != hy.taylor_outcome.time_limit:
            pass
        state = np.array(integrator.state)
        return state[9:].reshape(3, 3), state[:9].reshape(3, 3)

    return run


def _right_hand_side(problem):
    """Turning frame, compiled; tethers switch by their length, as users without events do."""
    from numba import njit

    plant = forces.plant(problem.system, problem.spin)
    acceleration, stretch = forces.acceleration, forces.stretch

    @njit
    def derivative(t, x, out):
        v, r = x[:9].reshape(3, 3), x[9:].reshape(3, 3)
        excess, growth = np.empty(3), np.empty(3)
        stretch(plant, v, r, excess, growth)
        a = np.empty((3, 3))
        acceleration(plant, excess > 0.0, t, v, r, a)
        out[:9] = a.reshape(-1)
        out[9:] = x[:9]

    return derivative


def _scipy(method):
    def make(problem, tolerance):
        from scipy.integrate import solve_ivp

        derivative, start = _right_hand_side(problem), problem.turning()

        def right_hand_side(t, x):
            out = np.empty(18)
            derivative(t, x, out)
            return out

        def run():
            scale = np.repeat([abs(problem.spin) * problem.radius, problem.radius], 9)
            solution = solve_ivp(
                right_hand_side, (0.0, problem.end_s), start, method, rtol=tolerance,
                atol=tolerance * scale,
            )
            return problem.from_turning(solution.y[:, -1])

        return run

    return make


def sundials(problem, tolerance):
    """CVODE (scikit-sundae) in the turning frame, BDF, a switch of any tether as an event."""
    import sksundae

    derivative, start = _right_hand_side(problem), problem.turning()
    scale = np.repeat([abs(problem.spin) * problem.radius, problem.radius], 9)
    plant = forces.plant(problem.system, problem.spin)

    def right_hand_side(t, x, out):
        derivative(t, x, out)

    def lengths(t, x, events):
        growth = np.empty(3)
        forces.stretch(plant, x[:9].reshape(3, 3), x[9:].reshape(3, 3), events, growth)

    lengths.terminal = [True] * 3
    solver = sksundae.cvode.CVODE(
        right_hand_side, rtol=tolerance, atol=tolerance * scale, method="BDF",
        eventsfn=lengths, num_events=3, max_num_steps=1_000_000,
    )

    def run():
        now, x = 0.0, start
        while now < problem.end_s:
            solution = solver.solve(np.array([now, problem.end_s]), x)
            if solution.status < 0:
                raise RuntimeError(solution.message)
            now, x = solution.t[-1], solution.y[-1]
        return problem.from_turning(x)

    return run


TIGHTER = tuple(10.0**-k for k in range(6, 15))
SOLVERS = {
    "tss_ros": (ours, tuple(10.0**-k for k in range(5, 13))),
    "heyoka, events": (heyoka, tuple(10.0**-k for k in range(7, 17))),
    "CVODE BDF, turning frame, events": (sundials, TIGHTER),
    "scipy Radau, turning frame": (_scipy("Radau"), TIGHTER),
    "scipy DOP853, turning frame": (_scipy("DOP853"), TIGHTER),
}


def measure(solver, tolerances, problem, reference):
    """Best time of three runs, error and tolerance of the first tolerance that is enough."""
    for tolerance in tolerances:
        try:
            run = solver(problem, tolerance)
            begun = time.perf_counter()
            error = problem.distance(run(), reference)
            first = time.perf_counter() - begun
            if error <= ENOUGH:
                times = [first]
                for _ in range(3):
                    begun = time.perf_counter()
                    run()
                    times.append(time.perf_counter() - begun)
                return {"ms": 1e3 * min(times), "error": error, "tolerance": tolerance}
        except ModuleNotFoundError as missing:
            return {"note": f"not installed: {missing.name}"}
        except Exception as failure:
            return {"note": " ".join(str(failure).split())[:60]}
        if first > GIVE_UP_S:
            return {"note": f"> {1e3 * first:.0f} ms, error {error:.0e}"}
    return {"note": f"error {error:.0e} at best"}


def main():
    """Print the table and write it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", metavar="FILE")
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--solvers", nargs="+", default=list(SOLVERS), choices=list(SOLVERS))
    options = parser.parse_args()
    table = {}
    for case in options.cases:
        problem = Problem(*CASES[case])
        reference = ours(problem, 1e-13, stages=9)()
        try:
            apart = problem.distance(heyoka(problem, 1e-18)(), reference)
        except ModuleNotFoundError:
            apart = problem.distance(ours(problem, 1e-12, stages=8)(), reference)
        print(f"{case}: references agree to {apart:.0e}", flush=True)
        table[case] = {"references": apart}
        for name in options.solvers:
            found = table[case][name] = measure(*SOLVERS[name], problem, reference)
            told = found.get("note") or (
                f"{found['ms']:10.2f} ms   error {found['error']:.0e} at {found['tolerance']:.0e}"
            )
            print(f"    {name:34} {told}", flush=True)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(table, file, indent=1)


if __name__ == "__main__":
    main()
