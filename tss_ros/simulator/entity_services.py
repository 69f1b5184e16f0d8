"""The simulator's services about entities: what they ask of the simulation, and answer."""

from collections.abc import Callable
from typing import Any

from simulation_interfaces.srv import (
    GetEntities,
    GetEntitiesStates,
    GetEntityInfo,
    GetEntityState,
    SetEntityState,
)
from tss_interfaces.msg import SimulationEvent

from tss_ros.ros.node import TssNode
from tss_ros.simulator import entities
from tss_ros.simulator.control import Control


class EntityServices:
    """Offers `~/get_entities` and the others on a node; its answers are about the newest state.

    Parameters
    ----------
    node : TssNode
    control : Control
    ask : callable
        As `SimulationServices.ask`.
    on_event : callable
        Called with kind and text of every change of the motion, in the simulation's thread.
    frame_id : str
        Name of the orbit frame.
    """

    def __init__(
        self,
        node: TssNode,
        control: Control,
        ask: Callable[..., Any],
        on_event: Callable[[str, str], None],
        frame_id: str,
    ) -> None:
        self._control, self._on_event, self._frame_id = control, on_event, frame_id
        for kind, name, work in (
            (GetEntities, "get_entities", self._get_entities),
            (GetEntitiesStates, "get_entities_states", self._get_entities_states),
            (GetEntityInfo, "get_entity_info", self._get_entity_info),
            (GetEntityState, "get_entity_state", self._get_entity_state),
            (SetEntityState, "set_entity_state", self._set_entity_state),
        ):

            async def answer(request, response, work=work):
                return await ask(response, work, request, response)

            node.create_service(kind, f"~/{name}", answer)

    # --- in the simulation's thread

    @property
    def _system(self):
        return self._control.simulation.setup.system

    def _matching(self, request):
        newest = self._control.simulation.newest
        return entities.matching(self._system, newest.position_m, request.filters)

    def _states(self, indices):
        return entities.states(self._control.simulation, indices, self._frame_id)

    def _get_entities(self, answer, request, response):
        response.entities = [self._system.bead_name[i] for i in self._matching(request)]
        answer.set_result(None)

    def _get_entities_states(self, answer, request, response):
        indices = self._matching(request)
        response.entities = [self._system.bead_name[i] for i in indices]
        response.states = self._states(indices)
        answer.set_result(None)

    def _get_entity_info(self, answer, request, response):
        index = entities.find(self._system, request.entity)
        response.info = entities.info(self._system, index)
        answer.set_result(None)

    def _get_entity_state(self, answer, request, response):
        (response.state,) = self._states([entities.find(self._system, request.entity)])
        answer.set_result(None)

    def _set_entity_state(self, answer, request, _):
        index = entities.find(self._system, request.entity)
        position_m, velocity_m_s = entities.read_state(request.state, self._frame_id)
        self._control.place(index, position_m, velocity_m_s)
        self._on_event(
            SimulationEvent.KIND_PLACE,
            f"{request.entity}: position {position_m.tolist()} m, "
            f"velocity {velocity_m_s.tolist()} m/s",
        )
        answer.set_result(None)
