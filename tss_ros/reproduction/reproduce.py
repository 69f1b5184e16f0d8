"""The paper, figure by figure: recordings, pictures, and a report that judges every claim.

What is done is kept: an interrupted run goes on where it stopped, and another one only makes what
the package's sources have changed since.
"""

import hashlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tss_ros.bags.recording import Recording, read_bag
from tss_ros.command_line import Parser
from tss_ros.reproduction import (
    claims,
    loose_tolerance,
    motions,
    pages,
    paper_figures,
    pulling,
    report,
    verdicts,
)
from tss_ros.runs.processes import record, run_command, watched_nodes

PACKAGE = Path(__file__).parent.parent
#: Enough for a printed page; the vector pictures have no such limit.
PNG_DPI = 140
DISTURBANCES_M = (0.001, 0.1, 10.0, 1000.0)
TOLERANCES = (1e-4, 1e-6, 1e-8)


@dataclass(frozen=True)
class Figure:
    """One figure of the paper.

    Attributes
    ----------
    needs : tuple of str
        Items that it is drawn from.
    draw : callable
        Returns the matplotlib figure, given a `Workshop`.
    """

    needs: tuple
    draw: Callable


def _of_motions(draw, *motions):
    return Figure(
        tuple(f"motion {name}" for name in motions),
        lambda work: draw([work.recording(name) for name in motions]),
    )


def _of_curves(*names):
    kinds = ("curve", "boundaries", "pulling")
    needs = [f"{kind} {name}" for name in names for kind in kinds]
    return Figure(
        tuple(needs),
        lambda work: paper_figures.multipliers(
            [
                (
                    claims.TITLES[name],
                    claims.CRITICAL[name],
                    verdicts.critical(work.result(f"boundaries {name}")),
                    verdicts.pulling_row(work.result, work.damping, name)["held"],
                    work.result(f"curve {name}"),
                )
                for name in names
            ]
        ),
    )


def _of_one(motion):
    return _of_motions(lambda recordings: paper_figures.orbit(recordings[0]), motion)


FIGURES = {
    3: _of_one("figure_03"),
    4: _of_one("figure_04"),
    5: _of_curves("three_star"),
    6: _of_one("figure_06"),
    7: _of_one("figure_07"),
    8: _of_motions(paper_figures.deviations, "figure_06", "figure_07"),
    9: _of_curves("three_star_50kg", "three_star_1000kg"),
    10: _of_motions(paper_figures.formation, "figure_10_2.5", "figure_10_2.9"),
    11: _of_motions(paper_figures.formation, "figure_11_1.5", "figure_11_2.2"),
    13: _of_curves("six_bead"),
    14: _of_motions(paper_figures.views, "figure_14_1.5", "figure_14_2.2"),
    15: _of_motions(paper_figures.distances_and_lengths, "figure_14_1.5", "figure_14_2.2"),
}
#: Pictures that belong to the report alone.
EXTRA = {
    "table_1": Figure((), lambda work: paper_figures.table(report.table_1(work.damping))),
    "critical_rates": Figure(
        tuple(f"{kind} {name}" for kind in ("scan", "pulling") for name in claims.STARS),
        lambda work: paper_figures.critical_rates(
            {claims.TITLES[name]: work.result(f"scan {name}") for name in claims.STARS},
            {claims.TITLES[name]: work.result(f"pulling {name}") for name in claims.STARS},
            {claims.TITLES[name]: claims.CRITICAL[name] for name in claims.STARS},
        ),
    ),
    "six_bead_2.9": _of_motions(paper_figures.distances_and_lengths, "six_bead_2.9"),
}
#: Numbers that belong to the report alone, by item.
EXPLORATIONS = (
    *(f"claimed {name}" for name in claims.CRITICAL),
    "fates",
    "none beyond",
    "six beads",
    *(f"disturbances {name}" for name in claims.STARS),
    "tolerances",
)


