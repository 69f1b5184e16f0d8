"""References in extended precision, kept in references.json since some take minutes.

    python -m benchmarks.references [--renew] [CASE ...]

computes them afresh, prints how far they are from the stored ones and from each other, and with
--renew stores them. Where heyoka's Taylor method in 80-bit arithmetic can do a case, the reference
is its run with tolerance 1e-18, beside one with 1e-15; otherwise this package's integrator with
nine stages beside CVODE, both as accurate as they go. This package's integrator is always beside.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from benchmarks import heyoka_peer, peers, problems, solvers

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
    turn = case in problems.TURNS or case in problems.LONG_TURNS
    long = case in problems.LONG_MOTIONS or case in problems.LONG_TURNS
    finest = {"stages": 9}
    if turn:
        others = {
            "ours 1e-13": solvers.our_monodromy(problem, 1e-13, **finest),
            "ours 1e-12, 3 segments": solvers.our_monodromy(problem, 1e-12, segments=3),
        }
        make, real = heyoka_peer.monodromy, {"real": np.longdouble}
    else:
        others = {"ours 1e-13": solvers.ours(problem, 1e-13, **finest)}
        make, real = heyoka_peer.motion, {"real": np.longdouble, "compact_mode": problem.n > 6}
    if long:
        best, source = others.pop("ours 1e-13")(), "ours, nine stages at 1e-13"
        if not turn:
            others["CVODE 1e-14"] = peers.cvode(problem, 1e-14)
    else:
        best, source = make(problem, 1e-18, **real)(), "heyoka, 80 bits, at 1e-18"
        others["heyoka, 80 bits, at 1e-15"] = make(problem, 1e-15, **real)
    kept = {"source": source}
    if turn:
        kept["modulus"] = problems.largest_modulus(best)
        if problem.n <= MATRIX_BEADS:
            kept["matrix"] = np.asarray(best, dtype=float).tolist()
    else:
        kept["position_m"], kept["velocity"] = (np.asarray(x, float).tolist() for x in best)
    kept["distance"] = {name: apart(problem, kept, run()) for name, run in others.items()}
    return kept


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
            STORED.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    if not agree:
        sys.exit("stored and fresh references disagree")


if __name__ == "__main__":
    main()
