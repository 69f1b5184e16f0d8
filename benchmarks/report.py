"""The benchmarks' results as Markdown tables and as a picture."""

import numpy as np

from benchmarks import problems
from benchmarks.references import stored
from benchmarks.solvers import FORMATION_MOTION, MOTION, OURS
from benchmarks.worker import solvers_of

FILE = "benchmarks.md"


def told(found):
    """One result in words, for the screen."""
    if "ms" not in found:
        error = (
            f", error {found['error']:.1e} at {found['tolerance']:.0e}" if "error" in found else ""
        )
        return found.get("note", "") + error
    matrix = f", matrix {found['matrix_error']:.0e}" if "matrix_error" in found else ""
    wrong = ", WRONG MATRIX" if found.get("wrong") else ""
    return (
        f"{found['ms']:10.2f} ms   error {found['error']:.0e}{matrix} at "
        f"{found['tolerance']:.0e}{wrong}   first answer {found['first_answer_s']:.1f} s"
    )


def _time(ms):
    return (
        f"{ms:.2f}" if ms < 10.0 else f"{ms:.3g}" if ms < 100.0 else f"{ms:,.0f}".replace(",", " ")
    )


def _counts(found):
    return "ms" in found and not found.get("wrong")


def _cell(found, best):
    if found is None:
        return ""
    if "ms" in found:
        if found.get("wrong"):
            return f"wrong: {found['matrix_error']:.0e}"
        text = _time(found["ms"])
        return f"**{text}**" if found["ms"] == best else text
    note = found.get("note", "")
    if note.startswith(">"):
        return note + (f", error {found['error']:.0e}" if "error" in found else "")
    if "not accurate" in note:
        return f"error {found['error']:.0e}"
    return "failed"


def _table(cases, events=True):
    """Rows are solvers, columns cases; the quickest of a column in bold."""
    names = list(dict.fromkeys(name for rows in cases.values() for name in rows))
    best = {
        case: min((f["ms"] for f in rows.values() if _counts(f)), default=None)
        for case, rows in cases.items()
    }
    lines = ["| solver | " + " | ".join(cases) + (" | switches located |" if events else " |")]
    lines.append("|---|" + "---:|" * len(cases) + ("---|" if events else ""))
    for name in names:
        cells = [_cell(rows.get(name), best[case]) for case, rows in cases.items()]
        located = next(solvers_of(c)[name].events for c, rows in cases.items() if name in rows)
        end = [("yes" if located else "no")] if events else []
        lines.append("| " + " | ".join([name, *cells, *end]) + " |")
    return lines


def _first_of(cases):
    """Who is first in each column, and by how much ours is ahead or behind the best other."""
    lines = []
    for case, rows in cases.items():
        times = {name: found["ms"] for name, found in rows.items() if _counts(found)}
        others = {name: ms for name, ms in times.items() if not name.startswith(OURS)}
        if not others or OURS not in rows:
            continue
        name = min(others, key=others.get)
        if OURS not in times:
            lines.append(f"* {case}: not solved to this error here; first is {name}")
            continue
        ratio = others[name] / times[OURS]
        lines.append(
            f"* {case}: "
            + (
                f"{ratio:.2g} times faster than the next, {name}"
                if ratio >= 1.0
                else f"{1.0 / ratio:.2g} times slower than {name}"
            )
        )
    return lines


def _machine(about):
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    return (
        f"*{about['date']}, {about['processor']}, {about['cores']} cores, Python"
        f" {about['python']};"
        f" load {about['load'][0]} before, {about['load_after'][0]} after, {about['took_s']:g} s;"
        f" {versions}.*"
    )


def _picked(results, name, chosen):
    cases = results.get(name, {}).get("cases", {})
    return {case: cases[case] for case in chosen if case in cases}


