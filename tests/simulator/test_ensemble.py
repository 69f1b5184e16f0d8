"""The command `ensemble`, as a user runs it: its table, its picture, its bags, its refusals."""

import shutil

import numpy as np
import pyarrow.parquet
import pytest
import ros_harness
from PIL import Image

from tss_ros.bags.recording import read_bag
from tss_ros.bags.verify import verify
from tss_ros.simulator import ensemble

WORDS = ["three_star", "--pushes", "10", "--turns", "1", "--publish-period-s", "2"]
ONE = [*WORDS, "--rates", "-2.5", "-2.5", "1", "--seeds", "16", "18"]


def run(folder, *words):
    return ensemble.main([*words, "--output", str(folder)])


def test_a_bag_is_what_the_simulator_publishes_with_that_seed(tmp_path):
    assert run(tmp_path / "own", *ONE, "--bags", "17") == 0
    with ros_harness.processes(tmp_path) as start:
        logger = start("logger_node", output="bag")
        simulator = start(
            "sim_node", spin_rate_ratio=-2.5, disturbance_m=10.0, disturbance_seed=17, turns=1.0,
            publish_period_s=2.0, time_scale=0, wait_for_recorder=True,
        )  # fmt: skip
        assert simulator.wait(ros_harness.START_S) == 0, simulator.stderr
        assert logger.stop() == 0, logger.stderr
    (bag,) = (tmp_path / "own" / "bags").iterdir()
    assert bag.name == "rate_-2.5_push_10_seed_17"
    own, recorded = read_bag(bag), read_bag(tmp_path / "bag")
    np.testing.assert_array_equal(own.position_m, recorded.position_m)
    np.testing.assert_array_equal(own.velocity_m_s, recorded.velocity_m_s)
    row = pyarrow.parquet.read_table(tmp_path / "own" / "motions").to_pylist()[1]
    assert row["disturbance_seed"] == 17 and row["held"]
    # Samples stand at other times, as dense as here.
    arms = recorded.position_m - np.mean(recorded.position_m, axis=1, keepdims=True)
    distance = np.linalg.norm(arms, axis=2)
    largest = np.max(np.abs(distance - distance[0])) / np.linalg.norm(distance[0], np.inf)
    assert row["deviation_from_centre"] == pytest.approx(largest, rel=0.01)


def test_the_bags_asked_for_are_written_once(tmp_path, capsys):
    words = [*WORDS, "--rates", "-2.5", "-1.5", "2", "--seeds", "0", "1", "--turns", "3"]
    assert run(tmp_path, *words, "--bags", "lost") == 0
    bags = {bag.name: bag for bag in (tmp_path / "bags").iterdir()}
    assert sorted(bags) == [f"rate_-1.5_push_10_seed_{seed}" for seed in (0, 1)]
    assert f"{tmp_path / 'bags'}: 2 bags" in capsys.readouterr().out
    before = {name: (bag / "metadata.yaml").stat().st_mtime_ns for name, bag in bags.items()}
    shutil.rmtree(bags.pop("rate_-1.5_push_10_seed_1"))
    assert run(tmp_path, *words, "--bags", "lost", "1") == 0
    names = sorted(bag.name for bag in (tmp_path / "bags").iterdir())
    assert names == [
        f"rate_{w}_push_10_seed_{k}" for w, k in (("-1.5", 0), ("-1.5", 1), ("-2.5", 1))
    ]
    (kept,) = bags.values()
    assert (kept / "metadata.yaml").stat().st_mtime_ns == before[kept.name]
    for bag in (tmp_path / "bags").iterdir():
        assert not verify(bag).faults
        recording = read_bag(bag)
        assert recording.disturbance_m == 10.0 and f"_{recording.spin_rate_ratio:g}_" in bag.name


def test_an_interrupted_bag_is_not_taken_for_a_whole_one(tmp_path):
    asked = ensemble.EnsembleQuestion("three_star", (-2.5, -2.5, 1), [10.0], (0, 0), 3)
    with ensemble.work.opened(asked, tmp_path) as store:
        ensemble.work.compute(asked, store)
        store.flush()
        told = iter([False] * 4)
        with pytest.raises(ensemble.Cancelled):
            ensemble.write_bags(
                asked, store, ["all"], tmp_path / "bags", publish_period_s=0.1, workers=1,
                cancelled=lambda: next(told, True),
            )  # fmt: skip
        assert list((tmp_path / "bags").iterdir()) == []
        assert ensemble.write_bags(asked, store, ["all"], tmp_path / "bags") == 1
        assert not verify(tmp_path / "bags" / "rate_-2.5_push_10_seed_0").faults


