"""The package simulation_interfaces that is built here is version 1.5 of the one that Jazzy has.

The hashes are those that rosidl makes of upstream's files of tag 1.5.1: nodes that name the same
hash understand each other. Hashes leave constants out, so these are compared by themselves.
"""

import importlib
import json
import re
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory

HASHES = {
    "action/SimulateSteps": "f0837c898e1219cd73bf4c041feab41e8c533e8e1057e982744dba7b093467eb",
    "msg/Bounds": "e8624fe51f0f5548197542697d924c5699ac7198f1e4c68e50c3ca2af73f5b3f",
    "msg/EntityCategory": "43bdf7933fddf75f6970f7a8fe7078524355d821d390b3954bb46ac36c03dfe1",
    "msg/EntityFilters": "8e7b12e8ea062f14c55de4877221fe1b7cd9749665a7ad8a4ab855fc4b148303",
    "msg/EntityInfo": "3b9a2e7fa00f9a59d325b6e47904044c421561a385682027c7fc06c359806319",
    "msg/EntityState": "2e0464a85eb80a939025075d6c20761eca6a4cb9d6baf2c0ba373467c8b598d0",
    "msg/Result": "cf43a306adff3337a0a47143d8f5689933bc70a30478f13b077dc1fe3bc5ad17",
    "msg/SimulationState": "bb9f87ccdd98fba113052a512d9801e84ce732d0a2b3c2b0cb281828de36e415",
    "msg/SimulatorFeatures": "8b101c8529bc0ea3dcf056078254768f39832b9ef0adaf93bd5cea96c0de3305",
    "msg/TagsFilter": "5c3efc51e8ed04c266c09cb4691ec95b964cd410558e01d8c83646b038826b45",
    "srv/GetEntities": "cb90004c48cd50f37732fb008e22c34c261dd680a723bf0f85d8437ea4498bf7",
    "srv/GetEntitiesStates": "0a76170d0c1c90e1eaf805cfab78ea801d1f82df309a28c1f0fae4b570f19754",
    "srv/GetEntityInfo": "953b7ab6bfc35063f5c9a72463c6ce489baa10249a7fa510926d342a34b0d29e",
    "srv/GetEntityState": "749c91f2a2353d98367b64f2995a0f5842ce92a08ec1ffb3e185540a91557fb5",
    "srv/GetSimulationState": "3362dcebee4b1afebbf9c4beee5c79c1455385aded62092a892d61fde8644f30",
    "srv/GetSimulatorFeatures": "abb9439c8cf196722a469fb6c68b44b484f198c2a1356ac38849a29c2a20a794",
    "srv/ResetSimulation": "4ce285d7ff9b8ac70dcc95161f32bf54c05a6f4b13427990e41ab40c36c39646",
    "srv/SetEntityState": "ca210e7d2b66629ae133c8e1edf5246e618106d75c78ed0556c0e7a33c59ee5e",
    "srv/SetSimulationState": "a868b916dce49974f637ba252141258c4b07b0c06858b88af560e3eb6bfbcb30",
    "srv/StepSimulation": "913fe0653690ce6bf8f09f316e6a626747012e9fca31e26719910d417aa8565c",
}  # fmt: skip
CONSTANTS = {
    "msg/Bounds": """
        TYPE_EMPTY=0 TYPE_BOX=1 TYPE_CONVEX_HULL=2 TYPE_SPHERE=3
    """,
    "msg/EntityCategory": """
        CATEGORY_OBJECT=0 CATEGORY_ROBOT=1 CATEGORY_HUMAN=2 CATEGORY_DYNAMIC_OBJECT=4
        CATEGORY_STATIC_OBJECT=5
    """,
    "msg/Result": """
        RESULT_FEATURE_UNSUPPORTED=0 RESULT_OK=1 RESULT_NOT_FOUND=2 RESULT_INCORRECT_STATE=3
        RESULT_OPERATION_FAILED=4
    """,
    "msg/SimulationState": """
        STATE_STOPPED=0 STATE_PLAYING=1 STATE_PAUSED=2 STATE_QUITTING=3 STATE_NO_WORLD=4
        STATE_LOADING_WORLD=5
    """,
    "msg/SimulatorFeatures": """
        SPAWNING=0 DELETING=1 NAMED_POSES=2 POSE_BOUNDS=3 ENTITY_TAGS=4 ENTITY_BOUNDS=5
        ENTITY_BOUNDS_BOX=6 ENTITY_BOUNDS_CONVEX=7 ENTITY_CATEGORIES=8
        SPAWNING_RESOURCE_STRING=9 ENTITY_STATE_GETTING=10 ENTITY_STATE_SETTING=11
        ENTITY_INFO_GETTING=12 ENTITY_INFO_SETTING=13 SPAWNABLES=14 SIMULATION_RESET=20
        SIMULATION_RESET_TIME=21 SIMULATION_RESET_STATE=22 SIMULATION_RESET_SPAWNED=23
        SIMULATION_STATE_GETTING=24 SIMULATION_STATE_SETTING=25 SIMULATION_STATE_PAUSE=26
        STEP_SIMULATION_SINGLE=31 STEP_SIMULATION_MULTIPLE=32 STEP_SIMULATION_ACTION=33
        WORLD_LOADING=40 WORLD_RESOURCE_STRING=41 WORLD_TAGS=42 WORLD_UNLOADING=43
        WORLD_INFO_GETTING=44 AVAILABLE_WORLDS=45 SPAWNING_ENTITIES=50
    """,
    "msg/TagsFilter": """
        FILTER_MODE_ANY=0 FILTER_MODE_ALL=1
    """,
    "srv/ResetSimulation": """
        SCOPE_DEFAULT=0 SCOPE_TIME=1 SCOPE_STATE=2 SCOPE_SPAWNED=4 SCOPE_ALL=255
    """,
    "srv/SetEntityState": """
        INVALID_POSE=101
    """,
    "srv/SetSimulationState": """
        ALREADY_IN_TARGET_STATE=101 STATE_TRANSITION_ERROR=102 INCORRECT_TRANSITION=103
    """,
}


def test_every_type_that_is_built_is_compared():
    folder = Path(__file__).resolve().parents[2] / "msg_configs" / "simulation_interfaces"
    built = {f"{p.parent.name}/{p.stem}" for p in folder.glob("*/*.*")}
    assert built == set(HASHES) and len(built) == 20


@pytest.mark.parametrize("name", HASHES)
def test_types_have_upstreams_hashes(name):
    share = Path(get_package_share_directory("simulation_interfaces"))
    described = json.loads((share / f"{name}.json").read_text())
    hashes = {entry["type_name"]: entry["hash_string"] for entry in described["type_hashes"]}
    assert hashes[f"simulation_interfaces/{name}"] == f"RIHS01_{HASHES[name]}"


@pytest.mark.parametrize("name", HASHES)
def test_types_have_upstreams_constants(name):
    kind, _, own = name.partition("/")
    owner = getattr(importlib.import_module(f"simulation_interfaces.{kind}"), own)
    parts = [getattr(owner, part, None) for part in ("Request", "Response", "Goal", "Result")]
    found = {
        constant: getattr(part, constant)
        for part in (owner, *filter(None, parts))
        for constant in dir(part)
        if re.fullmatch("[A-Z]+(_[A-Z]+)*", constant) and constant != "SLOT_TYPES"
    }
    expected = dict(pair.split("=") for pair in CONSTANTS.get(name, "").split())
    assert found == {constant: int(value) for constant, value in expected.items()}