def _motion(results):
    short = _picked(results, "motion", problems.MOTIONS)
    laws = _picked(results, "motion", problems.LAW_MOTIONS)
    long = _picked(results, "motion", problems.LONG_MOTIONS)
    lines = [
        "## Motion",
        "",
        f"Milliseconds, warm, best of three or more runs, at an error of at most"
        f" {problems.MOTION_ERROR:g} of position over R_1 and of velocity over the rim speed, each"
        " solver at the loosest tolerance that reaches it. Table 1's ring, ten turns (B1 two),"
        " positions displaced by a s/|s|, s_i = sin(1 + i): A at -2.9 Omega with a = 0.05 m, B at"
        " -2.2 with a = 10 m and through slack/taut switches; the number is the damping C [N s/m]."
        " The 6-bead system has satellites of 1000 kg and 1450 N s/m, at -2.9 with 0.05 m.",
        "",
        *_table(short),
        "",
    ]
    if laws:
        lines += [
            "A1 and B1 with the Earth's oblateness, and in an orbit 400 km high with drag:",
            "",
            *_table(laws),
            "",
        ]
    if long:
        lines += [
            "3-star rings of so many beads in all (10 kg each, 1450 N s/m from end to end), a tenth"
            " of a turn at -2.9 Omega, pushed by 0.05 m:",
            "",
            *_table(long),
            "",
        ]
    lines += [*_first_of({**short, **laws, **long}), ""]
    if first := results["motion"].get("first_answer"):
        lines += ["| first answer of a fresh process [s], A100 | nothing compiled | cached |"]
        lines += ["|---|---:|---:|"]
        lines += [
            f"| {name} | {x['nothing_compiled_s']:.1f} | {x['s']:.1f} |"
            for name, x in first.items()
        ]
    return lines


def _formations(results):
    motions = _picked(results, "formations", problems.OTHER_MOTIONS)
    turns = _picked(results, "formations", problems.OTHER_TURNS)
    kept, nearest = stored(), {}
    for case in (*motions, *turns):
        distances = kept[case].get("matrix_distance", kept[case]["distance"])
        nearest[case] = min(value for name, value in distances.items() if name.startswith("ours"))
    told = ", ".join(f"{case} {distance:.0e}" for case, distance in nearest.items())
    return [
        "## Other formations and orbits",
        "",
        "Milliseconds as above, pushed as above. *chain*: four satellites that hang, two orbits"
        " (0.05 m, C = 1 N s/m). *pyramid*: the Earth-facing double pyramid of the scenarios, ten"
        " turns at 5 Omega (0.05 m, C = 100). *ellipse*: Table 1's ring on an orbit of eccentricity"
        " 0.1, ten turns at -2.9 (0.05 m, C = 100). *inclined J2*: the ring on an orbit inclined by"
        " 51.6 degrees that feels J2, two turns at -2.2 through slack/taut switches (10 m, C = 1)."
        " heyoka in inertial axes integrates the centre's orbit beside the beads and shares neither"
        " frames nor orbits nor forces with this package; CVODE and CyRK take its compiled"
        " equations. On orbits that are no circles this package has implicit steps only, which cost"
        " more than series where damping is weak and tethers switch often.",
        "",
        *_table(motions),
        "",
        "Monodromy matrices, undisturbed: of the chain at rest over an orbit, of a turn of the"
        " pyramid, of a hanging dumbbell's libration over an orbit of eccentricity 0.1 (C = 100),"
        " which is periodic, and of a turn of the inclined ring:",
        "",
        *_table(turns),
        "",
        *_first_of({**motions, **turns}),
        "",
        "Distance of this package's best run from heyoka in inertial axes with 80 bits, of motions"
        " as above, of matrices over their largest entry;"
        " `python -m benchmarks.references` computes it afresh: " + told + ".",
    ]


def _monodromy(results):
    cases = _picked(results, "monodromy", {**problems.TURNS, **problems.LONG_TURNS})
    lines = [
        "## Monodromy matrix over one turn",
        "",
        f"Milliseconds, warm, at an error of at most {problems.MODULUS_ERROR:g} in the largest"
        " modulus (relative where it exceeds 1) and a matrix within 1e-5 of the reference, relative"
        " to its largest entry. Undisturbed start (50)-(51); M at -2.9, S at -2.2 Omega. *wrong*:"
        " the error of the matrix where no tolerance mends it, for want of saltation.",
        "",
        *_table(cases),
        "",
        *_first_of(cases),
    ]
    return lines


def _ensemble(results):
    found = results["ensemble"]
    cases = found["cases"]
    lines = [
        f"## {found['count']} motions of the 3-star",
        "",
        "Motions a second of wall time / of processor time, one turn each, warm, every one"
        " disturbed another way by as much as in the cases above, at the loosest tolerance"
        " (of half decades)"
        f" at which nine of ten have an error of at most {problems.MOTION_ERROR:g}.",
        "",
        "| | " + " | ".join(cases) + " |",
        "|---|" + "---:|" * len(cases),
    ]
    for way in next(iter(cases.values())):
        cells = (
            f"{row[way]['per_s']:.0f} / {row[way]['per_processor_s']:.0f}"
            if "per_s" in row[way]
            else row[way]["note"]
            for row in cases.values()
        )
        lines.append("| " + " | ".join([way, *cells]) + " |")
    return lines


