"""Tells a recorder that hears nothing from one that has nothing to hear."""

import time
from collections.abc import Sequence

from rclpy.impl.rcutils_logger import RcutilsLogger
from tss_interfaces.msg import SimulationStatus

from tss_ros.core import TssError
from tss_ros.recorder.recorded_topic import RecordedTopic
from tss_ros.ros.network import lost_ports, shared_memory_lost

#: How long [s] a topic may be silent, or without a publisher, before that is said.
SILENT_S = 3.0
#: A simulator reports twice a second; one not heard for so long [s] does not run beside us.
BESIDE_S = 2.0


class Watch:
    """Looks, now and then, whether what simulators publish arrives.

    Parameters
    ----------
    topics : sequence of RecordedTopic
    logger : rclpy logger

    Attributes
    ----------
    complaint : str
        What is wrong at present; empty if nothing is.
    """

    def __init__(self, topics: Sequence[RecordedTopic], logger: RcutilsLogger) -> None:
        self.complaint = ""
        self._topics = [topic for topic in topics if topic.of_simulator]
        self._logger = logger
        self._status, self._status_at = None, -BESIDE_S
        self._heard, self._heard_at = 0, time.monotonic()
        self._step_then = None  # that the simulator was at when we last heard a step
        self._unmatched_since = {}

    def on_status(self, status: SimulationStatus) -> None:
        """Take what a simulator says of itself."""
        if self._step_then is None or status.step < self._step_then:
            self._step_then = status.step
        self._status, self._status_at = status, time.monotonic()

    def look(self) -> None:
        """Find out what is wrong, and say so.

        Raises
        ------
        TssError
            If this process can hear nothing any more.
        """
        if lost := lost_ports():
            raise TssError(f"{shared_memory_lost(lost)}; the recording ends here, complete")
        earlier, self.complaint = self.complaint, self._find()
        if self.complaint:
            self._logger.warning(self.complaint, throttle_duration_sec=10.0)
        elif earlier:
            self._logger.info("messages arrive again")

    def _find(self):
        now, heard = time.monotonic(), sum(t.heard for t in self._topics if t.every_step)
        if heard != self._heard:
            self._heard, self._heard_at, self._step_then = heard, now, None
        beside = now - self._status_at < BESIDE_S
        matched = [t for t in self._topics if t.subscription.get_publisher_count()]
        for topic in self._topics:
            if topic in matched or not beside:
                self._unmatched_since.pop(topic, None)
        alone = [
            topic.full_name
            for topic in self._topics
            if beside
            and topic not in matched
            and now - self._unmatched_since.setdefault(topic, now) > SILENT_S
        ]
        if alone:
            return f"a simulator runs, but nobody publishes {', '.join(alone)} to this recorder"
        silent_s = now - max(self._heard_at, self._status_at)
        if matched and silent_s > SILENT_S:
            names = ", ".join(topic.full_name for topic in matched)
            return f"nothing has come for {silent_s:.0f} s, though these have a publisher: {names}"
        waited_s = now - self._heard_at
        if beside and waited_s > SILENT_S and self._status.step > (self._step_then or 0):
            return (
                f"the simulator is at step {self._status.step}, but no step has come here for "
                f"{waited_s:.0f} s"
            )
        return ""
