"""Satellites and tether beads as entities of simulation_interfaces, over the middleware."""

import numpy as np
import pytest
import ros_harness
from geometry_msgs.msg import Quaternion, Twist, Vector3
from ros_harness import motion, time_ns
from simulation_interfaces.msg import (
    Bounds,
    EntityCategory,
    EntityFilters,
    EntityState,
    Result,
    SimulatorFeatures,
    TagsFilter,
)
from simulation_interfaces.srv import (
    GetEntities,
    GetEntitiesStates,
    GetEntityInfo,
    GetEntityState,
    GetSimulatorFeatures,
    ResetSimulation,
    SetEntityState,
    StepSimulation,
)
from tss_interfaces.srv import Disturb

from tss_ros.core import Propagator, State
from tss_ros.scenarios import scenario

FAILED, UNSUPPORTED = Result.RESULT_OPERATION_FAILED, Result.RESULT_FEATURE_UNSUPPORTED
INVALID_POSE = SetEntityState.Response.INVALID_POSE
PERIOD_S = 0.5
RING = scenario.load("six_bead")
NAN, INF = float("nan"), float("inf")


@pytest.fixture(scope="module")
def simulator(tmp_path_factory):
    """One simulator of satellites and tether beads, paused, for all tests."""
    directory = tmp_path_factory.mktemp("simulator")
    with ros_harness.processes(directory) as start, ros_harness.client_node() as client:
        given = {"scenario": "six_bead", "publish_period_s": PERIOD_S, "frame_prefix": "a_"}
        process = start("sim_node", start_paused=True, time_scale=0, **given)
        yield ros_harness.Simulator(*client)
        assert process.stop() == 0
        assert "rror" not in process.stderr, process.stderr


@pytest.fixture
def paused(simulator):
    """The simulator at the beginning of a run."""
    simulator.join()
    return simulator


def rows(values):
    return np.array(values).reshape(-1, 3)


def xyz(vector):
    return [vector.x, vector.y, vector.z]


def state(position=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), frame_id=""):
    message = EntityState()
    message.header.frame_id = frame_id
    position, velocity = map(float, position), map(float, velocity)
    message.pose.position.x, message.pose.position.y, message.pose.position.z = position
    message.twist.linear = Vector3(**dict(zip("xyz", velocity)))
    return message


def test_features_are_true(simulator):
    """Each that is told is served, and none that is not: found by the names of services."""
    features = simulator.ask(GetSimulatorFeatures).features
    names = {
        getattr(SimulatorFeatures, name): name
        for name in dir(SimulatorFeatures)
        if name.isupper() and isinstance(getattr(SimulatorFeatures, name), int)
    }
    told = {names[number] for number in features.features}
    assert len(told) == len(features.features) and not features.spawn_formats
    assert features.custom_info.startswith("tss_ros ")
    services = {
        name.rpartition("/")[2]: kinds
        for name, kinds in simulator.node.get_service_names_and_types()
        if name.startswith("/sim_node/")
    }
    of_package = {name for name, (kind,) in services.items() if kind.startswith("simulation_int")}
    needed = {
        "ENTITY_STATE_GETTING": "get_entity_state",
        "ENTITY_STATE_SETTING": "set_entity_state",
        "ENTITY_INFO_GETTING": "get_entity_info",
        "SIMULATION_RESET": "reset_simulation",
        "SIMULATION_STATE_GETTING": "get_simulation_state",
        "SIMULATION_STATE_SETTING": "set_simulation_state",
        "STEP_SIMULATION_SINGLE": "step_simulation",
        "STEP_SIMULATION_ACTION": "get_result",
    }
    assert set(needed) <= told and set(needed.values()) <= set(services)
    always = {"get_simulator_features", "get_entities", "get_entities_states"}
    action = {"send_goal", "get_result"}
    assert of_package == set(needed.values()) | always | action
    rest = told - set(needed)
    # What no service stands for is tested below and with resets and steps.
    assert rest == {
        "ENTITY_TAGS", "ENTITY_BOUNDS_BOX", "ENTITY_CATEGORIES", "SIMULATION_RESET_TIME",
        "SIMULATION_RESET_STATE", "SIMULATION_STATE_PAUSE", "STEP_SIMULATION_MULTIPLE",
    }  # fmt: skip


def box(*corners):
    return Bounds(type=Bounds.TYPE_BOX, points=[Vector3(**dict(zip("xyz", c))) for c in corners])


def sphere(centre, radius):
    points = [Vector3(**dict(zip("xyz", centre))), Vector3(x=radius)]
    return Bounds(type=Bounds.TYPE_SPHERE, points=points)


