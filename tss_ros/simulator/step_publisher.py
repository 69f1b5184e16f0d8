"""Publishes steps: each topic's messages one by one, and all of them in blocks for recorders."""

import time
from collections.abc import Mapping

import numpy as np
from rclpy.publisher import Publisher

from tss_ros.messages import blocks
from tss_ros.messages.steps import StepMessages
from tss_ros.messages.topics import STATE_TOPICS
from tss_ros.simulator.setup import Setup
from tss_ros.simulator.trajectory import Sample

#: Topics that are made only for those who listen.
FOR_VIEWERS = ("markers", "bead_cloud", "tether_lengths")
#: Steps wait so long [s] at most for others to share their block.
BLOCK_S = 0.02


class StepPublisher:
    """Publishes the newest step; for the simulation's thread alone.

    Parameters
    ----------
    publishers : mapping of str to rclpy.publisher.Publisher
        By topic, those of `STATE_TOPICS` and of blocks among them.
    frame_id : str
        Name of the orbit frame.
    """

    def __init__(self, publishers: Mapping[str, Publisher], frame_id: str) -> None:
        self._publishers, self._frame_id = publishers, frame_id
        self._blocks = publishers[blocks.TOPIC]
        self._waiting = []  # steps for the next block, with their samples
        self._waiting_since = 0.0
        self._shown = None

    def begin(self, setup: Setup) -> None:
        """Begin a run; what waits of the one before goes out first."""
        self.flush()
        self._messages = StepMessages(setup.system, setup.tension_n, self._frame_id)
        self._serialised = {}

    def publish(self, step: int, sample: Sample, new_run: bool) -> None:
        """Publish a step, the first of a new run if `new_run` is true."""
        self._shown = step, sample, new_run
        for name in STATE_TOPICS:
            if name not in FOR_VIEWERS or self._publishers[name].get_subscription_count():
                self.publish_topic(name)
        if not self._blocks.get_subscription_count():
            self._waiting.clear()
            return
        if self._waiting and self._waiting[-1][1].states is not sample.states:
            self.flush()
        if not self._waiting:
            self._waiting_since = time.monotonic()
            step_bytes = sum(self._row(name).size for name in STATE_TOPICS)
            self._most = 1 if new_run else max(1, blocks.MOST_BYTES // step_bytes)
        self._waiting.append(self._shown)
        late = time.monotonic() - self._waiting_since > BLOCK_S
        if late or len(self._waiting) >= self._most:
            self.flush()

    def publish_topic(self, name: str) -> None:
        """Publish what this topic says of the newest step."""
        if name == blocks.TOPIC:
            self.flush()
            self._waiting = [self._shown]
            self.flush()
        else:
            self._publishers[name].publish(self._row(name).tobytes())

    def flush(self) -> None:
        """Publish the steps that wait for a block."""
        if not self._waiting:
            return
        (first_step, sample, new_run), count = self._waiting[0], len(self._waiting)
        self._waiting.clear()
        if new_run:
            columns = {name: self._row(name)[None] for name in STATE_TOPICS}
            time_ns = np.array([sample.time_ns])
        else:
            rows = slice(sample.row, sample.row + count)
            columns = {name: self._rows(name, first_step, sample)[rows] for name in STATE_TOPICS}
            times_ns = sample.states.time_ns
            time_ns = sample.time_ns + times_ns[rows] - times_ns[sample.row]
        self._blocks.publish(blocks.pack(blocks.Block(first_step, time_ns, columns)))

    def _row(self, name):
        """A topic's message of the newest step."""
        step, sample, new_run = self._shown
        if name == "markers" and new_run:
            return self._messages.rows(name, step, sample.alone, clearing=True)[0]
        return self._rows(name, step, sample)[sample.row]

    def _rows(self, name, step, sample):
        """A topic's messages of all states that were computed with this one, made once."""
        first_step, begin_ns = step - sample.row, sample.time_ns - sample.states.time_ns[sample.row]
        states, *place, rows = self._serialised.get(name, (None, None))
        if states is not sample.states or place != [first_step, begin_ns]:
            states = sample.states
            shifted = states._replace(time_ns=states.time_ns + begin_ns)
            rows = self._messages.rows(name, first_step, shifted)
            self._serialised[name] = states, first_step, begin_ns, rows
        return rows