def _sweep(results):
    table = results["sweep"]
    lines = [
        "## Sweep",
        "",
        "200 spin rates of the 3-star from -3.5 to -1.5 Omega, each corrected to a periodic motion"
        " first (`core.sweep` with `FloquetJob`), warm:",
        "",
    ]
    for workers, row in table.items():
        if workers.isdigit():
            outcomes = ", ".join(f"{count} {name}" for name, count in row["outcomes"].items())
            lines.append(f"* {workers} at a time: {row['s']:.2f} s ({outcomes})")
    turns = _picked(results, "monodromy", problems.TURNS)
    for case in ("M2000", "S2000"):
        found = {
            name: row["ms"]
            for name, row in turns.get(case, {}).items()
            if _counts(row) and not name.startswith(OURS)
        }
        if found:
            name = min(found, key=found.get)
            lines.append(
                f"* the quickest other for one matrix of {case}, {name}: {_time(found[name])} ms,"
                f" so {0.2 * found[name]:.3g} s for 200 matrices, not run, without any correction"
            )
    return lines


def _middleware(results):
    lines = [
        "## What the middleware costs",
        "",
        "States a second at `time_scale` 0, one for each second of simulated time, five messages"
        " each; the ring of Table 1 and its tethers cut into beads, at -2.9 Omega.",
        "",
    ]
    table = {k: v for k, v in results["middleware"].items() if k.isdigit()}
    ways = list(next(iter(table.values())))
    lines += ["| | " + " | ".join(f"{beads} beads" for beads in table) + " |"]
    lines += ["|---|" + "---:|" * len(table)]
    for way in ways:
        cells = [f"{rows[way]['states_per_s']:.0f}" for rows in table.values()]
        lines.append("| " + " | ".join([way, *cells]) + " |")
    told = [f"{beads} beads: {rows['recorded']['recorder']}" for beads, rows in table.items()]
    return [*lines, "", "Recorded: " + "; ".join(told) + "."]


def _growth(results):
    lines = results["growth"].get("markdown", [])
    return ["## Growth with the number of beads", "", *lines]


def _recording(results):
    return ["## Recording", "", *(f"* {line}" for line in results["recording"]["lines"])]


PARTS = {
    "motion": _motion,
    "formations": _formations,
    "ensemble": _ensemble,
    "monodromy": _monodromy,
    "growth": _growth,
    "sweep": _sweep,
    "middleware": _middleware,
    "recording": _recording,
}


def write(results, folder):
    """Write benchmarks.md and benchmarks.png of what there is."""
    made = "Made by `make benchmarks`; the line below each section says of which run it is."
    lines = ["# Benchmarks", "", made, ""]
    if "motion" in results:
        others = results.get("formations", {}).get("cases", {})
        picture({**results["motion"]["cases"], **others}, folder / "benchmarks.png")
        lines += ["![Milliseconds of every solver](benchmarks.png)", ""]
    for name, part in PARTS.items():
        if name in results:
            lines += [*part(results), "", _machine(results[name]["machine"]), ""]
    (folder / FILE).write_text("\n".join(lines), encoding="utf-8")


def picture(cases, file):
    """Milliseconds of every solver that is accurate enough, a column for each case."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    cases = {c: cases[c] for c in (*problems.MOTIONS, *problems.OTHER_MOTIONS) if c in cases}
    figure, axes = plt.subplots(figsize=(11.0, 5.5), layout="constrained")
    shown = {**MOTION, **FORMATION_MOTION}
    colors = plt.colormaps["tab20"](np.arange(len(shown)) % 20)
    for (name, solver), color in zip(shown.items(), colors):
        points = [
            (k, rows[name]["ms"])
            for k, rows in enumerate(cases.values())
            if _counts(rows.get(name, {}))
        ]
        if not points:
            continue
        own = name.startswith(OURS)
        axes.plot(
            *np.transpose(points),
            "*" if own else "o" if solver.events else "x",
            label=name,
            color="black" if own else color,
            markersize=14 if own else 7,
            zorder=3 if own else 2,
        )
    axes.set_yscale("log")
    axes.set_xticks(range(len(cases)), list(cases))
    axes.set_ylabel(f"milliseconds at an error of {problems.MOTION_ERROR:g}")
    axes.grid(axis="y", which="both", alpha=0.25)
    axes.axvline(sum(case in problems.MOTIONS for case in cases) - 0.5, color="grey", linewidth=0.8)
    axes.set_title(
        "Ten turns of Table 1's ring (B1 two), other formations and orbits;"
        " crosses locate no slack/taut switches"
    )
    figure.legend(loc="outside right upper", fontsize=8)
    figure.savefig(file, dpi=120)
    plt.close(figure)
