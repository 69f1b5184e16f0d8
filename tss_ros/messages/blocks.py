"""Steps in bulk: the serialised messages of many steps in one message, StepBlock."""

from typing import NamedTuple

import numpy as np

from tss_ros.core import TssError
from tss_ros.messages.cdr import Layout, serialised
from tss_ros.messages.topics import STATE_TOPICS, read_topics

#: The topic, and about how many bytes of messages one block has at most: larger messages do not go
#: through the shared memory of the middleware.
TOPIC, MOST_BYTES = "step_blocks", 128 * 1024
#: Largest step that a message may have.
MAX_STEP = 2**63 - 1


class Block(NamedTuple):
    """Steps that follow each other.

    Attributes
    ----------
    first_step : int
    time_ns : ndarray, shape (k,)
        Simulation times [ns].
    columns : dict of str to ndarray, shape (k, bytes), uint8
        Serialised messages by topic, all of `STATE_TOPICS`.
    """

    first_step: int
    time_ns: np.ndarray
    columns: dict[str, np.ndarray]


def pack(block: Block) -> bytes:
    """A block as a serialised StepBlock."""
    return serialised(
        read_topics()[TOPIC].definition,
        {
            "first_step": block.first_step,
            "time_ns": block.time_ns,
            "topic": list(block.columns),
            "size": [rows.shape[1] for rows in block.columns.values()],
            "data": np.concatenate(list(block.columns.values()), axis=1),
        },
    )


class Unpacker:
    """Takes blocks apart, and checks that every message in them is what its topic asks for."""

    def __init__(self) -> None:
        self._layouts = {}

    def unpack(self, data: bytes) -> Block:
        """A block from a serialised StepBlock.

        Parameters
        ----------
        data : bytes
            Well-formed: any middleware would read it.

        Returns
        -------
        Block

        Raises
        ------
        TssError
            If the block does not hold steps of the recorded types, or contradicts itself.
        """
        layout = Layout(read_topics()[TOPIC].definition, data)
        fields = layout.numbers(np.frombuffer(data, np.uint8)[None])[0]
        sizes, time_ns = fields["size"].tolist(), fields["time_ns"].copy()
        if len(sizes) != len(STATE_TOPICS) or fields["data"].size != sum(sizes) * time_ns.size:
            raise TssError(
                f"a block has {fields['data'].size} bytes for {time_ns.size} steps of {sizes} bytes"
            )
        first_step = int(fields["first_step"])
        if not time_ns.size or first_step > MAX_STEP - time_ns.size:
            raise TssError(
                f"a block has {time_ns.size} steps from {first_step}; allowed: at least one, to"
                f" {MAX_STEP} at most"
            )
        table, begin, columns = fields["data"].reshape(time_ns.size, -1), 0, {}
        for name, size in zip(STATE_TOPICS, sizes):
            columns[name] = table[:, begin : begin + size]
            begin += size
        steps = np.arange(first_step, first_step + time_ns.size, dtype=np.uint64)
        for name, rows in columns.items():
            numbers = self._numbers(name, rows)
            if "step" in numbers.dtype.names and (numbers["step"] != steps).any():
                raise TssError(f"a block's {name} are not steps {steps[0]} to {steps[-1]}")
            if name == "bead_states":
                seconds, nanoseconds = (numbers[f"header.stamp.{n}"] for n in ("sec", "nanosec"))
                if (seconds.astype(np.int64) * 10**9 + nanoseconds != time_ns).any():
                    raise TssError("a block's times are not those of its bead_states")
        return Block(first_step, time_ns, columns)

    def _numbers(self, name, rows):
        layout = self._layouts.get(name)
        if layout is None or not layout.fits(rows).all():
            definition = read_topics()[name].definition
            layout = self._layouts[name] = Layout(definition, rows[0].tobytes())
            if not layout.fits(rows).all():
                raise TssError(f"a block's {name} differ in their texts or lengths")
        return layout.numbers(rows)
