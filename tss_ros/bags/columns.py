"""Columns of messages into MCAP at once, where one after another costs too much."""

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import Writer

from tss_ros.bags.records import HEAD, MESSAGE_HEAD

_INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


class ColumnWriter(Writer):
    """The library's writer, which also takes many messages of the same sizes in one call."""

    def add_columns(
        self,
        columns: dict[int, np.ndarray],
        log_time_ns: np.ndarray,
        publish_time_ns: int,
        sequence: int,
    ) -> None:
        """Write a chunk of messages; see `BagWriter.write_columns` for the arguments."""
        self.flush()  # what came before ends its chunk
        # The library has no door to a chunk; these are its own, by their mangled names.
        chunk, statistics = self._Writer__chunk_builder, self._Writer__statistics
        count, width = (
            len(log_time_ns),
            sum(MESSAGE_HEAD.itemsize + rows.shape[1] for rows in columns.values()),
        )
        table, at = np.empty((count, width), np.uint8), 0
        begins = chunk.count + width * np.arange(count)
        for channel, rows in columns.items():
            data = at + MESSAGE_HEAD.itemsize
            head = table[:, at:data].view(MESSAGE_HEAD)[:, 0]
            head["opcode"], head["length"] = Opcode.MESSAGE, data - at - HEAD.size + rows.shape[1]
            head["channel"] = channel
            head["sequence"] = (sequence + np.arange(count)) % 2**32
            head["log_time"], head["publish_time"] = log_time_ns, publish_time_ns
            table[:, data : data + rows.shape[1]] = rows
            index = np.empty(count, _INDEX_ENTRY)
            index["log_time"], index["offset"] = log_time_ns, begins + at
            chunk.message_indices[channel] = _Index(channel, index)
            statistics.channel_message_counts[channel] += count
            at = data + rows.shape[1]
        chunk.record_writer.write(table.data)
        chunk.num_messages = count * len(columns)
        first_ns, last_ns = int(log_time_ns.min()), int(log_time_ns.max())
        chunk.message_start_time, chunk.message_end_time = first_ns, last_ns
        if statistics.message_count:
            first_ns = min(first_ns, statistics.message_start_time)
        statistics.message_start_time = first_ns
        statistics.message_end_time = max(last_ns, statistics.message_end_time)
        statistics.message_count += chunk.num_messages
        self.flush()


class _Index(MessageIndex):
    """An index of messages whose entries are an array of `_INDEX_ENTRY`."""

    def write(self, stream: RecordBuilder) -> None:
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(self.records.nbytes)
        stream.write(self.records.tobytes())
        stream.finish_record()
