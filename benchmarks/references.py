"""References in extended precision, kept in references.json since some take minutes.

    python -m benchmarks.references [--renew] [CASE ...]

computes them afresh, prints how far they are from the stored ones and from each other, and with
--renew stores them. The reference is heyoka's Taylor method in 80-bit arithmetic at tolerance
1e-18, beside its run at 1e-15 and this package's integrator; of other formations and orbits in
inertial axes, beside the centre's orbit. Beads in the tethers are too stiff for it: there it is
this package's integrator with nine stages, beside CVODE and Radau.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from benchmarks import heyoka_peer, peers, problems, solvers, variations

STORED = Path(__file__).with_name("references.json")
#: Largest system whose matrix is stored.
MATRIX_BEADS = 6
#: Two references further apart than this do not count as agreeing.
AGREE = {"motion": 1e-9, "modulus": 1e-7}


def stored():
    """What references.json holds, by case."""
    return json.loads(STORED.read_text(encoding="utf-8")) if STORED.is_file() else {}


def compute(case):
    """The reference of a case and its distances from others."""
    problem = problems.Problem(case)
    turn = case in problems.ALL_TURNS
    elsewhere = {**problems.OTHER_MOTIONS, **problems.OTHER_TURNS}
    ours = solvers.our_monodromy if turn else solvers.ours
    finest = ours(problem, 1e-13, stages=9)
    others = {}
    if turn:
        others["ours 1e-12, 3 segments"] = ours(problem, 1e-12, segments=3)
    if problem.n == 3 or case in elsewhere:
        make = heyoka_peer.monodromy if turn else heyoka_peer.motion
        kind = {"frame": "inertial"} if case in elsewhere else {}
        wide = {"real": np.longdouble, **kind}
        source = ", ".join(("heyoka", *kind.values(), "80 bits, 1e-18"))
        best = make(problem, 1e-18, **wide)()
        others["heyoka, 80 bits, 1e-15"] = make(problem, 1e-15, **wide)
        others["ours, nine stages, 1e-13"] = finest
    else:
        best, source = finest(), "ours, nine stages, 1e-13"
        if not turn:
            others["CVODE 1e-14"] = peers.cvode(problem, 1e-14)
            others["scipy Radau 1e-12"] = peers.scipy_compiled(problem, 1e-12, "Radau")
        elif problem.n <= MATRIX_BEADS:
            others["scipy Radau 1e-9"] = variations.augmented(problem, 1e-9, "Radau")
    kept = {"source": source}
    if turn:
        kept["modulus"] = problems.largest_modulus(best)
        if problem.n <= MATRIX_BEADS:
            kept["matrix"] = np.asarray(best, dtype=float).tolist()
    else:
        kept["position_m"], kept["velocity"] = (np.asarray(x, float).tolist() for x in best)
    found = {name: run() for name, run in others.items()}
    kept["distance"] = {name: apart(problem, kept, result) for name, result in found.items()}
    if "matrix" in kept:
        kept["matrix_distance"] = {
            name: matrices_apart(result, kept["matrix"]) for name, result in found.items()
        }
    return kept


def matrices_apart(matrix, reference):
    """Largest difference of two matrices, over the largest entry of the second."""
    exact = np.array(reference)
    return float(np.abs(matrix - exact).max() / np.abs(exact).max())


def apart(problem, reference, result):
    """Distance of a result from a reference: of motions, or of largest moduli."""
    if "modulus" not in reference:
        return problem.distance(result, (reference["position_m"], reference["velocity"]))
    wanted = reference["modulus"]
    return abs(problems.largest_modulus(result) - wanted) / max(1.0, wanted)


def main():
    """Print distances; end with status 1 if stored and fresh disagree."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", metavar="CASE", default=list(problems.CASES))
    parser.add_argument("--renew", action="store_true", help="store what was computed")
    options = parser.parse_args()
    agree = True
    for case in options.cases:
        kept, fresh = stored(), compute(case)
        told = [f"{name} {distance:.1e}" for name, distance in fresh["distance"].items()]
        more = fresh.get("matrix_distance", {})
        told += [f"matrix of {name} {distance:.1e}" for name, distance in more.items()]
        if case in kept and not options.renew:
            if "modulus" in fresh:
                change = abs(fresh["modulus"] - kept[case]["modulus"])
                change, most = change / max(1.0, fresh["modulus"]), AGREE["modulus"]
            else:
                both = ((x["position_m"], x["velocity"]) for x in (kept[case], fresh))
                change, most = problems.Problem(case).distance(*both), AGREE["motion"]
            agree = agree and change <= most
            told.append(f"stored {change:.1e}")
        print(f"{case}: {fresh['source']}; distances: {', '.join(told)}", flush=True)
        if options.renew:
            kept[case] = fresh
            lines = [f"{json.dumps(name)}: {json.dumps(row)}" for name, row in kept.items()]
            STORED.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    if not agree:
        sys.exit("stored and fresh references disagree")


if __name__ == "__main__":
    main()
