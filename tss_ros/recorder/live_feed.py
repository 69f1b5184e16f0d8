"""From the recorder's messages to a live Rerun viewer, without delaying the recorder."""

import threading
from collections import deque

import numpy as np
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.serialization import deserialize_message
from tss_interfaces.msg import BeadStates, FloquetResult, SystemDescription, TetherStates

from tss_ros.bags.older import completed_rests
from tss_ros.bags.recording import Description, Recording
from tss_ros.core import TssError
from tss_ros.messages.cdr import stamp_ns, step_number

#: The viewer gets at most this many steps, this often [s]; a display shows no more.
STEPS, PERIOD_S = 20, 0.1
#: Serialised messages of a topic that wait to be shown; newer ones replace the oldest.
WAITING = 2000


class LiveFeed:
    """Decodes some of the recorded steps and shows them, in a thread of its own.

    Parameters
    ----------
    logger : rclpy logger
        Gets an error if there is no viewer; recording goes on without.
    earth : bool
        Whether to show the Earth, too.
    """

    def __init__(self, logger: RcutilsLogger, earth: bool = False) -> None:
        self._logger, self._earth = logger, earth
        self._waiting = {
            name: deque(maxlen=WAITING)
            for name in ("system_description", "bead_states", "tether_states", "stability_results")
        }
        self._description = None
        self._beads, self._tethers, self._stability = {}, {}, ()
        self._shown_step, self._first_step = -1, 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._show, daemon=True)

    def start(self) -> None:
        """Open the viewer and begin to show."""
        self._thread.start()

    def take(self, name: str, data: bytes) -> None:
        """Take one serialised message of the topic `name`; returns at once."""
        if name in self._waiting:
            self._waiting[name].append(data)

    def stop(self) -> None:
        """Let go of the viewer, within about a second."""
        self._stopping.set()
        self._thread.join(timeout=1.0)

    def _show(self):
        # Imported here because Rerun takes a second to load, and few runs need it.
        from tss_ros.review.review import LiveReview

        try:
            review = LiveReview(earth=self._earth)
            while not self._stopping.wait(PERIOD_S):
                self._show_waiting(review)
            review.close()
        except TssError as error:
            self._logger.error(f"no live view, recording goes on without: {error}")

    def _show_waiting(self, review):
        descriptions = self._take("system_description")
        beads = {step_number(data): data for data in self._take("bead_states")}
        tethers = {step_number(data): data for data in self._take("tether_states")}
        began_anew = beads and min(beads) <= self._shown_step
        if self._shown_step >= 0 and (descriptions or began_anew):
            review.begin()
            self._beads, self._tethers, self._shown_step = {}, {}, -1
        if descriptions:
            message = deserialize_message(descriptions[-1], SystemDescription)
            self._description, self._first_step = Description.of(message), message.first_step
        results = [deserialize_message(d, FloquetResult) for d in self._take("stability_results")]
        self._stability += tuple(results)
        self._beads |= {step: data for step, data in beads.items() if step >= self._first_step}
        self._tethers |= tethers
        steps = sorted(self._beads.keys() & self._tethers.keys())
        first = self._shown_step < 0
        if self._description and steps:
            shown = steps[:: 1 + len(steps) // STEPS]
            states = [(self._beads[step], self._tethers[step]) for step in shown]
            arrays = _arrays(states, self._description.rest_length_m)
            review.show(Recording(**vars(self._description), **arrays))
            self._shown_step = steps[-1]
            # What is left are steps of which only one half has come so far.
            for waiting in (self._beads, self._tethers):
                for step in [step for step in waiting if step <= steps[-1]]:
                    del waiting[step]
        if self._stability and self._shown_step >= 0 and (first or results):
            review.show_stability(self._stability)

    def _take(self, name):
        waiting = self._waiting[name]
        return [waiting.popleft() for _ in range(len(waiting))]


def _arrays(serialised, rest_length_m):
    """Pairs of serialised bead and tether states as the arrays of a Recording."""
    beads = [deserialize_message(data, BeadStates) for data, _ in serialised]
    tethers = [deserialize_message(data, TetherStates) for _, data in serialised]

    def vectors(name):
        return np.reshape([getattr(message, name) for message in beads], (len(beads), -1, 3))

    said = (
        [list(getattr(t, name)) for t in tethers] for name in ("rest_length_m", "rest_rate_m_s")
    )
    rests_m, rest_rates_m_s = completed_rests(tuple(said), rest_length_m, len(tethers))
    return {
        "rests_m": rests_m,
        "rest_rates_m_s": rest_rates_m_s,
        "step": np.array([message.step for message in beads]),
        "t_s": np.array([stamp_ns(data) / 1e9 for data, _ in serialised]),
        "position_m": vectors("position_m"),
        "velocity_m_s": vectors("velocity_m_s"),
        "deviation": np.array([message.deviation for message in beads]),
        "length_m": np.array([message.length_m for message in tethers]),
        "tension_n": np.array([message.tension_n for message in tethers]),
        "taut": np.array([message.taut for message in tethers], dtype=bool),
    }
