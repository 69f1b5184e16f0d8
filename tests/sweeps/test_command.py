"""The command `sweep`, as a user runs it."""

import signal
import subprocess
import time

import pyarrow.parquet
import pytest
from PIL import Image
from ros_harness import SWEEP

from tss_ros.core import compute_floquet
from tss_ros.scenarios import scenario


def run(*arguments):
    return subprocess.run([*SWEEP, *arguments], capture_output=True, text=True, timeout=120)


def rows(path):
    return pyarrow.parquet.read_table(path).to_pylist()


def test_map_of_damping_has_tables_picture_and_simulations(tmp_path):
    done = run(
        "three_star", "--parameter", "damping_n_s_per_m", "--values", "1450", "3000",
        "--critical", "-2.2", "-1.95", "--rates", "-2.6", "-2.4", "2",
        "--confirm", "12", "--output", str(tmp_path),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "DISAGREES" not in done.stdout
    assert done.stdout.count("simulated: ") == len(rows(tmp_path / "simulations")) >= 4
    first = {row["damping_n_s_per_m"]: row for row in rows(tmp_path / "critical_rates")[::-1]}
    assert first[1450.0]["cause"] == "first slack"
    assert first[1450.0]["spin_rate_ratio"] == pytest.approx(-2.171, abs=4e-3)  # closed form
    assert first[3000.0]["cause"] == "axis tilt"
    assert first[3000.0]["spin_rate_ratio"] == pytest.approx(-2.0, abs=2e-3)
    multipliers = rows(tmp_path / "multipliers")
    assert [row["spin_rate_ratio"] for row in multipliers] == [-2.6, -2.6, -2.4, -2.4] * 2
    frozen = [row for row in multipliers if row["method"] == "frozen"]
    assert len(frozen) == 4 and all(1.0 < row["max_modulus"] < 1.02 for row in frozen)
    with Image.open(tmp_path / "map.png") as picture:
        assert picture.size[0] > 1000
        assert len(picture.convert("L").getcolors()) > 10


def test_a_chart_over_gains_with_other_parameters_than_the_scenarios(tmp_path):
    gains, rest = [0.0, 1000.0], {"reel_stiffness_n_per_m": 0.5, "damping_n_s_per_m": 500.0}
    done = run(
        "three_star", "--rates", "-2.9", "-2.9", "1", "--methods", "monodromy",
        "--parameter", "reel_damping_n_s_per_m", "--values", *map(str, gains),
        "--override", *(f"{name}={value}" for name, value in rest.items()),
        "--output", str(tmp_path),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "reel_stiffness_n_per_m is 0.5, which has no effect unless" in done.stderr  # without c
    for row, gain in zip(rows(tmp_path / "multipliers"), gains, strict=True):
        system = scenario.load("three_star").build(rest | {"reel_damping_n_s_per_m": gain})
        assert row["deciding_modulus"] == compute_floquet(system, -2.9).deciding_modulus
    with Image.open(tmp_path / "map.png") as picture:
        assert len(picture.convert("L").getcolors()) > 10
    with_others = run("three_star", "--rates", "-2.9", "-2.9", "1", "--output", str(tmp_path))
    assert with_others.returncode == 1 and "holds another sweep" in with_others.stderr


def test_a_neutral_verdict_says_what_may_grow():
    done = run(
        "three_star", "--rates", "-2.9", "-2.9", "1", "--methods", "monodromy",
        "--override", "reel_damping_n_s_per_m=1000", "reel_stiffness_n_per_m=1e-7",
    )  # fmt: skip
    assert "neutral" in done.stdout and "the shape may grow: |rho| is 1.000" in done.stdout


def test_the_tether_law_is_varied_and_named(tmp_path):
    done = run(
        "three_star", "--parameter", "tether_law", "--values", "kelvin_voigt", "tension_only",
        "--rates", "-2.55", "-2.55", "1", "--critical", "-2.22", "-2.12", "--tolerance", "0.01",
        "--output", str(tmp_path),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "three_star tether_law=kelvin_voigt"
    for name in ("multipliers", "critical_rates"):
        found = rows(tmp_path / name)
        assert {row["tether_law"] for row in found} <= {"kelvin_voigt", "tension_only"}
    multipliers = [row for row in rows(tmp_path / "multipliers") if row["method"] == "monodromy"]
    assert [row["tether_law"] for row in multipliers] == ["kelvin_voigt", "tension_only"]
    assert multipliers[0]["pushing_share"] > 0.05 and multipliers[1]["pushing_share"] == 0.0
    assert f"pushing {multipliers[0]['pushing_share']:.1%}" in lines[1]
    with Image.open(tmp_path / "map.png") as picture:
        assert picture.size[0] > 1000


def test_families_are_tables_with_their_special_points(tmp_path):
    done = run(
        "three_star", "--parameter", "damping_n_s_per_m", "--values", "1000", "1450",
        "--follow", "-2.4", "-2.15", "--output", str(tmp_path),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    slack = {
        row["damping_n_s_per_m"]: row["parameter"]
        for row in rows(tmp_path / "special_points") if row["kind"] == "first slack"
    }  # fmt: skip
    assert slack == pytest.approx({1000.0: -2.307, 1450.0: -2.171}, abs=2e-3)  # closed form
    points = rows(tmp_path / "families")
    assert {row["damping_n_s_per_m"] for row in points} == set(slack)
    assert "first slack" in done.stdout and "family: " in done.stdout
    assert all(row["closure_residual"] < 1e-6 for row in points)


def test_the_law_is_named_where_another_parameter_is_varied():
    done = run(
        "three_star", "--parameter", "tether_length_m", "--values", "9e3",
        "--rates", "-2.6", "-2.6", "1", "--methods", "monodromy",
    )  # fmt: skip
    assert done.stdout.splitlines()[0] == "three_star tether_length_m=9000, kelvin_voigt"


def test_where_no_motion_is_found_the_reason_is_a_line_and_no_number_is_missing():
    done = run("double_pyramid")
    assert done.returncode == 0, done.stderr
    _, found, reason = done.stdout.splitlines()
    result = compute_floquet(scenario.load("double_pyramid").build(), -5.0, "frozen")
    assert found.split() == ["-5.0000", "none", "found", "(frozen", f"{result.max_modulus:.6f})"]
    assert reason.startswith(" " * 13 + "none found of the formation's own family: no motion")
    assert "; " not in reason


def test_the_frozen_method_says_why_it_found_nothing_beside_a_motion():
    done = run("lissajous")
    _, found, reason = done.stdout.splitlines()
    assert "neutral" in found and "by shape 1.000000" in found
    assert "frozen" not in found and "nan" not in done.stdout
    assert reason.strip().startswith("frozen none found: the given state is no equilibrium")


ELLIPSE = (
    "three_star", "--parameter", "eccentricity", "--values", "0", "0.05",
    "--rates", "-3", "-2.9", "2",
)  # fmt: skip


def test_a_method_nobody_asked_for_is_left_out_where_it_is_not_defined(tmp_path):
    done = run(*ELLIPSE, "--critical", "-2.2", "-2.15", "--output", str(tmp_path / "default"))
    assert done.returncode == 1
    found = [
        (row["eccentricity"], row["spin_rate_ratio"], row["method"])
        for row in rows(tmp_path / "default" / "multipliers")
    ]
    by_both = [(0.0, w, method) for w in (-3.0, -2.9) for method in ("monodromy", "frozen")]
    assert found == [*by_both, (0.05, -3.0, "monodromy"), (0.05, -2.9, "monodromy")]
    # Critical rates were asked for, and are not known on an ellipse: the only failure.
    assert "sweep: 1 of 8 jobs failed, first three_star eccentricity=0.05" in done.stderr
    assert rows(tmp_path / "default" / "critical_rates")[-1]["error"]
    assert done.stdout.splitlines()[-1] == (
        "  method frozen left out for 1 of 2 systems, first three_star eccentricity=0.05:"
        " the orbit is an ellipse of eccentricity 0.05"
    )


def test_what_is_left_out_is_no_failure_and_another_question_than_to_ask_for_it(tmp_path):
    done = run(*ELLIPSE, "--output", str(tmp_path))
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("(frozen ") == 2 and done.stdout.count("left out") == 1
    asked = run(*ELLIPSE, "--methods", "monodromy", "frozen")
    assert asked.returncode == 1 and "left out" not in asked.stdout
    assert "2 of 8 jobs failed" in asked.stderr and "method frozen needs forces" in asked.stderr
    other = run(*ELLIPSE, "--methods", "monodromy", "frozen", "--output", str(tmp_path))
    assert other.returncode == 1 and "holds another sweep: left out is" in other.stderr


@pytest.mark.parametrize(
    "arguments, status, named",
    [
        (("nowhere", "--rates", "-3", "-2", "2"), 1, "'nowhere'"),
        (
            ("three_sta",), 2,
            "chain_4 or the path of a .yaml file, got 'three_sta'; did you mean 'three_star'?",
        ),
        (("thee_star", "--rates", "-3", "-2", "2"), 1, "did you mean 'three_star'?"),
        (("three_star", "five_star"), 2, "own rates are three_star -2.5, five_star -5"),
        (("three_star", "--rates", "-3", "-2", "0"), 2, "COUNT is 0"),
        (("three_star", "--rates", "nan", "-2", "2"), 2, "--rates are nan to -2; allowed: finite"),
        (("--parameter", "mass", "--values", "1", "--rates", "-3", "-2", "2"), 1, "mass"),
        (("--parameter", "damping_n_s_per_m", "--rates", "-3", "-2", "2"), 2, "--values"),
        (("--parameter", "j2", "--values", "a", "--rates", "-3", "-2", "2"), 2, "--values of j2"),
        (
            ("--parameter", "tether_law", "--values", "tension", "--rates", "-3", "-2", "2"), 1,
            "did you mean 'tension_only'?",
        ),
        (("--override", "spin_rate_ratio=-3"), 1, "spin_rate_ratio is what the rates say"),
        (("--override", "j2=1", "--parameter", "j2", "--values", "0"), 1, "j2 is what is varied"),
        (("--override", "j3=1"), 1, "j3 is not a parameter of scenario 'three_star'"),
        (("--j2=1",), 2, "'--j2=1' is a parameter: --override j2=VALUE"),
        (("--critical", "-2", "-2"), 1, "must not be empty"),
        (("--critical", "-3", "-2", "--tolerance", "0"), 1, "tolerance"),
        (("--rates", "-3", "-2", "2", "--retry"), 2, "--retry needs --output"),
        (("--rates", "-3", "-2", "2", "--scheduler", "here"), 1, "scheduler is 'here'"),
        (("--rates", "-3", "-2", "2", "--scheduler", "a", "--workers", "2"), 2, "--workers are"),
    ],
)
def test_bad_command_lines_are_named(arguments, status, named):
    done = run(*arguments)
    assert done.returncode == status
    assert named in done.stderr
    assert "Traceback" not in done.stderr


def test_interrupted_it_shows_what_was_done(tmp_path):
    process = subprocess.Popen(
        [*SWEEP, "three_star", "--rates", "-9", "-2.3", "5000", "--output", str(tmp_path / "o")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        deadline = time.monotonic() + 60
        while not (tmp_path / "o").is_dir() and process.poll() is None:
            assert time.monotonic() < deadline
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 130, error
    assert "sweep: interrupted; " in error and "; the same command goes on from here" in error
    assert "asymptotically stable" in out or "interrupted; 0 of" in error
