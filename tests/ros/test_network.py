"""How far nodes reach: real sockets of real nodes, and a client on another address."""

import os
import socket
import subprocess
import sys

import pytest
import ros_harness

from tss_ros.ros.network import PROFILE, PROFILES, RANGE

#: Beginning of 127.0.0.1 and a port in /proc/net/udp.
LOOPBACK = "0100007F:"
#: A participant of Fast DDS that uses one address only, and not shared memory.
ONE_ADDRESS = """<profiles xmlns="http://www.eprosima.com"><transport_descriptors><transport_descriptor>
<transport_id>one</transport_id><type>UDPv4</type><interfaceWhiteList><address>{0}</address></interfaceWhiteList>
</transport_descriptor></transport_descriptors>
<participant profile_name="one" is_default_profile="true"><rtps>
<userTransports><transport_id>one</transport_id></userTransports><useBuiltinTransports>false</useBuiltinTransports>
<builtin><initialPeersList><locator><udpv4><address>{0}</address></udpv4></locator></initialPeersList></builtin>
</rtps></participant></profiles>"""  # noqa: E501
#: Prints whether the simulator is seen within 8 s.
LOOK = """
import time, rclpy
rclpy.init()
node = rclpy.create_node("looker")
deadline = time.monotonic() + 8
while time.monotonic() < deadline and "sim_node" not in node.get_node_names():
    time.sleep(0.1)
print("sim_node" in node.get_node_names())
"""


def reach(**values):
    """An environment that says how far to go; what is not given is not set."""
    environ = {k: v for k, v in os.environ.items() if k not in (RANGE, PROFILES)}
    return {"env": environ | values}


def udp_addresses(pid):
    """Local addresses, in hexadecimal, of a process's UDP sockets."""
    return [row[1] for row in ros_harness.sockets_of(pid, "udp")]


def other_address():
    """An address of this machine that is not loopback's."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("198.51.100.1", 9))  # sends nothing
        except OSError:
            pytest.skip("this machine has no address but loopback's")
        return probe.getsockname()[0]


@pytest.mark.parametrize(
    ("executable", "given"),
    [
        ("sim_node", {}),
        ("logger_node", {}),
        ("stability_node", {}),
        ("sim_node", {RANGE: "LOCALHOST", PROFILES: str(PROFILE)}),  # the profile is inherited
    ],
)
def test_nodes_listen_on_loopback_only(start, executable, given):
    ready = {"sim_node": "one turn", "logger_node": "recording", "stability_node": "ready for"}
    process = start(executable, options=reach(**given))
    process.wait_for_line(ready[executable])
    addresses = udp_addresses(process.pid)
    assert len(addresses) >= 3
    assert [a for a in addresses if not a.startswith(LOOPBACK)] == []
    assert process.stop() == 0


@pytest.mark.parametrize("given", [{RANGE: "SUBNET"}, {RANGE: "LOCALHOST", PROFILES: "/dev/null"}])
def test_what_the_user_has_set_is_left(start, given):
    process = start("sim_node", options=reach(**given))
    process.wait_for_line("one turn")
    assert any(not a.startswith(LOOPBACK) for a in udp_addresses(process.pid))
    assert process.stop() == 0


@pytest.mark.parametrize("profile", ["ours", "none"])
def test_a_client_on_another_address_sees_no_simulator(start, tmp_path, profile):
    """Without the profile it does, though the range is this machine."""
    address, file = other_address(), tmp_path / "one.xml"
    file.write_text(ONE_ADDRESS.format(address))
    process = start("sim_node", options=reach(**({} if profile == "ours" else {PROFILES: "-"})))
    process.wait_for_line("one turn")
    client = reach(**{RANGE: "SYSTEM_DEFAULT", PROFILES: str(file)})
    looked = subprocess.run(
        [sys.executable, "-c", LOOK], capture_output=True, text=True, timeout=60, **client
    )
    assert looked.stdout.strip() == ("False" if profile == "ours" else "True"), looked.stderr
    assert process.stop() == 0
