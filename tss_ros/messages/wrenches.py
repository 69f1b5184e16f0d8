"""AppliedWrenches: what acts on a formation from outside, as a message, and read from one."""

from typing import Any

import numpy as np

from tss_ros.core import Commands, System
from tss_ros.core.model.commands import FRAMES
from tss_ros.core.model.failures import DEAD, STUCK, Change, actuator
from tss_ros.core.model.reels import reel_names
from tss_ros.messages.cdr import serialised
from tss_ros.messages.steps import FRAME_ID, header
from tss_ros.messages.topics import read_topics

#: The topic.
TOPIC = "applied_wrenches"


def applied_wrenches(
    system: System,
    change: Change,
    step: int,
    run: int = 0,
    frame_id: str = FRAME_ID,
) -> bytes:
    """A serialised AppliedWrenches.

    Parameters
    ----------
    system : System
    change : Change
        Of a simulation time [ns].
    step, run : int
        Of the first state that shows them.
    frame_id : str
        Name of the orbit frame.

    Returns
    -------
    bytes
    """
    commands, failed = change.commands, change.failed
    frames, beads = np.nonzero(commands.force_n.any(axis=2))
    reeled = (commands.reel != Commands.none(system).reel).any(axis=1)
    said = {
        "header": header(change.time, frame_id),
        "step": step,
        "run": run,
        "satellite": [system.bead_name[i] for i in beads],
        "frame": [FRAMES[i] for i in frames],
        "force_n": commands.force_n[frames, beads].ravel(),
        "cut_tether": [system.tether_name[i] for i in np.flatnonzero(commands.cut)],
        "dead_actuator": [name for name, mode in failed if mode == DEAD],
        "stuck_actuator": [name for name, mode in failed if mode == STUCK],
        "reel_tether": [reel_names(system)[i] for i in np.flatnonzero(reeled)],
        "reel": commands.reel[reeled].ravel(),
    }
    return serialised(read_topics()[TOPIC].definition, said)


def change_of(system: System, message: Any) -> Change:
    """What a message AppliedWrenches says.

    Raises
    ------
    TssError
        If it does not fit the system.
    """
    forces_n = np.reshape(message.force_n, (-1, 3))
    forces = zip(message.satellite, message.frame, forces_n, strict=True)
    stamp = message.header.stamp
    modes = {DEAD: "dead_actuator", STUCK: "stuck_actuator"}
    # Bags made before actuators could fail, or before there were reels, have none of them.
    failed = [(name, mode) for mode, f in modes.items() for name in getattr(message, f, ())]
    failed.sort(key=lambda pair: actuator(system, pair[0]))
    rows = np.reshape(getattr(message, "reel", ()), (-1, 5))
    reel = dict(zip(getattr(message, "reel_tether", ()), rows, strict=True))
    commands = Commands.of(system, forces, message.cut_tether, reel)
    return Change(stamp.sec * 10**9 + stamp.nanosec, commands, tuple(failed))
