"""A bag as it was made before bags named the tether law."""

from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic
from rclpy.serialization import serialize_message
from small_bag import TOPICS, Bag
from tss_interfaces.msg import Confirmation, FloquetResult

#: Fields that came with the laws.
LATER = ("tether_law", "law_parameter_name", "law_parameter", "pushing_share")
#: Fields of TetherStates that came with reels.
LATER_OF_TETHERS = ("rest_length_m", "rest_rate_m_s")
RESULT = FloquetResult(
    spin_rate_ratio=-2.0,
    family=["spin", "shape"],
    multiplier_real=[1.0, 0.5],
    verdict="neutral",
    max_modulus=1.25,
    switches=3,
    confirmation=[Confirmation(held=True, switches=7)],
)


class OldBag(Bag):
    """A bag whose types lack the fields that are `LATER`."""

    topics = (*Bag.topics, "stability_results")

    def definition(self, topic):
        lines = topic.definition.splitlines()
        later = LATER + LATER_OF_TETHERS * topic.type.endswith("TetherStates")
        return "\n".join(line for line in lines if line.split()[1:2] not in [[n] for n in later])

    def write(self, name, message, time_ns):
        topic = TOPICS[name]
        decoded = generate_dynamic(topic.type, topic.definition)[topic.type](
            bytes(serialize_message(message))
        )
        encode = serialize_dynamic(topic.type, self.definition(topic))[topic.type]
        data = encode(decoded)
        self.writer.write(self._channel[name], data, time_ns, time_ns, 0)


def make(directory, steps):
    """A closed bag of so many steps, with a description and a stability result."""
    bag = OldBag(directory)
    bag.describe()
    bag.write("stability_results", RESULT, 0)
    for number in range(steps):
        bag.step(number)
    bag.writer.close()
    return bag
