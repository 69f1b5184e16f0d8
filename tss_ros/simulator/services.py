"""The simulator's services: what they check, ask of the simulation, and answer."""

import traceback
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.task import Future
from simulation_interfaces.msg import SimulationState, SimulatorFeatures
from simulation_interfaces.srv import (
    GetSimulationState,
    GetSimulatorFeatures,
    ResetSimulation,
    SetSimulationState,
    StepSimulation,
)
from tss_interfaces.msg import BeadStates, SimulationEvent, TetherStates
from tss_interfaces.srv import (
    CutTether,
    Disturb,
    FailActuator,
    GetStates,
    RestoreSnapshot,
    SaveSnapshot,
)

from tss_ros.core import State, TssError, disturbed
from tss_ros.core.model.failures import MODES, Happened, actuator, require_obedient
from tss_ros.ros import messages
from tss_ros.ros.files import inside
from tss_ros.ros.node import TssNode
from tss_ros.simulator.command_topics import read_time
from tss_ros.simulator.commands import CUT, Command
from tss_ros.simulator.control import Code, Control, PlayState, Refused
from tss_ros.simulator.setup import Setup

#: Largest offset [m] and change of velocity [m/s] in a Disturb request.
MAX_OFFSET_M, MAX_VELOCITY_M_S = 1e5, 1e4
#: What a simulator is said to be able to do.
FEATURES = (
    SimulatorFeatures.ENTITY_TAGS,
    SimulatorFeatures.ENTITY_BOUNDS_BOX,
    SimulatorFeatures.ENTITY_CATEGORIES,
    SimulatorFeatures.ENTITY_STATE_GETTING,
    SimulatorFeatures.ENTITY_STATE_SETTING,
    SimulatorFeatures.ENTITY_INFO_GETTING,
    SimulatorFeatures.SIMULATION_RESET,
    SimulatorFeatures.SIMULATION_RESET_TIME,
    SimulatorFeatures.SIMULATION_RESET_STATE,
    SimulatorFeatures.SIMULATION_STATE_GETTING,
    SimulatorFeatures.SIMULATION_STATE_SETTING,
    SimulatorFeatures.SIMULATION_STATE_PAUSE,
    SimulatorFeatures.STEP_SIMULATION_SINGLE,
    SimulatorFeatures.STEP_SIMULATION_MULTIPLE,
    SimulatorFeatures.STEP_SIMULATION_ACTION,
)
#: States that simulators with worlds to load have.
STATES_OF_WORLDS = (SimulationState.STATE_NO_WORLD, SimulationState.STATE_LOADING_WORLD)