def test_the_screen_shows_probabilities_and_the_picture_their_curves(tmp_path, capsys):
    assert run(tmp_path, *WORDS, "--rates", "-2.4", "-2", "3", "--critical", "--turns", "3") == 0
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == "three_star, kelvin_voigt, 3 turns, seeds 0 to 99"
    by_rate = {line.split()[0]: line.split() for line in shown[2:5]}
    assert by_rate["-2.4"][1:6] == ["10", "100", "0", "0", "100.00%"]
    assert " ".join(by_rate["-2.4"][6:9]) == "96.30% to 100.00%"  # Wilson: 1 / (1 + z^2 / 100)
    critical = pyarrow.parquet.read_table(tmp_path / "critical_rates").to_pylist()
    assert critical[0]["spin_rate_ratio"] == pytest.approx(-2.171, abs=4e-3)  # closed form
    with Image.open(tmp_path / "map.png") as picture:
        assert picture.size[0] > 1000 and len(picture.convert("L").getcolors()) > 10


@pytest.mark.parametrize("rates", [("-2.5", "-2.5", "1"), ("-2.5", "-2.3", "2")])
def test_many_pushes_are_drawn_as_well(tmp_path, rates):
    pushes = [str(push) for push in (300, 5, 10, 20, 50, 100, 200)]
    words = [
        "three_star",
        "--rates",
        *rates,
        "--pushes",
        *pushes,
        "--seeds",
        "0",
        "1",
        "--turns",
        "1",
    ]
    assert run(tmp_path, *words) == 0
    with Image.open(tmp_path / "map.png") as picture:
        assert len(picture.convert("L").getcolors()) > 10


def test_of_very_many_pairs_the_screen_shows_what_they_come_to(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(ensemble, "MAX_LISTED", 0)
    assert run(tmp_path, *ONE) == 0
    assert capsys.readouterr().out.splitlines()[1:] == ["All of 3 disturbed motions held"]


def test_failures_are_counted_and_the_rest_is_shown(tmp_path, capsys):
    words = [*WORDS, "--rates", "-2.5", "0", "2", "--seeds", "0", "1"]
    assert run(tmp_path, *words) == 1
    shown = capsys.readouterr()
    assert "1 of 2 jobs failed, first three_star at 0, push 10 m, seeds 0 to 1:" in shown.err
    rows = [line.split() for line in shown.out.splitlines()[2:4]]
    assert [row[2:5] for row in rows] == [["2", "0", "0"], ["0", "0", "2"]]
    assert run(tmp_path, *words, "--bags", "all") == 1
    assert f"{tmp_path / 'bags'}: 2 bags" in capsys.readouterr().out
    assert sorted(bag.name for bag in (tmp_path / "bags").iterdir()) == [
        f"rate_-2.5_push_10_seed_{seed}" for seed in (0, 1)
    ]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--pushes", "10"], "--rates"),
        (["--rates", "-3", "-2", "2"], "--pushes"),
        (
            [*ONE, "--bags", "lots"],
            "--bags has 'lots'; allowed: lost, held, all, seeds from 16 to 18",
        ),
        ([*ONE, "--bags", "19"], "--bags has '19'; allowed"),
        ([*ONE, "--seeds", "1", "x"], "invalid int value: 'x'"),
        ([*ONE, "--publish-period-s", "0"], "publish_period_s is 0.0; allowed"),
        ([*ONE, "--override", "mass=3,"], "'mass=3,' must be NAME=NUMBER"),
        ([*ONE, "--rates", "-3", "-2", "1.5"], "COUNT is 1.5"),
        ([*ONE, "--bagz", "1"], "did you mean '--bags'"),
    ],
)
def test_wrong_words_are_refused(tmp_path, capsys, words, named):
    with pytest.raises(SystemExit) as ended:
        run(tmp_path / "out", *words)
    assert ended.value.code == 2 and named in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_bags_need_a_folder(capsys):
    with pytest.raises(SystemExit):
        ensemble.main([*ONE, "--bags", "all"])
    assert "--bags needs --output" in capsys.readouterr().err


def test_what_cannot_be_asked_is_refused(tmp_path, capsys):
    assert run(tmp_path / "out", *ONE, "--pushes", "0") == 1
    assert capsys.readouterr().err == "ensemble: push is 0 m; allowed: more than 0\n"
    assert not (tmp_path / "out").exists()
