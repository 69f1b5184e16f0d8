"""A simulation straight into a bag is what the nodes would have recorded, and needs no ROS."""

import json
import os
import re
import subprocess
import sys

import pytest
import ros_harness
import yaml
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message

from tss_ros.bags import commands
from tss_ros.bags.recording import read_bag
from tss_ros.bags.verify import verify
from tss_ros.bags.wrenches import read_commands
from tss_ros.core import Cancelled, TssError
from tss_ros.core.motion import integrate
from tss_ros.ros.topics import message_class
from tss_ros.simulator import straight

RUN = {"turns": 0.5, "disturbance_m": 10.0, "disturbance_seed": 3, "publish_period_s": 2.0}
REELS = {"all": {"time_s": [0.0, 500.0], "length_m": [1000.0, 1200.0]}}
WORDS = [f"--{name.replace('_', '-')}={value}" for name, value in RUN.items()]


def contents(bag):
    """Messages, channels and schemas of a bag of one file."""
    (path,) = bag.glob("*.mcap")
    with path.open("rb") as stream:
        found = list(make_reader(stream).iter_messages(log_time_order=False))
    channels = {c.topic: (c.metadata, c.message_encoding, s) for s, c, _ in found}
    by_topic = {topic: [] for topic in channels}
    for schema, channel, message in found:
        data = deserialize_message(message.data, message_class(schema.name))
        by_topic[channel.topic].append((message.log_time, message.sequence, data))
    return by_topic, channels


@pytest.mark.parametrize(
    ("scenario", "in_bulk"), [("three_star", False), ("three_star", True), ("six_bead", True)]
)
def test_the_bag_is_the_one_that_the_recorder_writes(tmp_path, scenario, in_bulk):
    with ros_harness.processes(tmp_path) as start:
        logger = start("logger_node", output="bag", in_bulk=in_bulk)
        simulator = start(
            "sim_node", scenario=scenario, time_scale=0, wait_for_recorder=True, **RUN
        )
        assert simulator.wait(ros_harness.START_S) == 0, simulator.stderr
        assert logger.stop() == 0, logger.stderr
    assert straight.main([scenario, *WORDS, "--output", str(tmp_path / "own" / "bag")]) == 0
    (recorded, channels), (own, own_channels) = map(
        contents, (tmp_path / "bag", tmp_path / "own" / "bag")
    )
    assert own_channels == channels
    (described,), (of_own,) = recorded.pop("/system_description"), own.pop("/system_description")
    # The simulator has parameters more, of its pace and its graph.
    theirs, ours = (json.loads(d[2].parameters_json) for d in (described, of_own))
    assert ours.items() <= theirs.items()
    of_own[2].parameters_json = described[2].parameters_json
    assert of_own == described
    assert own == recorded and len(own["/markers"]) > 100
    whole, ours = (
        yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        for bag in (tmp_path / "bag", tmp_path / "own" / "bag")
    )
    for said in (ours, whole):  # a recorder in bulk loses blocks, not messages of each topic
        said["custom_data"] = {k: v for k, v in said["custom_data"].items() if "lost /" not in k}
    assert ours == whole
    assert not verify(tmp_path / "own" / "bag").faults


def test_it_needs_no_ros(tmp_path):
    hidden = "rclpy", "tss_interfaces", "std_msgs", "ament_index_python"
    program = (
        f"import sys; sys.modules.update(dict.fromkeys({hidden}))\n"
        "from tss_ros.simulator.straight import main; sys.exit(main())"
    )
    without = {k: v for k, v in os.environ.items() if k != "AMENT_PREFIX_PATH"}
    subprocess.run(
        [sys.executable, "-c", program, *WORDS, "--output", tmp_path / "bag"],
        check=True,
        env=without,
    )
    recording = read_bag(tmp_path / "bag")
    assert recording.disturbance_m == 10.0 and len(recording.step) > 500


def test_what_was_simulated_is_kept_when_it_ends_early(tmp_path, monkeypatch):
    monkeypatch.setattr(straight, "CHUNK_STEPS", 100)
    setup = straight.make_setup(straight.parse([*WORDS, "--output", "bag"]))
    shares = []
    with pytest.raises(Cancelled):
        straight.simulate(setup, 1.0, tmp_path / "bag", shares.append, lambda: len(shares) > 2)
    assert read_bag(tmp_path / "bag").step.tolist() == list(range(300))
    assert not verify(tmp_path / "bag").faults and shares[1] == pytest.approx(200 / 1262, abs=1e-3)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--turns", "0"], "--turns is 0; allowed: more than 0"),
        (["--turns", "nan"], "turns is nan; allowed"),
        (["--turns", "1", "--publish-period-s", "0"], "publish_period_s is 0.0; allowed"),
        (["--turns", "1", "--override", "mass=3,"], "'mass=3,' must be NAME=NUMBER"),
        (["--turn", "1", "--outputs", "x"], "did you mean '--output'"),
        (["--turns", "1", "--j2=0"], "'--j2=0' is a parameter: --override j2=VALUE"),
    ],
)
def test_wrong_words_are_refused(tmp_path, capsys, words, reason):
    with pytest.raises(SystemExit) as ended:
        straight.main([*words, "--output", str(tmp_path / "bag")])
    assert ended.value.code == 2 and reason in capsys.readouterr().err
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["three_stars", "--turns", "1"], "three_star"),
        (["--turns", "1", "--override", "satellite=4"], "did you mean 'satellites'? Allowed are"),
        (["--turns", "1", "--override", "reel_sample_s=4"], "it is a key of scenario files"),
        (["--turns", "1e6"], "allowed: at most 851237"),
    ],
)
def test_what_cannot_be_simulated_is_refused(tmp_path, capsys, words, reason):
    assert straight.main([*words, "--output", str(tmp_path / "bag")]) == 1
    assert reason in capsys.readouterr().err and not (tmp_path / "bag").exists()