def test_filters_find_what_they_describe(paused):
    names = paused.beads[-1].name
    place = dict(zip(names, rows(paused.beads[-1].position_m)))
    satellites = [name for name in names if name.startswith("satellite")]
    beads = [name for name in names if name not in satellites]
    assert len(satellites) == 3 and len(beads) == 3
    upper = [name for name in names if place[name][1] >= 0.0]
    near_m = np.linalg.norm(place[beads[0]]) * 1.0001
    near = [name for name in names if np.linalg.norm(place[name]) <= near_m]
    assert 0 < len(upper) < 6 and 0 < len(near) < 6
    moving = EntityCategory(category=EntityCategory.CATEGORY_DYNAMIC_OBJECT)
    static = EntityCategory(category=EntityCategory.CATEGORY_STATIC_OBJECT)
    both = ["satellite", "tether_bead"]
    for fields, expected in (
        ({}, names),
        ({"filter": "^satellite_[[:digit:]]+$"}, satellites),
        ({"filter": "lite_[13]"}, [satellites[0], satellites[2]]),
        ({"filter": "(a*)*" * 100 + "b$"}, []),
        ({"categories": [static, moving]}, names),
        ({"categories": [static]}, []),
        ({"tags": TagsFilter(tags=["tether_bead"])}, beads),
        ({"tags": TagsFilter(tags=both)}, names),
        ({"tags": TagsFilter(tags=both, filter_mode=TagsFilter.FILTER_MODE_ALL)}, []),
        ({"bounds": box((-1e9, 0.0, -1.0), (1e9, 1e9, 1.0))}, upper),
        ({"bounds": box((1e9, 1e9, 1.0), (-1e9, 0.0, -1.0))}, upper),
        ({"bounds": sphere((0.0, 0.0, 0.0), near_m)}, near),
        ({"bounds": sphere((0.0, 0.0, 0.0), INF), "filter": "_2"}, [n for n in names if "_2" in n]),
    ):
        filters = EntityFilters(**fields)
        assert paused.do(GetEntities, filters=filters).entities == expected, fields
        found = paused.do(GetEntitiesStates, filters=filters)
        assert found.entities == expected and len(found.states) == len(expected)
        for name, entity in zip(found.entities, found.states):
            assert xyz(entity.pose.position) == place[name].tolist()


@pytest.mark.parametrize(
    ("fields", "code", "text"),
    [
        ({"filter": "["}, FAILED, "filter is '['"),
        ({"filter": r"\d"}, FAILED, "POSIX extended regular expression"),
        ({"filter": "a" * 1001}, FAILED, "longer than 1000 characters"),
        ({"filter": "(((a{100}){100}){100})"}, FAILED, "filter is"),
        ({"categories": [EntityCategory(category=3)]}, FAILED, "category is 3"),
        ({"tags": TagsFilter(filter_mode=9)}, FAILED, "filter_mode is 9"),
        ({"bounds": Bounds(type=Bounds.TYPE_CONVEX_HULL)}, UNSUPPORTED, "convex hull"),
        ({"bounds": Bounds(type=77)}, FAILED, "type of bounds is 77"),
        ({"bounds": Bounds(type=Bounds.TYPE_BOX)}, FAILED, "bounds have 0 points"),
        ({"bounds": Bounds(points=[Vector3()])}, FAILED, "bounds have 1 points"),
        ({"bounds": sphere((0.0, 0.0, 0.0), -1.0)}, FAILED, "a radius from 0"),
        ({"bounds": box((NAN, 0.0, 0.0), (1.0, 1.0, 1.0))}, FAILED, "nan"),
    ],
)
def test_wrong_filters_are_refused(simulator, fields, code, text):
    for kind in (GetEntities, GetEntitiesStates):
        found, why = simulator.refused(kind, filters=EntityFilters(**fields))
        assert found == code and text in why


def test_information_tells_kind_mass_and_tethers(simulator):
    info = simulator.do(GetEntityInfo, entity="satellite_1").info
    assert info.category.category == EntityCategory.CATEGORY_DYNAMIC_OBJECT
    assert info.tags == ["satellite"]
    mass_kg = RING.build().mass_kg[0]
    assert info.description.startswith(f"satellite of {mass_kg:g} kg on tether_1")
    for kind in (GetEntityInfo, GetEntityState, SetEntityState):
        code, why = simulator.refused(kind, entity="satellite_9")
        assert code == Result.RESULT_NOT_FOUND and "there are satellite_1, " in why


