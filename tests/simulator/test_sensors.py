"""Sensors: what they measure, by statistics; and over the middleware, recorded and played."""

import numpy as np
import pytest
import ros_harness
from ros_harness import time_ns
from scipy import stats
from simulation_interfaces.srv import ResetSimulation, StepSimulation
from tss_interfaces.msg import RelativeStates, TetherMeasurements
from tss_interfaces.srv import RestoreSnapshot, SaveSnapshot

from tss_ros.bags.mcap_file import McapFile
from tss_ros.bags.reader import decoded
from tss_ros.bags.recording import read_bag
from tss_ros.bags.verify import verify
from tss_ros.core import Satellite, Tether, assemble, ring
from tss_ros.messages.topics import read_topics
from tss_ros.ros import parameters
from tss_ros.simulator.sensors import Instrument, Sensors

S = 10**9
NAMES = ("satellite_1", "satellite_2", "satellite_3")
TETHERS = "/sim_node/tether_measurements"
#: Standard deviations of noise and bias, all different.
ERRORS = {
    "position_noise_m": 0.2, "position_bias_m": 3.0, "velocity_noise_m_s": 0.01,
    "velocity_bias_m_s": 0.4, "range_noise_m": 0.05, "range_bias_m": 2.0,
    "tension_noise_n": 0.03, "tension_bias_n": 0.5,
}  # fmt: skip
PERFECT = dict.fromkeys(ERRORS, 0.0)


def sensors(system=None, period_s=1.0, seed=7, **errors):
    options = {**PERFECT, **errors, "sensor_period_s": period_s, "sensor_seed": seed}
    return Sensors(system or ring(), options)


def rows(values):
    return np.array(values).reshape(-1, 3)


def vectors(messages):
    return np.array([[v.x, v.y, v.z] for v in messages])


# -- without ROS -----------------------------------------------------------------------------------


