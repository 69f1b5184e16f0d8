"""How far the goals of the stability node's actions are, as the feedback that is still to be sent.

Work adds what it finds, in any thread; the node takes it from there several times a second.
"""

import threading

from tss_interfaces.action import Follow, Sweep
from tss_interfaces.msg import FamilyPoint, SweepRow


class SweepProgress:
    """How far a sweep is, and what it found that no feedback has carried yet."""

    def __init__(self) -> None:
        self.done = self.total = 0
        self._unsent = []
        self._lock = threading.Lock()

    def add(self, i: int, piece: SweepRow) -> None:
        """Take what a job found for row `i`."""
        with self._lock:
            self._unsent.append((i, piece))
            self.done += 1

    def take(self) -> list[Sweep.Feedback]:
        """A feedback for each row of which something is unsent."""
        with self._lock:
            done, unsent, self._unsent = self.done, self._unsent, []
        rows = {}
        for i, piece in unsent:
            join(rows.setdefault(i, empty_row(piece)), piece)
        return [Sweep.Feedback(done=done, total=self.total, row=row) for row in rows.values()]


class FollowProgress:
    """How far a family is, and its points that no feedback has carried yet."""

    def __init__(self) -> None:
        self._done, self._unsent = 0.0, []
        self._lock = threading.Lock()

    def add(self, done: float, point: FamilyPoint) -> None:
        """Take a point and the share of the interval that is done."""
        with self._lock:
            self._unsent.append(point)
            self._done = done

    def take(self) -> list[Follow.Feedback]:
        """One feedback with all points that are unsent, if there are any."""
        with self._lock:
            done, unsent, self._unsent = self._done, self._unsent, []
        return [Follow.Feedback(done=done, points=unsent)] if unsent else []


def empty_row(of: SweepRow, **fields: object) -> SweepRow:
    """An empty row of the same value."""
    return SweepRow(value=of.value, text_value=of.text_value, **fields)


def join(row: SweepRow, piece: SweepRow) -> None:
    """Add to a row what a piece of it holds."""
    row.message = row.message or piece.message
    row.results.extend(piece.results)
    row.rates.extend(piece.rates)
