"""Reels in scenario files: what they say, and what is refused."""

import numpy as np
import pytest

from tss_ros.core import TssError
from tss_ros.scenarios import scenario
from tss_ros.simulator.straight import setup_of

RING = "formation: ring\nspin_rate_ratio: -2.9\nbeads_per_tether: 1\n"
RUN = {"publish_period_s": 1.0, "disturbance_m": 0.0, "disturbance_seed": 0, "turns": 0.0}


def written(tmp_path, text):
    path = tmp_path / "reels.yaml"
    path.write_text(RING + text)
    return str(path)


def test_lengths_are_given_for_all_or_by_name_or_by_a_profile(tmp_path):
    file = written(
        tmp_path,
        "deployed_m: {all: 3000, tether_2: 6000}\n"
        "reels:\n  tether_1: {time_s: [5, 9], length_m: [3000, 3001]}\n",
    )
    loaded = scenario.load(file)
    lengths, profiles = loaded.reels.of(loaded.build())
    assert lengths.tolist() == [3000.0, 6000.0, 3000.0]
    assert list(profiles) == [0] and profiles[0].time_s == (5.0, 9.0)
    file = written(tmp_path, "reels:\n  tether_3: {time_s: [0, 9], length_m: [400, 401]}\n")
    loaded = scenario.load(file)
    assert loaded.reels.of(loaded.build())[0].tolist() == [10e3, 10e3, 400.0]


def test_a_run_begins_at_the_steady_state_of_what_is_out(tmp_path):
    setup = setup_of(written(tmp_path, "deployed_m: 3000\n"), {}, RUN)
    first, second = (setup.start.position_m[ends] for ends in setup.system.tether_ends.T)
    length_m = np.linalg.norm(first - second, axis=1)
    # The reel is at the first satellite of each tether: its segment there is not out.
    assert (length_m[::2] == 0.0).all()
    np.testing.assert_allclose(length_m[1::2], 3000.0, rtol=1e-3)
    assert (setup.tension_n[1::2] > 0.0).all() and not setup.tension_n[::2].any()
    assert setup.commands.at(0).reel[:, 1].tolist() == [3000.0] * 3


@pytest.mark.parametrize("text, said", [
    ("deployed_m: -1", "deployed_m of all must be greater than 0, got -1"),
    ("deployed_m: 0.01", "deployed length of tether_1 must be at least 0.1 m"),
    ("deployed_m: {tether_9: 5}", "tether is 'tether_9'; allowed: tether_1, tether_2, tether_3"),
    ("deployed_m: long", "deployed_m of all must be a number, got 'long'"),
    ("reels: [1, 2]", "reels must be a mapping of tethers, or all, to profiles, got"),
    ("reels: {all: {time_s: [0, 1]}}", "length_m"),
    ("reels: {all: {time_s: [0, 1], length_m: 5}}", "length_m must be a list of numbers, got 5"),
    ("reels: {all: {time_s: [1, 1], length_m: [5, 6]}}", "time_s must increase"),
    ("reels: {all: {time_s: [-1, 1], length_m: [5, 6]}}", "time_s must be at least 0, got -1"),
    ("reels: {all: {time_s: [0, 1], length_m: [5]}}", "length_m must have as many values"),
    ("deployed_m: 7\nreels: {all: {time_s: [0, 1], length_m: [5, 6]}}",
     "profile of tether_1 begins with 5 m; allowed: 7 m, which deployed_m says is out"),
    ("reals: 5", "'reals' is not known"),
])  # fmt: skip
def test_what_is_wrong_is_named(tmp_path, text, said):
    with pytest.raises(TssError) as caught:
        scenario.load(written(tmp_path, text + "\n"))
    assert said in str(caught.value)


def test_a_reel_does_not_move_where_one_shape_is_kept(tmp_path):
    file = written(tmp_path, "deployed_m: 3000\nshape_keeping_n_per_m: 0.001\n")
    with pytest.raises(TssError, match="shape_keeping_n_per_m keeps one shape; allowed with reels"):
        setup_of(file, {}, RUN)
