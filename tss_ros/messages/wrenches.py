"""AppliedWrenches: what acts on a formation from outside, as a message, and read from one."""

from typing import Any

import numpy as np

from tss_ros.core import Commands, System
from tss_ros.core.model.commands import FRAMES
from tss_ros.core.model.reels import reels
from tss_ros.messages.cdr import serialised
from tss_ros.messages.steps import FRAME_ID, header
from tss_ros.messages.topics import read_topics

#: The topic.
TOPIC = "applied_wrenches"


def applied_wrenches(
    system: System,
    commands: Commands,
    time_ns: int,
    step: int,
    run: int = 0,
    frame_id: str = FRAME_ID,
) -> bytes:
    """A serialised AppliedWrenches.

    Parameters
    ----------
    system : System
    commands : Commands
    time_ns : int
        Simulation time [ns] from which they hold.
    step, run : int
        Of the first state that shows them.
    frame_id : str
        Name of the orbit frame.

    Returns
    -------
    bytes
    """
    frames, beads = np.nonzero(commands.force_n.any(axis=2))
    reeled = (commands.reel != Commands.none(system).reel).any(axis=1)
    said = {
        "header": header(time_ns, frame_id),
        "step": step,
        "run": run,
        "satellite": [system.bead_name[i] for i in beads],
        "frame": [FRAMES[i] for i in frames],
        "force_n": commands.force_n[frames, beads].ravel(),
        "cut_tether": [system.tether_name[i] for i in np.flatnonzero(commands.cut)],
        "reel_tether": [reels(system)[i].name for i in np.flatnonzero(reeled)],
        "reel": commands.reel[reeled].ravel(),
    }
    return serialised(read_topics()[TOPIC].definition, said)


def commands_of(system: System, message: Any) -> Commands:
    """What a message AppliedWrenches says.

    Raises
    ------
    TssError
        If it does not fit the system.
    """
    forces_n = np.reshape(message.force_n, (-1, 3))
    forces = zip(message.satellite, message.frame, forces_n, strict=True)
    # Bags made before there were reels have none.
    rows = np.reshape(getattr(message, "reel", ()), (-1, 5))
    reel = dict(zip(getattr(message, "reel_tether", ()), rows, strict=True))
    return Commands.of(system, forces, message.cut_tether, reel)
