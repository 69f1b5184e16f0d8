"""How many differently disturbed motions of the 3-star are carried through a turn in a second.

    python -m benchmarks.ensemble              # all, as JSON
    python -m benchmarks.ensemble FILE CASE NAME

The second form, used by the first, runs one solver on the motions in a file; each has a process of
its own. The loosest tolerance counts at which nine motions of ten are accurate enough: some of B1
magnify rounding itself beyond any solver in double precision. On a busy machine the motions in a
second of processor time stay about the same, those in a second of wall time do not.
"""

import json
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks import heyoka_peer, problems
from benchmarks.processes import ROOT, environment
from tss_ros.core import IntegrationError, State, initial_state
from tss_ros.core.motion.integrator import Integrator

CASES = ("A1", "B1")
COUNT, SEED = 1000, 13
#: Share of the motions that must be accurate.
SHARE = 0.9
#: [s] after which a solver is ended, and how many timed runs count the best of.
LIMIT_S, RUNS = 180.0, 7


def one_turn(case):
    """The problem of a case, ended after a turn."""
    problem = problems.Problem(case)
    problem.end_s /= problem.turns
    problem.turns = 1
    return problem


def starts(problem, case, count):
    """Starts (count, 2, n, 3) in the orbit frame, velocities first, each pushed another way."""
    random = np.random.default_rng(SEED)
    _, rate, push, _ = problems.CASES[case]
    around = initial_state(problem.system, rate)
    offset = random.normal(size=(count, problem.n, 3))
    offset *= push / np.linalg.norm(offset, axis=(1, 2), keepdims=True)
    x = np.repeat([[around.velocity_m_s, around.position_m]], count, axis=0)
    x[:, 1] += offset
    return x


def taut(problem, x):
    """Which tethers of each start are taut, shape (count, m)."""
    modes = []
    for v, r in x:
        problem.start = State(r, v)
        modes.append(problem.taut())
    return np.array(modes)


def ours(problem, tolerance, x, _):
    """This package's integrator, one motion after another."""
    integrator = Integrator(problem.system, problem.spin, tolerance, problem.radius)
    ends = np.empty_like(x)

    def run():
        for k, (v, r) in enumerate(x):
            motion = integrator.begin(State(r, v))
            integrator.advance(motion, problem.end_s)
            ends[k, 0], ends[k, 1] = motion.v, motion.r
        ends[:, 0, :, 0] -= problem.spin * ends[:, 1, :, 1]
        ends[:, 0, :, 1] += problem.spin * ends[:, 1, :, 0]
        return ends

    return run


def ours_at_once(problem, tolerance, x, _, threads=1):
    """This package's integrator, a call for each thread's share of the motions."""
    integrator = Integrator(problem.system, problem.spin, tolerance, problem.radius)
    shares = np.array_split(x, threads)

    def part(share):
        found = integrator.ends(share[:, 1], share[:, 0], problem.end_s)
        return np.stack([found.v, found.r], axis=1)

    def run():
        with ThreadPoolExecutor(threads) as pool:
            return np.concatenate(list(pool.map(part, shares)))

    return run


def _one(problem, tolerance, real=float):
    """heyoka's integrator of one motion."""
    import heyoka as hy

    equations, variables, switches = heyoka_peer.equations(problem, "orbit", real)

    def switched_to(k):
        def switched(integrator, direction):
            integrator.pars[k] = real(direction > 0)
            return True

        return hy.t_event(switches[k], callback=switched, fp_type=real)

    return hy.taylor_adaptive(
        equations,
        np.zeros(len(variables), dtype=real),
        pars=np.zeros(len(switches), dtype=real),
        tol=real(tolerance),
        fp_type=real,
        t_events=[switched_to(k) for k in range(len(switches))],
    )


def heyoka(problem, tolerance, x, modes, real=float):
    """heyoka, one motion after another."""
    integrator, flat = _one(problem, tolerance, real), x.reshape(x.shape[0], -1)
    ends = np.empty_like(flat)

    def run():
        for k in range(flat.shape[0]):
            integrator.reset_cooldowns()
            integrator.time = real(0.0)
            integrator.state[:] = flat[k]
            integrator.pars[:] = modes[k]
            integrator.propagate_until(real(problem.end_s))
            ends[k] = integrator.state
        return ends.reshape(x.shape)

    return run


def heyoka_ensemble(problem, tolerance, x, modes, threads):
    """heyoka's `ensemble_propagate_until`."""
    import heyoka as hy

    integrator, flat = _one(problem, tolerance), x.reshape(x.shape[0], -1)

    def begin(one, k):
        one.state[:] = flat[k]
        one.pars[:] = modes[k]
        return one

    def run():
        done = hy.ensemble_propagate_until(
            integrator, problem.end_s, flat.shape[0], begin, max_workers=threads
        )
        return np.array([one[0].state for one in done]).reshape(x.shape)

    return run


def _batch(problem, tolerance, lanes):
    """heyoka's integrator of so many motions side by side."""
    import heyoka as hy

    equations, variables, switches = heyoka_peer.equations(problem, "orbit", float)

    def switched_to(k):
        def switched(integrator, direction, lane):
            integrator.pars[k, lane] = direction > 0
            return True

        return hy.t_event_batch(switches[k], callback=switched)

    return hy.taylor_adaptive_batch(
        equations,
        np.zeros((len(variables), lanes)),
        pars=np.zeros((len(switches), lanes)),
        tol=tolerance,
        t_events=[switched_to(k) for k in range(len(switches))],
    )


