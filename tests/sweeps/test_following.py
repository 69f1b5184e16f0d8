"""Families on disk, and the command `follow` as a user runs it."""

import contextlib
import dataclasses
import json
import os
import pickle
import pty
import signal
import subprocess
import sys

import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest
from paper import tension
from PIL import Image
from released_pair import SCENARIO
from scipy.optimize import brentq

from tss_ros.core import FamilyJob, TssError, follow, follow_special, ring, sweep
from tss_ros.plots import special_curves
from tss_ros.sweeps import families

FOLLOW = [
    sys.executable, "-c",
    "import sys; from tss_ros.sweeps.following import main; sys.exit(main())",
]  # fmt: skip


def run(*arguments):
    command = [*FOLLOW, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


@pytest.fixture(scope="module")
def past_first_slack():
    return follow(ring(), "spin_rate_ratio", -2.2, -2.14)


def same(a, b):
    """Whether two results, or what they are made of, are equal bit for bit."""
    if dataclasses.is_dataclass(a):
        fields = dataclasses.fields(a)
        return type(a) is type(b) and all(
            same(getattr(a, f.name), getattr(b, f.name)) for f in fields
        )
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return np.array_equal(a, b, equal_nan=not isinstance(a, str))


def test_a_family_is_the_same_after_it_was_saved_and_loaded(past_first_slack, tmp_path):
    file = tmp_path / "family.parquet"
    families.save(past_first_slack, file, {"scenario": "three_star"})
    assert same(families.load(file), past_first_slack)
    assert families.load_about(file) == {"scenario": "three_star"}
    assert list(tmp_path.iterdir()) == [file]


def test_a_curve_of_special_points_is_saved_loaded_and_drawn(past_first_slack, tmp_path):
    (slack,) = (point for point in past_first_slack.special if point.kind == "first slack")
    curve = follow_special(ring(), "spin_rate_ratio", slack, "damping_n_s_per_m", 1430.0)
    file = tmp_path / "curve.parquet"
    families.save(curve, file)
    assert same(families.load_curve(file), curve)
    read, own = pd.read_parquet(file), pd.DataFrame(curve.columns()).drop(columns="multiplier")
    pd.testing.assert_frame_equal(read[own.columns], own)
    (axes,) = special_curves([curve]).axes
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), own.parameter)
    with pytest.raises(TssError, match="holds a curve of special points, not a family"):
        families.load(file)


def test_a_branch_is_followed_from_a_saved_family(tmp_path):
    pair = ["tether_length_m=1000", "axial_stiffness_n=5e5", "damping_n_s_per_m=500"]
    common = ["chain", "--override", "satellites=2", *pair]
    file = tmp_path / "family.parquet"
    assert run(*common, "--from", 1.3, "--to", 1.2, "--output", file).returncode == 0
    branch = [*common, "--from", 1.4, "--to", 1.2, "--start", file, "--branch", 1.24]
    done = run(*branch, "--output", tmp_path / "branch.parquet")
    assert done.returncode == 0, done.stderr
    points = families.load(tmp_path / "branch.parquet").points
    assert points[0].parameter == pytest.approx(1.24207, abs=1e-3)
    assert abs(points[-1].state.velocity_m_s[0, 2]) > 0.5
    bad = run(*common, "--from", 1.4, "--to", 1.2, "--branch", 1.24)
    assert bad.returncode == 2 and "--branch needs --start" in bad.stderr


def test_other_programs_read_the_points(past_first_slack, tmp_path):
    families.save(past_first_slack, tmp_path / "family.parquet")
    read = pd.read_parquet(tmp_path / "family.parquet")
    own = pd.DataFrame(past_first_slack.columns())
    pd.testing.assert_frame_equal(read[own.columns], own)
    point = past_first_slack.points[0]
    np.testing.assert_array_equal(read.multiplier_imag[0], point.multiplier.imag)
    np.testing.assert_array_equal(read.position_m[0], point.state.position_m.ravel())


def test_families_are_jobs_of_a_sweep_that_can_be_sent_elsewhere(past_first_slack):
    jobs = [FamilyJob(ring(), "spin_rate_ratio", -2.2, stop) for stop in (-2.2, -2.14)]
    outcomes = dict(sweep(pickle.loads(pickle.dumps(jobs)), workers=2))
    assert "must not be empty" in str(outcomes[0])
    assert same(pickle.loads(pickle.dumps(outcomes[1])), past_first_slack)


def test_what_is_no_family_is_refused(tmp_path):
    with pytest.raises(TssError, match="none.parquet' cannot be read: No such file"):
        families.load(tmp_path / "none.parquet")
    (tmp_path / "text.parquet").write_text("text")
    with pytest.raises(TssError, match="text.parquet' cannot be read"):
        families.load(tmp_path / "text.parquet")
    pyarrow.parquet.write_table(pyarrow.table({"a": [1]}), tmp_path / "other.parquet")
    with pytest.raises(TssError, match="other.parquet' is a Parquet table that holds no family"):
        families.load(tmp_path / "other.parquet")