class SimulationServices:
    """Offers `~/set_simulation_state` and the others on a node.

    Parameters
    ----------
    node : TssNode
    control : Control
    make_setup : callable
        Makes the Setup that the parameters describe.
    newest_states : callable
        Makes BeadStates and TetherStates of the newest state, in the simulation's thread.
    on_event : callable
        Called with kind and text of every change of the motion, in the simulation's thread.
    on_answer : callable
        Called before every answer.
    folder : str
        Of the snapshots that requests may name.
    on_request : callable
        Called before every request, so that what has arrived before it counts.
    """

    def __init__(
        self,
        node: TssNode,
        control: Control,
        *,
        make_setup: Callable[[], Setup],
        newest_states: Callable[[], tuple[BeadStates, TetherStates]],
        on_event: Callable[[str, str], None],
        on_answer: Callable[[], None],
        folder: str,
        on_request: Callable[[], None],
    ) -> None:
        self._on_request = on_request
        self._node, self._control, self._make_setup = node, control, make_setup
        self._newest_states, self._folder = newest_states, folder
        self._on_event, self._on_answer = on_event, on_answer
        for kind, name, callback in (
            (SetSimulationState, "set_simulation_state", self._set_state),
            (GetSimulationState, "get_simulation_state", self._get_state),
            (GetSimulatorFeatures, "get_simulator_features", self._get_features),
            (GetStates, "get_states", self._get_states),
            (StepSimulation, "step_simulation", self._step),
            (ResetSimulation, "reset_simulation", self._reset),
            (Disturb, "disturb", self._disturb),
            (CutTether, "cut_tether", self._cut),
            (FailActuator, "fail_actuator", self._fail),
            (SaveSnapshot, "save_snapshot", self._save),
            (RestoreSnapshot, "restore_snapshot", self._restore),
        ):
            node.create_service(kind, f"~/{name}", callback)

    def _get_state(self, _, response):
        response.state = messages.simulation_state(self._control.state)
        response.result = messages.result(Code.OK, "")
        self._on_answer()
        return response

    def _get_features(self, _, response):
        name = self._node.get_fully_qualified_name()
        response.features.features = FEATURES
        response.features.custom_info = (
            f"tss_ros {version('tss_ros')}; entities are satellites and tether beads, points of "
            f"the orbit frame; {name}/disturb, {name}/cut_tether, {name}/fail_actuator, "
            f"{name}/save_snapshot, {name}/restore_snapshot and {name}/get_states are of "
            "tss_interfaces"
        )
        self._on_answer()
        return response

    async def _get_states(self, _, response):
        return await self.ask(response, self._do_get_states, response)

    async def _set_state(self, request, response):
        target = request.state.state
        if target == PlayState.STOPPED:
            return await self.ask(response, self._do_stop)
        if target in tuple(PlayState):
            return await self.ask(response, self._control.set_state, PlayState(target))
        unsupported = target in STATES_OF_WORLDS
        code = Code.FEATURE_UNSUPPORTED if unsupported else Code.OPERATION_FAILED
        return await self.ask(response, _refuse, f"state is {target}; allowed: 0 to 3", code)

    async def _step(self, request, response):
        return await self.ask(response, self._control.take_steps, request.steps)

    async def _reset(self, request, response):
        kind = type(request)
        scope = request.scope or kind.SCOPE_ALL
        spawned = scope == kind.SCOPE_SPAWNED
        if spawned or (scope != kind.SCOPE_ALL and not 0 < scope < 8):
            text = f"scope is {scope}; allowed: 0, 255, or bits 1 (time) and 2 (state)"
            return await self.ask(response, _refuse, text, Code.FEATURE_UNSUPPORTED)
        time, state = bool(scope & kind.SCOPE_TIME), bool(scope & kind.SCOPE_STATE)
        return await self.ask(response, self._do_reset, time, state)

    async def _disturb(self, request, response):
        return await self.ask(response, self._do_disturb, request)

    async def _cut(self, request, response):
        return await self.ask(response, self._do_cut, request)

    async def _fail(self, request, response):
        return await self.ask(response, self._do_fail, request)

    async def _save(self, request, response):
        return await self.ask(response, self._do_save, request.file)

    async def _restore(self, request, response):
        return await self.ask(response, self._do_restore, request.file)

    async def ask(self, response: Any, work: Callable[..., None], *arguments: object) -> Any:
        """Have the simulation's thread do `work(answer, *arguments)`; fill in what became of it.

        Parameters
        ----------
        response : object
            With a field `result`.
        work : callable
            As for `Control.request`.
        *arguments

        Returns
        -------
        object
            The response.
        """
        self._on_request()
        done = Future()
        done.add_done_callback(lambda _: self._node.executor.wake())
        self._control.request(work, *arguments).add_done_callback(done.set_result)
        error = (await done).exception()
        if error is None:
            response.result = messages.result(Code.OK, "")
        elif isinstance(error, TssError):
            response.result = messages.result(
                getattr(error, "code", Code.OPERATION_FAILED), str(error)
            )
            self._node.get_logger().debug(f"request refused: {error}")
        else:
            # A mistake of ours must not take the node away from those who ask next.
            text = f"internal error: {type(error).__name__}: {error}"
            response.result = messages.result(Code.OPERATION_FAILED, text)
            shown = "".join(traceback.format_exception(error))
            self._node.get_logger().error(f"request failed: {shown}")
        self._on_answer()
        return response

    # --- in the simulation's thread

    def _do_get_states(self, answer, response):
        response.beads, response.tethers = self._newest_states()
        answer.set_result(None)

    def _do_stop(self, answer):
        try:
            self._control.stop_and_reset(answer, self._make_setup)
        except Refused:
            raise
        except TssError as error:
            raise Refused(Code.STATE_TRANSITION_ERROR, str(error)) from error
        self._on_event(SimulationEvent.KIND_RESET, "time and state, stopped")

    def _do_reset(self, answer, time, state):
        self._control.reset(answer, self._make_setup if state else None, time)
        what = [name for name, asked in (("time", time), ("state", state)) if asked]
        self._on_event(SimulationEvent.KIND_RESET, " and ".join(what))

    def _do_save(self, answer, file):
        path = self._path(file)
        try:
            Path(self._folder).mkdir(mode=0o700, exist_ok=True)
        except OSError as error:
            raise TssError(
                f"service_folder {self._folder!r} cannot be made: {error.strerror}"
            ) from None
        self._control.save(answer, path)

    def _do_restore(self, answer, file):
        self._control.restore(answer, self._path(file))
        self._on_event(SimulationEvent.KIND_RESTORE, f"snapshot {file}")

    def _path(self, file):
        """Where a snapshot is that a request names."""
        if not file.endswith(".npz"):
            raise TssError(f"file is {file!r:.200}; allowed: a path that ends in .npz")
        return str(inside(self._folder, Path(self._folder) / file, "snapshot"))

    def _do_disturb(self, answer, request):
        if request.bead:
            offset_m, velocity_m_s, text = self._bead_disturbance(request)
        else:
            offset_m, velocity_m_s, text = self._random_disturbance(request)
        self._control.disturb(offset_m, velocity_m_s)
        self._on_event(SimulationEvent.KIND_DISTURB, text)
        answer.set_result(None)

    def _do_cut(self, answer, request):
        simulation = self._control.simulation
        names = simulation.setup.system.tether_name
        if request.tether not in names:
            raise Refused(
                Code.NOT_FOUND,
                f"tether {request.tether!r:.80} does not exist; the segments are "
                f"{', '.join(names):.200}",
            )
        time_ns = read_time(request.stamp, simulation.newest.time_ns)
        if not simulation.commands.post(Command(time_ns, names.index(request.tether), CUT)):
            raise TssError("too many commands of the future are kept; it is not")
        answer.set_result(None)

    def _do_fail(self, answer, request):
        simulation = self._control.simulation
        try:
            place = actuator(simulation.setup.system, request.actuator)
        except TssError as error:
            raise Refused(Code.NOT_FOUND, str(error)) from None
        if request.mode not in MODES:
            raise TssError(f"mode is {request.mode!r:.80}; allowed: {', '.join(MODES)}")
        require_obedient(simulation.setup.moving_system, place)
        time_ns = read_time(request.stamp, simulation.newest.time_ns)
        simulation.fail(Happened(time_ns, place, request.mode))
        answer.set_result(None)

    def _bead_disturbance(self, request):
        system = self._control.simulation.setup.system
        if request.bead not in system.bead_name:
            raise Refused(
                Code.NOT_FOUND,
                f"bead {request.bead!r:.80} does not exist; the beads are "
                f"{', '.join(system.bead_name):.200}",
            )
        if request.random_offset_m:
            raise TssError(
                f"random_offset_m is {request.random_offset_m:g}; allowed: 0 where a bead is named"
            )
        index = system.bead_name.index(request.bead)
        offset_m, impulse_n_s = (
            np.array([v.x, v.y, v.z]) for v in (request.offset_m, request.impulse_n_s)
        )
        # Beads on its reel move with a satellite.
        moved = self._control.simulation.index_out(index)
        velocity_m_s = impulse_n_s / self._control.simulation.part_out.system.mass_kg[moved]
        for name, values, limit in (
            ("offset_m", offset_m, MAX_OFFSET_M),
            ("impulse_n_s over the bead's mass", velocity_m_s, MAX_VELOCITY_M_S),
        ):
            if not np.all(np.abs(values) <= limit):
                raise TssError(
                    f"{name} is {values.tolist()}; allowed: -{limit:g} to {limit:g} in each"
                )
        if not (offset_m.any() or impulse_n_s.any()):
            raise TssError("offset_m and impulse_n_s are zero; allowed: at least one that is not")
        unit = (np.arange(system.n) == index)[:, None]
        shown = f"offset {offset_m.tolist()} m, impulse {impulse_n_s.tolist()} N s"
        return unit * offset_m, unit * velocity_m_s, f"{request.bead}: {shown}"

    def _random_disturbance(self, request):
        vectors = (request.offset_m, request.impulse_n_s)
        if any(value != 0.0 for v in vectors for value in (v.x, v.y, v.z)):
            raise TssError("offset_m and impulse_n_s need the name of a bead; bead is ''")
        size, seed = request.random_offset_m, request.seed
        if not 0.0 < size <= MAX_OFFSET_M:
            raise TssError(
                f"random_offset_m is {size:g}; allowed: a number above 0 to {MAX_OFFSET_M:g}"
            )
        if seed < 0:
            raise TssError(f"seed is {seed}; allowed: a whole number from 0")
        part = self._control.simulation.part_out
        still = np.zeros((part.beads.size, 3))
        offset_m = disturbed(State(still, still), size, seed).position_m[part.carrier]
        return offset_m, 0.0, f"all: random offsets of norm {size:g} m, seed {seed}"


def _refuse(_, text, code=Code.OPERATION_FAILED):
    raise Refused(code, text)