def test_states_are_those_of_the_motion(paused):
    """Accelerations against differences of the velocities that are published."""
    assert paused.set(publish_period_s=0.01).successful
    paused.do(ResetSimulation)
    paused.do(Disturb, random_offset_m=5.0, seed=1)
    paused.do(StepSimulation, steps=50)
    middle = paused.settled()
    answer = paused.do(GetEntitiesStates)
    one = paused.do(GetEntityState, entity=middle.name[1]).state
    assert answer.entities == list(middle.name) and one == answer.states[1]
    assert paused.set(publish_period_s=PERIOD_S).successful
    assert {entity.header.frame_id for entity in answer.states} == {"a_orbit"}
    assert {time_ns(e.header.stamp) for e in answer.states} == {time_ns(middle.header.stamp)}
    assert {e.pose.orientation.w for e in answer.states} == {1.0}
    assert rows(middle.position_m).tolist() == [xyz(e.pose.position) for e in answer.states]
    assert rows(middle.velocity_m_s).tolist() == [xyz(e.twist.linear) for e in answer.states]
    paused.do(StepSimulation, steps=1)
    after, before = paused.settled(), paused.beads[-3]
    assert after.step - before.step == 2
    expected = (rows(after.velocity_m_s) - rows(before.velocity_m_s)) / 0.02
    found = np.array([xyz(entity.acceleration.linear) for entity in answer.states])
    assert np.abs(found).max() > 0.01  # gravity alone makes less than a thousandth of that
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_a_state_that_is_set_is_where_the_motion_goes_on(paused):
    """Against the core's own integrator, and once more from the words of the event."""
    paused.do(StepSimulation, steps=3)
    before = paused.settled()
    r, v = rows(before.position_m).copy(), rows(before.velocity_m_s).copy()
    r[1] += [3.0, -2.0, 1.0]
    v[1] += [0.1, 0.0, -0.2]
    paused.do(SetEntityState, entity=before.name[1], state=state(r[1], v[1], "a_orbit"))
    now = paused.do(GetEntityState, entity=before.name[1]).state
    assert xyz(now.pose.position) == r[1].tolist() and xyz(now.twist.linear) == v[1].tolist()
    assert len(paused.beads) == 4  # it is no step
    paused.do(StepSimulation, steps=20)
    newest, (event,) = paused.settled(), paused.events
    assert (event.kind, event.step) == ("place", before.step + 1)
    assert time_ns(event.header.stamp) == time_ns(before.header.stamp)
    words = f"{before.name[1]}: position {r[1].tolist()} m, velocity {v[1].tolist()} m/s"
    assert event.text == words
    propagator = Propagator(RING.build(), RING.spin_rate_ratio, State(r, v))
    position_m, _ = propagator.sample(PERIOD_S * np.arange(21))
    np.testing.assert_allclose(rows(newest.position_m), position_m[-1], atol=1e-6)
    paused.join()
    paused.do(StepSimulation, steps=3)
    paused.do(SetEntityState, entity=before.name[1], state=state(r[1], v[1]))
    paused.do(StepSimulation, steps=20)
    assert motion(paused.settled()) == motion(newest)


def test_beads_that_a_tether_joins_are_not_put_in_one_place(paused):
    first, second = paused.beads[-1].name[:2]
    paused.do(SetEntityState, entity=first, state=state((0, 300, 0)))
    paused.do(SetEntityState, entity=second, state=state((0, 200, 0)))
    why = f"{first} and {second} would be in one place; tether_1_segment_1 between them has no "
    why += "direction there"
    refused = paused.refused(SetEntityState, entity=second, state=state((0, 300, 0)))
    assert refused == (FAILED, why)
    assert paused.refused(Disturb, bead=first, offset_m=Vector3(y=-100.0)) == (FAILED, why)
    paused.do(StepSimulation, steps=1)
    assert [event.kind for event in paused.events] == ["place", "place"]


TURNED = EntityState()
TURNED.pose.orientation = Quaternion(x=1.0, w=0.0)
NO_QUATERNION = EntityState()
NO_QUATERNION.pose.orientation.w = 0.0
SPINNING = EntityState(twist=Twist(angular=Vector3(z=1.0)))


@pytest.mark.parametrize(
    ("given", "code", "text"),
    [
        (TURNED, INVALID_POSE, "orientation is [1.0, 0.0, 0.0, 0.0]; allowed: [0, 0, 0, 1]"),
        (NO_QUATERNION, INVALID_POSE, "orientation is [0.0, 0.0, 0.0, 0.0]"),
        (state((2e6, 0, 0)), INVALID_POSE, "position is [2000000.0, 0.0, 0.0]"),
        (state((0, NAN, 0)), INVALID_POSE, "position is [0.0, nan, 0.0]"),
        (state((0, 0, -INF)), INVALID_POSE, "position is [0.0, 0.0, -inf]"),
        (state(velocity=(0, 1e5, 0)), FAILED, "velocity is [0.0, 100000.0, 0.0]"),
        (SPINNING, FAILED, "angular velocity is [0.0, 0.0, 1.0]"),
        (state(frame_id="orbit"), FAILED, "frame_id is 'orbit'; allowed: 'a_orbit', or ''"),
    ],
)
def test_states_that_cannot_be_are_refused(paused, given, code, text):
    found, why = paused.refused(SetEntityState, entity="satellite_2", state=given)
    assert found == code and text in why
    paused.settled()
    assert len(paused.beads) == 1 and not paused.events
