"""One command that measures everything: `make benchmarks`, or in an activated shell

    tss bench [--only motion formations ensemble monodromy growth sweep middleware recording]

writes benchmarks.json, benchmarks.md and benchmarks.png; sections that are not measured now keep
what benchmarks.json says of them.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks import problems, report
from benchmarks.processes import ROOT, environment, machine, measured, peers_python
from benchmarks.worker import solvers_of
from tss_ros.command_line import Parser

SECTIONS = (
    *("motion", "formations", "ensemble", "monodromy"),
    *("growth", "sweep", "middleware", "recording"),
)
#: Sections that compare solvers case by case.
COMPARED = {
    "motion": (*problems.MOTIONS, *problems.LAW_MOTIONS, *problems.LONG_MOTIONS),
    "formations": (*problems.OTHER_MOTIONS, *problems.OTHER_TURNS),
    "monodromy": (*problems.TURNS, *problems.LONG_TURNS),
}
#: Case whose first answer in a fresh process is measured, and by whom.
FIRST_CASE, FIRST = "A100", ("tss_ros", "heyoka, orbit frame")
#: Compiling all of the integrator afresh takes minutes on a busy machine.
COMPILE_S = 600.0


def show(text):
    """Print a line at once."""
    print(text, flush=True)


def compare(python, cases, options):
    """Every solver on every case: results by case and solver."""
    table = {}
    for case in cases:
        show(f"{case}:")
        table[case] = {}
        for name in solvers_of(case):
            if options.solvers and name not in options.solvers:
                continue
            found = table[case][name] = measured(python, case, name, options.limit)
            show(f"    {name:30} {report.told(found)}")
    return table


def first_answers(python):
    """Seconds from the start of a process to its first answer, with nothing compiled and after."""
    table = {}
    for name in FIRST:
        with tempfile.TemporaryDirectory() as empty:
            cold = measured(
                python, FIRST_CASE, name, COMPILE_S, BENCHMARKS_COLD="1", NUMBA_CACHE_DIR=empty
            )
        measured(python, FIRST_CASE, name, COMPILE_S)
        warm = measured(python, FIRST_CASE, name, COMPILE_S)
        table[name] = {
            "nothing_compiled_s": cold.get("first_answer_s"),
            "s": warm.get("first_answer_s"),
        }
        show(f"    {name:30} first answer {table[name]}")
    return table


def section(name, python, options):
    """Measure one section."""
    wanted = options.cases or list(problems.CASES)
    if name in COMPARED:
        cases = [case for case in COMPARED[name] if case in wanted]
        found = {"cases": compare(python, cases, options)}
        return found | ({"first_answer": first_answers(python)} if name == "motion" else {})
    own = {"middleware": sys.executable, "recording": sys.executable}
    module = {"sweep": "sweeping"}.get(name, name)
    if not (ROOT / "benchmarks" / f"{module}.py").is_file():
        return None
    env = environment(ROS_DOMAIN_ID=os.environ.get("ROS_DOMAIN_ID", "101"))
    if name in own:  # these need the activated shell's own paths
        env["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [own.get(name, python), "-m", f"benchmarks.{module}"],
        cwd=ROOT,
        env=env,
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        raise SystemExit(f"{name} ended with status {done.returncode}")
    return json.loads(done.stdout)


def main():
    """Measure the sections asked for, and write the three files after each."""
    parser = Parser(prog="bench", description="Measure everything beside public solvers.")
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=SECTIONS)
    parser.add_argument("--cases", nargs="+", choices=problems.CASES, metavar="CASE")
    parser.add_argument("--solvers", nargs="+", metavar="NAME", help="of the tables' names")
    parser.add_argument("--limit", type=float, default=60.0, help="[s] for a solver on a case")
    parser.add_argument("--output", type=Path, default=ROOT / "runs" / "benchmarks", metavar="DIR")
    options = parser.parse_args()
    python = peers_python()
    options.output.mkdir(parents=True, exist_ok=True)
    file = options.output / "benchmarks.json"
    results = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    for name in options.only:
        show(f"{name}:")
        about, begun = machine(python), time.monotonic()
        found = section(name, python, options)
        if found is None:
            continue
        about["load_after"] = machine(python)["load"]
        about["took_s"] = round(time.monotonic() - begun, 1)
        partial = name in COMPARED and (options.cases or options.solvers)
        if partial and name in results:
            for case, rows in found["cases"].items():
                results[name]["cases"].setdefault(case, {}).update(rows)
            results[name]["machine"] = about
        else:
            results[name] = {**found, "machine": about}
        file.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
        report.write(results, options.output)
    show(f"written: {options.output / 'benchmarks.md'}")


if __name__ == "__main__":
    main()
