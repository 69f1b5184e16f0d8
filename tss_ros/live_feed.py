"""From the recorder's messages to a live Rerun viewer, without delaying the recorder."""

import math
import threading
from collections import deque

import numpy as np
from rclpy.serialization import deserialize_message
from tss_interfaces.msg import BeadStates, SystemDescription, TetherStates

from tss_ros.cdr import stamp_ns, step_number
from tss_ros.core import TssError

#: The viewer gets at most this many steps, this often [s]; a display shows no more.
STEPS, PERIOD_S = 20, 0.1
#: Serialised messages of a topic that wait to be shown; newer ones replace the oldest.
WAITING = 2000


class LiveFeed:
    """Decodes some of the recorded steps and shows them, in a thread of its own.

    Parameters
    ----------
    logger : rclpy logger
        Told if there is no viewer; recording goes on without.
    """

    def __init__(self, logger):
        self._logger = logger
        self._waiting = {
            name: deque(maxlen=WAITING)
            for name in ("system_description", "bead_states", "tether_states")
        }
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._show, daemon=True)

    def start(self):
        """Open the viewer and begin to show."""
        self._thread.start()

    def take(self, name, data):
        """Take one serialised message of the topic `name`; returns at once."""
        if name in self._waiting:
            self._waiting[name].append(data)

    def stop(self):
        """Let go of the viewer, within about a second."""
        self._stopping.set()
        self._thread.join(timeout=1.0)

    def _show(self):
        # Imported here because Rerun takes a second to load, and few runs need it.
        from tss_ros.review import LiveReview

        try:
            review = LiveReview()
        except TssError as error:
            self._logger.error(f"no live view, recording goes on without: {error}")
            return
        described, beads, tethers = False, {}, {}
        while not self._stopping.wait(PERIOD_S):
            described = described or self._describe(review)
            if not described:
                continue
            beads |= {step_number(data): data for data in self._take_waiting("bead_states")}
            tethers |= {step_number(data): data for data in self._take_waiting("tether_states")}
            if steps := sorted(beads.keys() & tethers.keys()):
                shown = steps[:: 1 + len(steps) // STEPS]
                review.log(**_arrays([(beads[step], tethers[step]) for step in shown]))
                # What is left are steps of which only one half has come so far.
                beads = {step: data for step, data in beads.items() if step > steps[-1]}
                tethers = {step: data for step, data in tethers.items() if step > steps[-1]}
        review.close()

    def _take_waiting(self, name):
        waiting = self._waiting[name]
        return [waiting.popleft() for _ in range(len(waiting))]

    def _describe(self, review):
        for data in self._take_waiting("system_description"):
            message = deserialize_message(data, SystemDescription)
            review.static(
                bead_name=message.bead_name,
                is_satellite=np.array(message.is_satellite),
                tether_name=message.tether_name,
                tether_ends=np.reshape(message.tether_ends, (-1, 2)),
                turn_s=2.0 * math.pi / abs(message.spin_rate_ratio * message.orbit_rate_rad_s),
            )
            return True
        return False


def _arrays(serialised):
    """Pairs of serialised bead and tether states as the arrays that `LiveReview.log` takes."""
    beads = [deserialize_message(data, BeadStates) for data, _ in serialised]
    tethers = [deserialize_message(data, TetherStates) for _, data in serialised]
    return {
        "step": np.array([message.step for message in beads]),
        "t_s": np.array([stamp_ns(data) / 1e9 for data, _ in serialised]),
        "position_m": np.reshape([message.position_m for message in beads], (len(beads), -1, 3)),
        "deviation": np.array([message.deviation for message in beads]),
        "length_m": np.array([message.length_m for message in tethers]),
        "tension_n": np.array([message.tension_n for message in tethers]),
        "taut": np.array([message.taut for message in tethers]),
    }
