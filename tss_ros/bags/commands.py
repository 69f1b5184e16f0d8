"""What a bag says, as text, figures and tables: executables `summary`, `plot` and `export`."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

from tss_ros import plots
from tss_ros.bags.recording import Recording, damage_in_words, read_bag
from tss_ros.bags.records import one_line
from tss_ros.command_line import Parser, say, show_progress, why_not_written
from tss_ros.core import TssError, in_words
from tss_ros.core.model.elements import why_not_autonomous
from tss_ros.core.model.feedback import acting_thrusts
from tss_ros.core.model.laws.feedback import THRUST_LIMIT
from tss_ros.core.model.laws.orbit import ELEMENTS
from tss_ros.core.model.laws.reel import REEL_MASS, REEL_TENSION
from tss_ros.core.model.reel_law import acting_reel_laws
from tss_ros.core.model.system import ORBIT_NORMAL
from tss_ros.core.presentation import turn_in_words
from tss_ros.core.stability.law_words import law_in_words, laws_in_words
from tss_ros.core.trajectory import FIGURES, TABLES
from tss_ros.plots.shape_words import reels_in_words
from tss_ros.scenarios.scenario import read_text

if TYPE_CHECKING:
    import pyarrow as pa

#: Most events of a run that are told.
MOST_EVENTS = 10


def summary(argv: Sequence[str] | None = None) -> int:
    """Executable `summary`; as all here: exit status 0, or 1 with one line why."""
    return _run(
        "summary", "Say what happened in a recording.", argv, lambda r, _: print(describe(r))
    )


def plot(argv: Sequence[str] | None = None) -> int:
    """Executable `plot`."""
    return _run("plot", "Draw the standard figures of a recording.", argv, _plot, _plot_options)


def export(argv: Sequence[str] | None = None) -> int:
    """Executable `export`."""
    text = "Write a recording as tables, or what it takes to simulate it again."
    return _run("export", text, argv, _export, _export_options)


def describe(recording: Recording) -> str:
    """What happened in a run, in a screenful.

    Parameters
    ----------
    recording : tss_ros.bags.recording.Recording

    Returns
    -------
    str
    """
    r, turns = recording, recording.turns
    gaps = int((np.diff(r.step) - 1).sum())
    lost = "not said" if r.lost is None else r.lost
    lines = [
        f"scenario      {r.scenario}: {r.is_satellite.sum()} satellites, {len(r.bead_name)} beads "
        f"in all, {len(r.tether_name)} tethers, {r.mass_kg.sum():g} kg",
        f"orbit         {r.orbit_altitude_m / 1e3:g} km high, Omega {r.orbit_rate_rad_s:.6g} rad/s"
        + "".join(f", {name} {value:g}" for name, value in _orbit(r).items())
        + (f", epoch {r.epoch}" if r.epoch else ""),
        _spin(r),
        f"tether law    {law_in_words(r.tether_law, r.pushing_share)}",
        f"disturbance   {r.disturbance_m:g} m, seed {r.disturbance_seed}",
        f"run           {r.run} of {r.runs} in the bag"
        + (f", topics {r.prefix}*" if r.prefix != "/" else ""),
        f"steps         {len(r.step)}, {r.step[0]} to {r.step[-1]}, {gaps} missing in between; "
        f"messages lost: {lost}",
        f"time          {r.t_s[0]:g} to {r.t_s[-1]:g} s, {turns[0]:.2f} to {turns[-1]:.2f} "
        f"{turn_in_words(r.spin_rate_ratio)}s",
    ]
    if not (finite := r.is_finite).all():
        lines.append(
            f"not finite    {(~finite).sum()} steps, the first is {r.step[~finite][0]}; what "
            "follows is of the others"
        )
    if finite.any():
        lines += _of_motion(r.only(finite))
    lines += [f"event         {kind}: {text}" for kind, text in r.events[:MOST_EVENTS]]
    if (others := len(r.events) - MOST_EVENTS) > 0:
        lines.append(f"events        ... {others} more")
    if r.changes:
        times = "once" if r.changes == 1 else f"{r.changes} times"
        lines.append(f"commands      what acts from outside changed {times}")
    for result in r.stability:
        verdict = result.verdict or result.message
        decided = (result.deciding_family, result.deciding_modulus, math.nan)
        by = f"by {words}, " if (words := in_words(*decided)) else ""
        lines.append(
            f"stability     {result.spin_rate_ratio:g} Omega: {verdict}, "
            f"{by}max |rho| {result.max_modulus:.6f}, "
            f"{law_in_words(result.tether_law, result.pushing_share)}"
        )
    for law in (r.system.law, *r.system.acting_laws):
        if law.parameters:
            values = (f"{p.name} {r.system.law_parameters[p.name]:g}" for p in law.parameters)
            lines.append(f"law           {law.name}: {', '.join(values)}")
    given = r.system.law_parameters
    if acting := acting_thrusts(r.system):
        values = [f"{p.name} {given[p.name]:g}" for law in acting for p in law.parameters]
        limit = given[THRUST_LIMIT.name]
        values.append(f"{THRUST_LIMIT.name} {limit:g}" if limit else "without a limit")
        lines.append(f"feedback      {', '.join(values)}")
    of_all = [p for p in (REEL_TENSION, REEL_MASS) if given[p.name] != p.default]
    for law in acting_reel_laws(r.system):
        values = (f"{p.name} {given[p.name]:g}" for p in (*law.parameters, *of_all))
        lines.append(f"reels         {law.name}: {', '.join(values)}")
    out_m = r.rests_m[r.rests_m > 0.0]  # neither cut nor on a reel
    if np.ptp(r.rests_m, axis=0).any() and out_m.size:
        lines.append(f"rest lengths  {out_m.min():.2f} to {out_m.max():.2f} m")
    if r.versions:
        lines.append(f"simulated by  {', '.join(r.versions)}")
    return "\n".join(map(one_line, lines))


def _orbit(r):
    """The elements of the orbit that are not 0, by name."""
    values = {p.name: r.system.law_parameters[p.name] for p in ELEMENTS}
    return {name: value for name, value in values.items() if value}


def _spin(r):
    """The line that says how the formation turns."""
    if not r.spin_rate_ratio:
        return f"spin          none: it hangs; one orbit {r.turn_s:.1f} s"
    line = f"spin          {r.spin_rate_ratio:g} Omega, one turn {r.turn_s:.1f} s"
    if np.array_equal(r.spin_axis, ORBIT_NORMAL):
        return line
    return f"{line}, about {np.array2string(r.spin_axis, precision=4, separator=', ')}"


def _of_motion(r):
    """Lines about steps whose numbers are all finite."""
    turns, slack, turn = r.turns, ~r.taut, turn_in_words(r.spin_rate_ratio)
    from_centre = np.abs(r.deviation_from_centre).max(axis=1)
    worst = np.unravel_index(np.abs(r.deviation).argmax(), r.deviation.shape)
    energy, centre_m = r.energy_j, r.centre_of_mass_m
    size = (
        f"deviation     at most {np.abs(r.deviation).max():.3g} ({r.bead_name[worst[1]]}, {turn} "
        f"{turns[worst[0]]:.2f}); from the centre of mass {from_centre.max():.3g}, "
        f"{from_centre[turns >= turns[-1] - 1].max():.3g} in the last {turn}"
    )
    if reels := reels_in_words(r.deviation_from_centre, r.rests_m):
        size = f"shape         {reels}"
    conserved = f"{energy[0]:.6g} to {energy[-1]:.6g} J"
    if reason := why_not_autonomous(r.system):
        conserved = f"none is conserved: {reason}, so that forces in the orbit frame depend on time"
    return [
        size,
        f"tethers       {r.length_m.min():.2f} to {r.length_m.max():.2f} m, "
        f"{r.tension_n.min():.3g} to {r.tension_n.max():.3g} N; slack in "
        f"{slack.any(axis=1).mean():.1%} of the steps",
        f"energy        {conserved}",
        f"mass centre   moved by at most {np.ptp(centre_m, axis=0).max():.3g} m along an axis",
    ]


def _run(name, description, argv, act, add_options=lambda parser: None):
    parser = Parser(prog=name, description=description)
    parser.add_argument("bag", type=Path, help="bag directory or .mcap file")
    parser.add_argument("--run", type=int, help="which run of a bag with several; default the last")
    add_options(parser)
    options = parser.parse_args(argv)
    try:
        recording = read_bag(options.bag, options.run, damaged=True)
        with np.errstate(all="ignore"):  # numbers that are not finite are named
            act(recording, options)
    except TssError as error:
        say(name, one_line(error))
        return 1
    except OSError as error:
        say(name, f"{error.filename!r} cannot be written: {error.strerror}")
        return 1
    return told_of_damage(name, options.bag, recording)


def told_of_damage(name: str, bag: Path, recording: Recording) -> int:
    """The exit status of a command that has read what is intact; if not all was, says so.

    Parameters
    ----------
    name : str
        Of the command.
    bag : Path
    recording : tss_ros.bags.recording.Recording

    Returns
    -------
    int
    """
    if recording.damage:
        damage = damage_in_words(recording.damage)
        print(
            f"{name}: {str(bag)!r} is damaged, and this is the rest; {one_line(damage)}",
            file=sys.stderr,
        )
    return 1 if recording.damage else 0


def _plot_options(parser):
    parser.add_output("--output", default=Path(), help="folder for the figures; default this one")
    parser.add_argument(
        "--format", choices=("png", "pdf", "svg"), default="png", help="default %(default)s"
    )


def _refuse_existing(folder, names, options):
    """Refuse, before the work, to replace what is in a folder."""
    for name in names:
        path = folder / name
        if path.exists() and (why := why_not_written(path, (path.suffix,), options.overwrite)):
            raise TssError(why)


def _plot(r, options):
    shown = [*FIGURES, *["stability"] * bool(r.stability)]
    modes = {f"mode_{result.spin_rate_ratio:g}": result for result in r.stability if result.mode}
    files = [f"{name}.{options.format}" for name in (*shown, *modes)]
    _refuse_existing(options.output, [*files, *(f"{name}.gif" for name in modes)], options)
    figures = {name: r.plot(name) for name in FIGURES}
    if r.stability:
        columns = ("spin_rate_ratio", "max_modulus", "max_modulus_nontrivial", "verdict")
        figures["stability"] = plots.stability(
            *([getattr(result, name) for result in r.stability] for name in columns),
            law=laws_in_words((result.tether_law, result.pushing_share) for result in r.stability),
            deciding_modulus=[result.deciding_modulus for result in r.stability],
        )
    options.output.mkdir(parents=True, exist_ok=True)
    modes = {name: plots.mode_of(result, r.spin_axis) for name, result in modes.items()}
    figures |= {name: plots.mode_shape(mode) for name, mode in modes.items()}
    for name, figure in figures.items():
        show_progress(f"drawing {name}")
        path = options.output / f"{name}.{options.format}"
        figure.savefig(path)
        show_progress("")
        print(path)
    for name, mode in modes.items():
        show_progress(f"drawing {name}, moving")
        path = options.output / f"{name}.gif"
        plots.animate(mode).save(path)
        show_progress("")
        print(path)


def _export_options(parser):
    kinds = parser.add_mutually_exclusive_group(required=True)
    for flag, text in (
        ("--csv", "tables run, beads, tethers and stability as CSV"),
        ("--parquet", "the same as Parquet"),
        (
            "--parameters",
            "parameters.yaml (for sim_node --ros-args --params-file) and scenario.yaml",
        ),
    ):
        parser.add_output(flag, group=kinds, metavar="FOLDER", help=text)


def _export(recording, options):
    if options.parameters:
        files = ("parameters.yaml", "scenario.yaml")
        _refuse_existing(options.parameters, files, options)
        write_parameters(recording, options.parameters)
        return
    import pyarrow.csv
    import pyarrow.parquet

    folder, write, ending = (
        (options.csv, pyarrow.csv.write_csv, "csv")
        if options.csv
        else (options.parquet, pyarrow.parquet.write_table, "parquet")
    )
    names = ("run", "beads", "tethers", "stability")
    _refuse_existing(folder, [f"{name}.{ending}" for name in names], options)
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in tables(recording).items():
        path = folder / f"{name}.{ending}"
        with path.open("wb") as stream:
            write(table, stream)
        print(path)


def tables(recording: Recording) -> dict[str, pa.Table]:
    """A recording as Arrow tables.

    `run` says in one row what was simulated; `beads` and `tethers` have a row per step and element,
    `stability` one per result.

    Parameters
    ----------
    recording : tss_ros.bags.recording.Recording

    Returns
    -------
    dict of str to pyarrow.Table
    """
    import pyarrow as pa

    r = recording

    def rows(table):
        columns, names = r.columns(table)
        element = TABLES[table]
        named = pa.DictionaryArray.from_arrays(pa.array(columns[element]), list(names))
        return pa.table(columns | {element: named})

    found = {
        "run": pa.table({name: [value] for name, value in _run_in_a_row(r).items()}),
        **{name: rows(name) for name in TABLES},
    }
    if r.stability:
        names = ("spin_rate_ratio", "max_modulus", "max_modulus_nontrivial", "verdict")
        names += ("deciding_modulus", "deciding_family", "tether_law", "pushing_share", "message")
        found["stability"] = pa.table({n: [getattr(s, n) for s in r.stability] for n in names})
    return found


def _run_in_a_row(r):
    names = ("scenario", "orbit_altitude_m", "orbit_rate_rad_s", "spin_rate_ratio", "disturbance_m")
    names += ("disturbance_seed", "publish_period_s", "tether_law", "pushing_share")
    return {**{name: getattr(r, name) for name in names}, **r.system.law_parameters}


def write_parameters(recording: Recording, folder: Path) -> None:
    """Write what it takes to simulate a run again.

    Parameters
    ----------
    recording : tss_ros.bags.recording.Recording
    folder : Path
        Takes `parameters.yaml`, for ``sim_node --ros-args --params-file``, and, if the scenario is
        not a shipped one, `scenario.yaml`.

    Raises
    ------
    TssError
        If the bag does not say.
    """
    if not recording.parameters:
        raise TssError("the bag does not carry the simulator's parameters")
    folder.mkdir(parents=True, exist_ok=True)
    laws = {"tether_law": recording.tether_law, **recording.law_parameters}
    parameters = {**recording.parameters, **laws}
    if not _is_unchanged(recording):
        path = folder.absolute() / "scenario.yaml"
        path.write_text(recording.scenario_yaml, encoding="utf-8")
        parameters["scenario"] = str(path)
        print(path)
    path = folder / "parameters.yaml"
    # JSON is YAML, and repeats every number bit for bit.
    path.write_text(json.dumps({"/**": {"ros__parameters": parameters}}, indent=1) + "\n")
    print(path)


def _is_unchanged(recording):
    """Whether the scenario's name still stands for the scenario that was simulated."""
    try:
        return yaml.safe_load(read_text(recording.scenario)) == yaml.safe_load(
            recording.scenario_yaml
        )
    except TssError:
        return False