class Workshop:
    """The folder of results: makes what is missing, remembers what it was made from.

    Parameters
    ----------
    output : Path
    caught : list of int
        Signals that came in; the work ends at the first.
    """

    def __init__(self, output: Path, caught: list[int]) -> None:
        self._output, self._caught = output, caught
        sources = sorted([*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.yaml")])
        digest = hashlib.sha256(b"".join(path.read_bytes() for path in sources))
        self._made_from = digest.hexdigest()
        for folder in (output, output / "numbers", output / "bags"):
            folder.mkdir(parents=True, exist_ok=True)

    @property
    def damping(self) -> float:
        """The damping [N s/m] identified from the claim for Table 1."""
        return self.result("damping")["three_star"]["damping"]

    def make(self, items: Sequence[str]) -> None:
        """Make every item that is not done, in order, and print how far things are."""
        begun = time.monotonic()
        for count, item in enumerate(items, 1):
            if self._caught:
                raise KeyboardInterrupt
            start = time.monotonic()
            print(f"[{count}/{len(items)}] {item} ...", end="", flush=True)
            done = self._is_done(item)
            if not done:
                result = self._work(item)
                made = {"made_from": self._made_from, "result": result}
                self.write(self._file(item), json.dumps(made))
            spent = "done before" if done else f"{time.monotonic() - start:.1f} s"
            print(f" {spent}", flush=True)
        print(f"all done in {time.monotonic() - begun:.0f} s: {os.path.relpath(self._output)}")

    def result(self, item: str) -> Any:
        """The numbers of an item that is done."""
        return json.loads(self._file(item).read_text(encoding="utf-8"))["result"]

    def recording(self, motion: str) -> Recording:
        """The Recording of one of `claims.MOTIONS`."""
        return read_bag(self._bag(motion))

    def write(self, path: Path, content: str | bytes) -> None:
        """Write a whole file, or none."""
        content = content.encode() if isinstance(content, str) else content
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            try:
                file.write(content)
                file.flush()
                os.chmod(file.name, 0o644)
                os.replace(file.name, path)
            except BaseException:
                os.unlink(file.name)
                raise

    def _file(self, item):
        return self._output / "numbers" / f"{item.replace(' ', '_')}.json"

    def _bag(self, motion):
        return self._output / "bags" / motion

    def _pictures(self, item):
        name = f"figure_{item[7:].zfill(2)}" if item.startswith("figure ") else item[8:]
        return [self._output / f"{name}.{suffix}" for suffix in ("png", "pdf")]

    def _is_done(self, item):
        try:
            made_from = json.loads(self._file(item).read_text(encoding="utf-8"))["made_from"]
        except (OSError, ValueError, KeyError):
            return False
        kind, _, name = item.partition(" ")
        needed = {"motion": [self._bag(name) / "metadata.yaml"]}.get(kind, [])
        if kind in ("figure", "picture"):
            needed = self._pictures(item)
        return made_from == self._made_from and all(path.exists() for path in needed)

    def _work(self, item):
        kind, _, name = item.partition(" ")

        def cancelled():
            return bool(self._caught)

        if kind == "damping":
            return claims.identify_damping(cancelled)
        if kind == "motion":
            return self._record(name, cancelled)
        if kind == "figure":
            return self._draw(item, FIGURES[int(name)])
        if kind == "picture":
            return self._draw(item, EXTRA[name])
        damping = self.damping
        dampings = sorted({1.0, *claims.DAMPINGS, *self._identified()})
        return {
            "curve": lambda: claims.curve(name, damping, cancelled),
            "boundaries": lambda: claims.boundaries(name, damping, -3.5, -1.9, cancelled),
            "pulling": lambda: pulling.critical_rates(
                name,
                (damping,) if name == "six_bead" else sorted({*pulling.DAMPINGS, damping}),
                () if name == "six_bead" else (damping,),
                cancelled,
            ),
            "claimed": lambda: pulling.at_claim(name, damping, cancelled),
            "scan": lambda: claims.damping_scan(name, dampings[1:], cancelled),
            "fates": lambda: {
                motion: motions.fates_by_damping(
                    claims.MOTIONS[motion],
                    (100.0, damping, 5000.0) if motion.startswith("figure_14") else dampings,
                    cancelled,
                )
                for motion, held, *_ in claims.FATES
                if self.result(f"motion {motion}")["held"] != held
            },
            "none": lambda: claims.none_beyond("three_star_50kg", (0.0, *dampings), cancelled),
            "six": lambda: [
                [
                    c,
                    claims.boundaries("six_bead", c, -3.5, -2.0, cancelled),
                    claims.simulated_edges("six_bead", c, cancelled, which=("held",))["held"],
                ]
                for c in (100.0, damping, 5000.0)
            ],
            "disturbances": lambda: [
                [size, claims.simulated_edges(name, damping, cancelled, disturbance_m=size)]
                for size in DISTURBANCES_M
            ],
            "tolerances": lambda: loose_tolerance.held_edges(
                claims.STARS, damping, TOLERANCES, cancelled
            ),
        }[kind]()

    def _identified(self):
        return [found["damping"] for found in self.result("damping").values() if found["damping"]]

    def _record(self, name, cancelled):
        motion = claims.MOTIONS[name]
        of = claims.system(motion.scenario, self.damping)
        turn_s = of.period_s(motion.rate)
        shutil.rmtree(self._bag(name), ignore_errors=True)
        with tempfile.TemporaryDirectory(prefix=".motion.", dir=self._output) as scratch:
            logs, bag = Path(scratch), Path(scratch) / "bag"
            watched = watched_nodes("reproduce", logs, self._caught, lambda *_: None)
            with watched as (nodes, ros_node, watch):
                recording = record(
                    nodes,
                    ros_node,
                    watch,
                    bag,
                    scenario=motion.scenario,
                    damping_n_s_per_m=self.damping,
                    spin_rate_ratio=motion.rate,
                    turns=float(motion.turns),
                    publish_period_s=turn_s / claims.SAMPLES_PER_TURN,
                    disturbance_m=motion.disturbance_m,
                    disturbance_seed=claims.SEED,
                )
            result = motions.outcome(of, motion, recording, cancelled)
            result["pulling"] = pulling.instead(motion, self.damping, cancelled)
            bag.rename(self._bag(name))
        return result

    def _draw(self, item, figure):
        drawn = figure.draw(self)
        names = []
        for path in self._pictures(item):
            fresh = path.with_name(f".{path.name}")
            drawn.savefig(fresh, format=path.suffix[1:], dpi=PNG_DPI)
            os.replace(fresh, path)
            names.append(path.name)
        return names


def plan(figures: Sequence[int]) -> list[str]:
    """Items to make, in order, for some figures, or for all and the report where none is given."""
    items = ["damping"]
    for number in figures or FIGURES:
        items += [*FIGURES[number].needs, f"figure {number}"]
    if not figures:
        items += EXPLORATIONS
        for name, picture in EXTRA.items():
            items += [*picture.needs, f"picture {name}"]
    return list(dict.fromkeys(items))


def make(output: Path, figures: Sequence[int], caught: list[int]) -> None:
    """Make the figures, and the report when all are asked for.

    Parameters
    ----------
    output : Path
    figures : sequence of int
        Keys of `FIGURES`; empty for all and the report.
    caught : list of int
        Signals that came in; the work ends at the first.

    Raises
    ------
    KeyboardInterrupt, Cancelled
        If a signal came in.
    TssError
        If a node fails.
    """
    work = Workshop(output.resolve(), caught)
    work.make(plan(figures))
    if not figures:
        text = report.markdown(work.result, work.damping)
        work.write(output / "reproduction.md", text)
        work.write(output / "reproduction.html", pages.html(text, output))
        print(os.path.relpath(output / "reproduction.html"))


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `reproduce`.

    Returns
    -------
    int
        Exit status: 0, 1 if something failed, 2 for a wrong command line, 128 + n when ended by
        signal n.
    """
    parser = Parser(prog="reproduce", description=__doc__)
    parser.add_argument(
        "--figure",
        nargs="+",
        action="extend",
        default=[],
        metavar="N",
        help=f"only these figures, without the report: {_allowed()}",
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("runs/reproduction"),
        help="folder for the results (default %(default)s)",
    )
    options = parser.parse_args(argv)
    for number in options.figure:
        if number not in map(str, FIGURES):
            parser.exit(2, f"reproduce: figure is {number!r}; allowed: {_allowed()}\n")
    figures = sorted(set(map(int, options.figure)))
    return run_command("reproduce", lambda caught: make(options.output, figures, caught))


def _allowed():
    return ", ".join(map(str, FIGURES))