def test_a_family_is_shown_saved_drawn_and_gone_on_with(tmp_path):
    file, picture = tmp_path / "family.parquet", tmp_path / "family.png"
    done = run(
        "three_star", "--from", "-2.3", "--to", "-2.14", "--output", file, "--plot", picture
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("three_star, spin_rate_ratio from -2.3 to -2.14, kelvin_voigt, ")
    assert "asymptotically stable" in lines[1] and " taut " in lines[1] and " slack " in lines[4]
    special, spin = families.load(file).special
    assert f"first slack at {special.parameter:.9g} +- " in lines[2]
    assert f"spin divergence at {spin.parameter:.9g} +- " in lines[3]
    edge = brentq(tension, -2.4, -1.9, args=(1450.0,))
    assert special.kind == "first slack" and special.parameter == pytest.approx(edge, abs=1e-3)
    about = families.load_about(file)
    assert about["scenario"] == "three_star" and "satellites: 3" in about["scenario_yaml"]
    with Image.open(picture) as image:
        assert image.size[0] > 1000 and len(image.convert("L").getcolors()) > 10

    back = run("three_star", "--from", "-2.14", "--to", "-2.2", "--start", file)
    assert back.returncode == 0, back.stderr
    (line,) = (line for line in back.stdout.splitlines() if "first slack" in line)
    found = float(line.split(" at ")[1].split()[0])
    assert found == pytest.approx(special.parameter, abs=4 * special.uncertainty)


def test_other_parameters_are_followed_at_a_rate_with_overrides():
    arguments = ("--parameter", "damping_n_s_per_m", "--from", "1400", "--to", "1500")
    done = run("three_star", *arguments, "--override", "tether_length_m=9e3", "satellites=3")
    assert done.returncode == 0, done.stderr
    first, part = done.stdout.splitlines()
    assert "damping_n_s_per_m from 1400 to 1500 at spin_rate_ratio -2.5," in first
    assert part.split()[0] == "1400" and part.split()[2] == "1500"


def test_a_scenario_with_velocities_is_a_start(tmp_path):
    (tmp_path / "own.yaml").write_text(SCENARIO)
    done = run(tmp_path / "own.yaml", "--from", "-3e0", "--to", "-29e-1")
    assert done.returncode == 0, done.stderr
    assert "asymptotically stable" in done.stdout


@pytest.mark.parametrize(
    "arguments, status, named",
    [
        (("--from", "-3"), 2, "--to"),
        (("--from", "-3", "--to", "-3"), 1, "must not be empty"),
        (("--from", "-3", "--to", "3"), 1, "must keep its sign"),
        (("--from", "-3", "--to", "nan"), 1, "nan"),
        (("--from", "-3", "--to", "-2", "--step", "0"), 1, "longest_step"),
        (("--from", "-3", "--to", "-2", "--points", "0"), 2, "--points is 0"),
        (("--from", "-3", "--to", "-2", "--rate", "-2"), 2, "--rate needs another --parameter"),
        (("--from", "-3", "--to", "-2", "--output", "a.csv"), 2, "allowed: .parquet"),
        (("--from", "1", "--to", "2", "--parameter", "mass"), 1, "satellite_mass_kg"),
        (("--from", "1", "--to", "2", "--parameter", "bead_mass_kg"), 1, "no such bead"),
        (("--from", "-3", "--to", "-2", "--override", "colour=3"), 1, "colour"),
        (("--from", "-3", "--to", "-2", "--override", "j2=a"), 2, "NAME=NUMBER"),
        (("nowhere", "--from", "-3", "--to", "-2"), 1, "'nowhere'"),
        (("--from", "-3", "--to", "-2", "--start", "none.yaml"), 1, "No such file"),
        (("--from", "-3", "--to", "-2", "--start", "none.parquet"), 1, "No such file"),
    ],
)
def test_bad_command_lines_are_named(arguments, status, named):
    done = run(*arguments)
    assert done.returncode == status, done.stderr
    assert named in done.stderr and "Traceback" not in done.stderr and done.stdout == ""


def at_rest(position_m):
    return {"position_m": position_m, "velocity_m_s": [[0.0] * 3] * len(position_m)}


@pytest.mark.parametrize(
    "content, named",
    [
        (at_rest([[0, 1, 0]]), "position_m has 3 numbers; allowed: 9"),
        (at_rest([[0, 1, "a"]] * 3), "position_m must be numbers"),
        ({"position_m": []}, "lacks velocity_m_s"),
        (at_rest([[0, 1, float("inf")]] * 3), "position_m holds inf; allowed: finite numbers"),
        # satellites that stand still where no tether holds them turn round nothing
        (at_rest([[0, 100, 0], [50, 0, 0], [0, -200, 0]]), "no motion to follow was found"),
    ],
)
def test_a_start_that_leads_to_no_motion_is_refused(content, named, tmp_path):
    (tmp_path / "start.json").write_text(json.dumps(content))
    done = run("three_star", "--from", "-3", "--to", "-2", "--start", tmp_path / "start.json")
    assert done.returncode == 1 and named in done.stderr, done.stderr
    assert "Traceback" not in done.stderr


def test_it_shows_how_far_it_is_and_interrupted_keeps_what_was_found(tmp_path):
    file = tmp_path / "family.parquet"
    command = ["three_star", "--from", "-9", "--to", "-2.3", "--step", "1e-4", "--output", file]
    terminal, error = pty.openpty()
    process = subprocess.Popen(
        [*FOLLOW, *map(str, command)], stdout=subprocess.PIPE, stderr=error, text=True
    )
    os.close(error)
    shown = ""
    try:
        while " points in " not in shown:  # what comes first, an end of the process, is an error
            shown += os.read(terminal, 1000).decode()
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(OSError):  # the end of what it shows
            while True:
                shown += os.read(terminal, 1000).decode()
        out, _ = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
        os.close(terminal)
    assert process.returncode == 130, shown
    assert "%, -" in shown and "follow: canceled at -" in shown and "asymptotically stable" in out
    family = families.load(file)
    assert family.ended.startswith("canceled at -") and 1 <= len(family.points) < 2000