def test_noise_is_normal_white_and_of_the_given_size():
    noise = np.array([0.5, 2.0, 0.0])
    instrument = Instrument(3, "range", noise, [0.0, 0.0, 0.0])
    true = np.array([10.0, -20.0, 30.0])
    errors = np.array([instrument.measure(k * S // 7, true) for k in range(20_000)]) - true
    assert not errors[:, 2].any()
    count = len(errors)
    for k in (0, 1):
        scaled = errors[:, k] / noise[k]
        assert abs(scaled.mean()) < 4.0 / count**0.5
        assert abs(scaled.std() - 1.0) < 4.0 / (2 * count) ** 0.5
        assert stats.kstest(scaled, "norm").pvalue > 1e-3
        assert abs(np.corrcoef(scaled[1:], scaled[:-1])[0, 1]) < 4.0 / count**0.5
    assert abs(np.corrcoef(errors[:, 0], errors[:, 1])[0, 1]) < 4.0 / count**0.5


def test_bias_stays_and_is_drawn_by_the_seed():
    """Over 4000 seeds its deviation is the given one; of one instrument it never changes."""
    drawn = np.array([Instrument(seed, "range", [0.0], [2.5]).bias[0] for seed in range(4000)])
    assert abs(drawn.mean()) < 4 * 2.5 / 4000**0.5
    assert abs(drawn.std() / 2.5 - 1.0) < 4.0 / 8000**0.5
    biased = Instrument(1, "range", [0.1], [2.5])
    shown = np.array([biased.measure(k, np.array([5.0])) for k in range(5000)])
    assert shown.mean() == pytest.approx(5.0 + biased.bias[0], abs=4 * 0.1 / 5000**0.5)
    assert abs(biased.bias[0]) > 0.1


def test_noise_depends_on_seed_instrument_and_time_alone():
    def measure(seed=1, name="range", time=5 * S):
        return Instrument(seed, name, np.ones(4), np.ones(4)).measure(time, np.zeros(4))

    used = Instrument(1, "range", np.ones(4), np.ones(4))
    for time in (9 * S, 0, 2**31 * S):
        used.measure(time, np.zeros(4))
    np.testing.assert_array_equal(used.measure(5 * S, np.zeros(4)), measure())
    for other in (measure(seed=2), measure(name="tension"), measure(time=5 * S + 1)):
        assert (np.abs(other - measure()) > 1e-6).all()


def test_a_perfect_sensor_tells_the_truth():
    system = ring()
    chance = np.random.default_rng(2)
    position_m, velocity_m_s = chance.normal(size=(2, 3, 3))
    perfect = sensors(system)
    others, r, v = perfect.relative_states(1, 0, position_m, velocity_m_s)
    assert others == [0, 2]
    np.testing.assert_array_equal(r, position_m[[0, 2]] - position_m[1])
    np.testing.assert_array_equal(v, velocity_m_s[[0, 2]] - velocity_m_s[1])
    range_m, tension_n = perfect.ranges_and_tensions(0, position_m, np.array([1.0, 2.0, 3.0]))
    expected = [np.linalg.norm(position_m[i] - position_m[j]) for i, j in system.tether_ends]
    np.testing.assert_allclose(range_m, expected, rtol=1e-15)
    np.testing.assert_array_equal(tension_n, [1.0, 2.0, 3.0])


def test_errors_have_the_sizes_of_their_parameters():
    position_m, velocity_m_s = np.zeros((3, 3)), np.zeros((3, 3))
    for name, size in ERRORS.items():
        quantity, kind = name.split("_")[:2]
        shown = []
        for k in range(600):
            seed, time = (k, 0) if kind == "bias" else (1, k)
            own = sensors(seed=seed, **{name: size})
            _, r, v = own.relative_states(0, time, position_m, velocity_m_s)
            length, pull = own.ranges_and_tensions(time, position_m, np.zeros(3))
            shown.append({"position": r, "velocity": v, "range": length, "tension": pull})
        for other in ERRORS:
            found = np.array([s[other.split("_")[0]] for s in shown]).std(axis=0)
            expected = size if other.startswith(quantity) else 0.0
            np.testing.assert_allclose(found, expected, rtol=0.13, err_msg=f"{name} in {other}")


def test_ranges_are_of_whole_tethers_from_satellite_to_satellite():
    """A tether that is cut into segments is measured end to end, its tension at both ends."""
    bodies = [Satellite(n, 10.0, (float(100 * i), 0.0, 0.0)) for i, n in enumerate("abc")]
    tethers = [
        Tether("long", (0, 1), (30.0,) * 3, (1e3,) * 3, (1.0,) * 3, (0.1, 0.1)),
        Tether("short", (1, 2), (90.0,), (1e3,), (1.0,)),
    ]
    system = assemble(bodies, tethers)
    ends = [(t.name, t.beads[0], t.beads[-1], t.segments) for t in sensors(system).tethers]
    assert ends == [("long", 0, 1, (0, 1, 2)), ("short", 1, 2, (3,))]
    position_m = np.array(system.layout_m)
    inner = np.flatnonzero(~system.is_satellite)
    position_m[inner] += [0.0, 40.0, 0.0]
    range_m, tension_n = sensors(system).ranges_and_tensions(
        0, position_m, np.array([1.0, 50.0, 2.0, 7.0])
    )
    assert range_m.tolist() == [100.0, 100.0] and tension_n.tolist() == [1.5, 7.0]
    cut, whole = ring(beads_per_tether=3), ring()

    def joined(system):
        lines = sensors(system).tethers
        return {t.name: {system.bead_name[i] for i in t.beads[:: len(t.beads) - 1]} for t in lines}

    assert joined(cut) == joined(whole) and len(joined(whole)) == 3


@pytest.mark.parametrize(("step_s", "period_s"), [
    (1.0, 1.0), (1.0, 0.25), (1.0, 3.0), (2.0, 3.0), (1 / 3, 1.0), (1 / 3, 2 / 3), (0.1, 0.7)
])  # fmt: skip
def test_each_period_has_one_measurement_at_its_first_step(step_s, period_s):
    own, times = sensors(period_s=period_s), [round(k * step_s * S) for k in range(5000)]
    due = [t for t in times if own.due(t, step_s)]
    expected, seen = [], set()
    for k, time in enumerate(times):
        periods = int(k * step_s / period_s + 1e-9)
        if periods not in seen:
            seen.add(periods)
            expected.append(time)
    assert due == expected and due[0] == 0


# -- over the middleware ---------------------------------------------------------------------------


class Ears:
    """Hears all measurements of a simulator."""

    def __init__(self, simulator, names=NAMES):
        self.sim = simulator
        self.tethers, self.relative = [], {name: [] for name in names}
        node = simulator.node
        node.create_subscription(TetherMeasurements, TETHERS, self.tethers.append, 1000)
        for name in names:
            topic = f"/sim_node/{name}/relative_states"
            node.create_subscription(RelativeStates, topic, self.relative[name].append, 1000)
        simulator.spin_until(lambda: all(map(len, self.lists)), ros_harness.START_S, "the newest")

    @property
    def lists(self):
        return [self.tethers, *self.relative.values()]

    def step(self, count):
        """What is measured in so many steps: a list for each topic."""
        begun = [len(heard) for heard in self.lists]
        self.sim.do(StepSimulation, steps=count)
        self.sim.settled()
        self.sim.spin_until(
            lambda: all(len(h) >= b + count for h, b in zip(self.lists, begun)), 10, "measurements"
        )
        return [heard[b:] for heard, b in zip(self.lists, begun)]


def values(message):
    if isinstance(message, TetherMeasurements):
        return message.range_m.tolist() + message.tension_n.tolist()
    return vectors([*message.position, *message.velocity]).ravel().tolist()


def shown(heard):
    return [[(time_ns(m.header.stamp), values(m)) for m in messages] for messages in heard]


@pytest.fixture
def simulator(start, client):
    def begin(**given):
        process = start("sim_node", start_paused=True, time_scale=0, disturbance_m=20.0, **given)
        simulator = ros_harness.Simulator(*client)
        simulator.join()
        simulator.process = process
        return simulator

    return begin


def test_nothing_is_published_unless_it_is_asked_for(simulator, client):
    node, spin_until = client
    running = simulator()

    def topics():
        names = [name for name, _ in node.get_topic_names_and_types()]
        return sorted(n for n in names if n.endswith(("relative_states", "measurements")))

    assert topics() == []
    assert running.set(sensor_period_s=2.0, satellites=4).successful
    assert topics() == []  # until the state is reset
    running.do(ResetSimulation)
    expected = [f"/sim_node/satellite_{i}/relative_states" for i in (1, 2, 3, 4)] + [TETHERS]
    spin_until(lambda: topics() == expected, 10, "topics of sensors")
    refused = running.set(position_noise_m=-1.0)
    assert not refused.successful and "position_noise_m is -1.0; allowed: a number" in (
        refused.reason
    )
    assert running.set(sensor_period_s=0.0, range_noise_m=0.5).successful
    running.do(ResetSimulation)
    spin_until(lambda: topics() == [], 10, "no topics of sensors")
    running.process.wait_for_line("range_noise_m is 0.5, but sensor_period_s is 0: there are no")
    assert running.process.stop() == 0, running.process.stderr


def test_nodes_measure_alike_after_resets_and_snapshots(simulator):
    running = simulator(sensor_period_s=0.5, sensor_seed=5, frame_prefix="a/", **ERRORS)
    ears = Ears(running)
    first = ears.step(10)
    assert ears.tethers[0].header.frame_id == "a/orbit"
    assert list(ears.tethers[0].name) == ["tether_1", "tether_2", "tether_3"]
    message = ears.relative["satellite_2"][0]
    assert (message.observer, list(message.name)) == ("satellite_2", ["satellite_1", "satellite_3"])
    running.do(SaveSnapshot, file="here.npz")
    on = shown(ears.step(20))
    running.do(RestoreSnapshot, file="here.npz")
    again = shown(ears.step(20))
    assert [[m for m in h if m[0] > 10 * S] for h in again] == on
    running.do(ResetSimulation)
    again = shown(ears.step(10))
    assert [[m for m in h if 0 < m[0] <= 10 * S] for h in again] == shown(first)
    # What is measured is the truth, with the errors of a model that was told the same.
    newest = running.settled()
    at = time_ns(newest.header.stamp)
    model = Sensors(ring(), {"sensor_period_s": 0.5, "sensor_seed": 5, **ERRORS})
    r, v = rows(newest.position_m), rows(newest.velocity_m_s)
    for i, name in enumerate(NAMES):
        message = ears.relative[name][-1]
        _, position_m, velocity_m_s = model.relative_states(i, at, r, v)
        np.testing.assert_allclose(vectors(message.position), position_m, rtol=1e-14)
        np.testing.assert_allclose(vectors(message.velocity), velocity_m_s, rtol=1e-14)
        others = [k for k in range(3) if k != i]
        off = np.abs(vectors(message.position) - (r[others] - r[i]))
        assert (off > 0.0).all() and off.max() < 5 * 3.0
    assert running.process.stop() == 0, running.process.stderr


def measurements(bag):
    """What the first file of a bag has on the topics of sensors, by topic."""
    found = {}
    with McapFile(next(bag.glob("*.mcap"))) as file:
        for batch in file.batches():
            for i, head in enumerate(batch.heads):
                channel = file.channels[int(head["channel"])]
                if channel.topic.startswith("/sim_node/"):
                    message = decoded(file.schemas[channel.schema_id], batch.payload(i))
                    assert int(head["log_time"]) == time_ns(message.header.stamp)
                    found.setdefault(channel.topic, []).append(message)
    return found


@pytest.mark.parametrize("in_bulk", [False, pytest.param(True, marks=pytest.mark.long)])
def test_measurements_are_recorded_all_of_them_and_played(start, client, tmp_path, in_bulk):
    logger = start("logger_node", output="bag", in_bulk=in_bulk)
    given = {"publish_period_s": 2.0, "sensor_period_s": 4.0, "sensor_seed": 1}
    simulator = start(
        "sim_node", time_scale=0, turns=0.5, wait_for_recorder=True, **given, **ERRORS
    )
    assert simulator.wait(ros_harness.START_S) == 0, simulator.stderr
    assert logger.stop() == 0, logger.stderr
    assert ", 0 lost" in logger.stdout
    bag = tmp_path / "bag"
    assert not verify(bag).faults
    recorded, found = read_bag(bag), measurements(bag)
    assert set(found) == {TETHERS, *(f"/sim_node/{n}/relative_states" for n in NAMES)}
    model = Sensors(ring(), {**given, **ERRORS})
    ranges = np.array([m.range_m for m in found[TETHERS]])
    assert [time_ns(m.header.stamp) for m in found[TETHERS]] == [
        4 * k * S for k in range(len(ranges))
    ]
    true, pull = recorded.position_m[::2], recorded.tension_n[::2]
    assert len(true) == len(ranges) > 100
    for k in range(len(ranges)):
        range_m, tension_n = model.ranges_and_tensions(4 * k * S, true[k], pull[k])
        np.testing.assert_allclose(ranges[k], range_m, rtol=1e-13)
        np.testing.assert_allclose(found[TETHERS][k].tension_n, tension_n, rtol=1e-12, atol=1e-12)
    if in_bulk:
        return
    node, spin_until = client
    heard = []
    node.create_subscription(TetherMeasurements, TETHERS, heard.append, 1000)
    player = ros_harness.Process("play", tmp_path, [str(bag), "--rate", "1e6", "--delay", "3"])
    try:
        spin_until(lambda: len(heard) == len(ranges), ros_harness.START_S, "what is played")
        assert player.wait(ros_harness.START_S) == 0, player.stderr
    finally:
        player.kill()
    np.testing.assert_array_equal([m.range_m for m in heard], ranges)


def test_sensors_are_parameters_of_the_run_and_topics_of_the_recorder():
    table = {p.name: p for p in parameters.SIMULATOR}
    assert all(table[name].default == 0.0 for name in (*ERRORS, "sensor_period_s"))
    assert {table[name].applies for name in ERRORS} == {"reset"}
    optional = [t for t in read_topics().values() if t.optional and t.recorded]
    assert {t.type.rpartition("/")[2] for t in optional} == {"RelativeStates", "TetherMeasurements"}