def heyoka_batch(problem, tolerance, x, modes, lanes):
    """heyoka's batch mode."""
    integrator, flat = _batch(problem, tolerance, lanes), x.reshape(x.shape[0], -1)
    ends = np.empty_like(flat)

    def run():
        for k in range(0, flat.shape[0], lanes):
            integrator.reset_cooldowns()
            integrator.set_time(0.0)
            integrator.state[:] = flat[k : k + lanes].T
            integrator.pars[:] = modes[k : k + lanes].T
            integrator.propagate_until(problem.end_s)
            ends[k : k + lanes] = integrator.state.T
        return ends.reshape(x.shape)

    return run


def heyoka_batches(problem, tolerance, x, modes, lanes, threads):
    """heyoka's `ensemble_propagate_until_batch`."""
    import heyoka as hy

    integrator, flat = _batch(problem, tolerance, lanes), x.reshape(x.shape[0], -1)

    def begin(some, k):
        some.state[:] = flat[k * lanes : (k + 1) * lanes].T
        some.pars[:] = modes[k * lanes : (k + 1) * lanes].T
        return some

    def run():
        done = hy.ensemble_propagate_until_batch(
            integrator, problem.end_s, flat.shape[0] // lanes, begin, max_workers=threads
        )
        return np.concatenate([some[0].state.T for some in done]).reshape(x.shape)

    return run


#: Of every way its function, options, and exponents of the tolerances tried.
WAYS = {
    "tss_ros, one after another": (ours, {}, 3, 13),
    "tss_ros, in one call": (ours_at_once, {}, 3, 13),
    "tss_ros, in a call on each of 2 threads": (ours_at_once, {"threads": 2}, 3, 13),
    "heyoka, one after another": (heyoka, {}, 3, 16),
    "heyoka, ensemble on 1 thread": (heyoka_ensemble, {"threads": 1}, 3, 16),
    "heyoka, ensemble on 2 threads": (heyoka_ensemble, {"threads": 2}, 3, 16),
    "heyoka, batches of 4": (heyoka_batch, {"lanes": 4}, 3, 16),
    "heyoka, batches of 8": (heyoka_batch, {"lanes": 8}, 3, 16),
    "heyoka, ensemble of batches of 4 on 2 threads": (
        heyoka_batches, {"lanes": 4, "threads": 2}, 3, 16
    ),
}  # fmt: skip


def distances(problem, ends, exact):
    """Error of every motion, as `Problem.distance`."""
    apart = np.linalg.norm(ends - exact, axis=-1).max(axis=2)
    return np.max(apart / [problem.speed, problem.radius], axis=1)


def measure(file, case, name):
    """One way on the motions in a file."""
    heyoka_peer.keep_machine_code()
    make, options, loosest, tightest = WAYS[name]
    problem = one_turn(case)
    with np.load(file) as held:
        x, modes, exact = held["x"], held["taut"], held["ends"]
    for half in range(2 * loosest, 2 * tightest + 1):
        tolerance = 10.0 ** (-0.5 * half)
        run = make(problem, tolerance, x, modes, **options)
        try:
            errors = distances(problem, run(), exact)
        except IntegrationError:  # too loose a tolerance for one of them
            continue
        error = float(np.quantile(errors, SHARE))
        found = {"tolerance": tolerance, "error": error, "largest_error": float(errors.max())}
        if error <= problems.MOTION_ERROR:
            break
    else:
        return {**found, "note": "not accurate enough"}
    wall, processor = [], []
    for _ in range(RUNS):
        begun = time.perf_counter(), time.process_time()
        run()
        wall.append(time.perf_counter() - begun[0])
        processor.append(time.process_time() - begun[1])
    per_s = {"per_s": x.shape[0] / min(wall), "per_processor_s": x.shape[0] / min(processor)}
    return {**found, **per_s}


def reference(file, case, count):
    """Write starts and their ends by 80-bit arithmetic."""
    problem = one_turn(case)
    x = starts(problem, case, count)
    modes = taut(problem, x)
    ends = heyoka(problem, 1e-17, x.astype(np.longdouble), modes, np.longdouble)()
    np.savez(file, x=x, taut=modes, ends=ends.astype(float))


def main(count=COUNT):
    """Every way on every case, each in a process of its own."""
    cases = {case: {} for case in CASES}
    with tempfile.TemporaryDirectory() as folder:
        for case, table in cases.items():
            file = Path(folder) / f"{case}.npz"
            reference(file, case, count)
            for name in WAYS:
                command = [sys.executable, "-m", "benchmarks.ensemble", str(file), case, name]
                try:
                    done = subprocess.run(
                        command, cwd=ROOT, env=environment(), capture_output=True, text=True,
                        check=True, timeout=LIMIT_S,
                    )  # fmt: skip
                    table[name] = json.loads(done.stdout)
                except subprocess.TimeoutExpired:
                    table[name] = {"note": f"> {LIMIT_S:g} s"}
                except subprocess.CalledProcessError as failure:
                    table[name] = {"note": failure.stderr.strip().splitlines()[-1][:100]}
                print(f"    {case} {name}: {table[name]}", file=sys.stderr, flush=True)
    return {"count": count, "cases": cases}


if __name__ == "__main__":
    print(json.dumps(measure(*sys.argv[1:]) if len(sys.argv) > 2 else main()))