def test_a_bag_that_exists_is_left_alone(tmp_path, capsys):
    (tmp_path / "bag").mkdir()
    assert straight.main([*WORDS, "--output", str(tmp_path / "bag")]) == 1
    assert "exists already" in capsys.readouterr().err
    with pytest.raises(TssError, match="exists already"):
        setup = straight.make_setup(straight.parse([*WORDS, "--output", "bag"]))
        straight.simulate(setup, 1.0, tmp_path / "bag")


def test_a_motion_that_cannot_go_on_is_in_the_bag_to_its_end(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(integrate, "MOST_SWITCHES_PER_TURN", 0)
    words = ["--turns", "4", "--disturbance-m", "300", "--disturbance-seed", "2"]
    words += ["--override", "spin_rate_ratio=-1.9", "--output", str(tmp_path / "bag")]
    assert straight.main(words) == 1
    end_s = float(re.search(r"tethers chatter at ([\d.e+]+) s", capsys.readouterr().err)[1])
    assert end_s - 2.0 < read_bag(tmp_path / "bag").t_s[-1] <= end_s


def test_an_event_comes_long_after_a_failure_that_changes_no_force(tmp_path, monkeypatch):
    monkeypatch.setattr(straight, "CHUNK_STEPS", 100)
    (tmp_path / "fails.yaml").write_text(
        "formation: ring\nspin_rate_ratio: -1.8\ndamping_n_s_per_m: 0.0\nfailures:\n"
        "  - {at_s: 13.0, dead: satellite_1}\n"
        "  - {when: {tether: tether_3, slack: true}, cut: tether_1}\n"
    )
    setup = straight.setup_of(str(tmp_path / "fails.yaml"), {}, RUN | {"disturbance_m": 0.0})
    straight.simulate(setup, 0.3, tmp_path / "bag")
    dead, cut = read_commands(tmp_path / "bag", setup.system)
    assert dead.time == 13 * 10**9 and not dead.commands.cut.any()
    assert cut.time > 400 * 10**9 and cut.commands.cut.tolist() == [True, False, False]


def test_a_summary_tells_what_failed_and_how_often_what_acts_changed(tmp_path, capsys):
    content = {"formation": "ring", "satellites": 6, "spin_rate_ratio": -2.9, "failures": []}
    for k in range(1, 7):
        content["failures"].append({"at_s": 2.0 * k, "dead": f"satellite_{k}"})
        content["failures"].append({"at_s": 2.0 * k + 1.0, "cut": f"tether_{k}"})
    (tmp_path / "fails.yaml").write_text(yaml.safe_dump(content))
    words = [str(tmp_path / "fails.yaml"), "--turns", "0.01", "--output", str(tmp_path / "bag")]
    assert straight.main(words) == 0 and commands.summary([str(tmp_path / "bag")]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("event")]
    assert len(lines) == 11 and lines[-1].split(maxsplit=1)[1] == "... 2 more"
    assert lines[0].split(maxsplit=1)[1] == "fail: satellite_1: dead at 2.000000000 s"
    assert lines[1].split(maxsplit=1)[1] == "cut: tether_1: cut at 3.000000000 s"
    told = commands.describe(read_bag(tmp_path / "bag"))
    assert "what acts from outside changed 12 times" in told


@pytest.mark.parametrize(
    ("content", "turns", "line"),
    [
        ({"deployed_m": 1e3, "reels": REELS}, 0.2, "shape         Reels move: radii are up to 1.2"),
        ({}, 0.01, "deviation     at most "),
        ({}, 0.01, "energy        23578.1 to "),
        (
            {"eccentricity": 0.1},
            0.01,
            "energy        none is conserved: the orbit is an ellipse of eccentricity 0.1,",
        ),
        (
            {"perturbations": ["j2"], "inclination_deg": 50.0},
            0.01,
            "energy        none is conserved: j2 acts on an orbit that is inclined by 50 degrees,",
        ),
    ],
)
def test_a_summary_says_what_is_true_of_reels_and_of_energy(tmp_path, content, turns, line):
    content = {"formation": "ring", "satellites": 3, "spin_rate_ratio": -2.5, **content}
    (tmp_path / "ring.yaml").write_text(yaml.safe_dump(content))
    words = [str(tmp_path / "ring.yaml"), "--turns", str(turns)]
    assert straight.main([*words, "--output", str(tmp_path / "bag")]) == 0
    told = commands.describe(read_bag(tmp_path / "bag")).splitlines()
    assert [said for said in told if said.startswith(line)], told
    shapes = [said for said in told if said.startswith(("shape", "deviation"))]
    assert len(shapes) == 1 and not [said for said in told if "nan" in said]
