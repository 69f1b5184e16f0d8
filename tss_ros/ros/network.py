"""How far the nodes reach: this machine only, unless the user asks for more."""

import contextlib
import os
import re
import socket
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.logging import get_logger
from rclpy.utilities import get_default_context, get_rmw_implementation_identifier

from tss_ros.core import TssError

#: Fast DDS for this machine only. rmw_fastrtps itself binds to all interfaces for LOCALHOST,
#: whatever a profile says; for SYSTEM_DEFAULT it leaves everything to the profile.
PROFILE = Path(__file__).resolve().with_name("loopback.xml")
RANGE, PROFILES = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"
#: Beginnings of the addresses of this machine in /proc/net/udp and /proc/net/udp6.
_LOOPBACK = ("0100007F", f"{0:024X}01000000")
#: How long [s] others may take to replace shared memory, and how often to join at most.
SETTLE_S, JOIN_ATTEMPTS = 0.1, 10
#: Where the participants of a domain listen, as RTPS has it: the first port of all, ports of a
#: domain, and the first of the two ports of each participant. So many find each other.
FIRST_PORT, PER_DOMAIN, UNICAST, PARTICIPANTS = 7400, 250, 10, 32


def stay_on_this_machine() -> None:
    """Before ROS starts: nobody on the network sees or drives the nodes of this process.

    A range, peers or a profile of the middleware that the user has set are left as they are.
    """
    os.environ[RANGE] = os.environ.get(RANGE) or "LOCALHOST"
    wanted = os.environ[RANGE] == "LOCALHOST" and not os.environ.get("ROS_STATIC_PEERS")
    own = os.environ.get(PROFILES) == str(PROFILE)  # inherited from a process that stayed here
    if wanted and (own or not os.environ.get(PROFILES)):
        if get_rmw_implementation_identifier().startswith("rmw_fastrtps"):
            os.environ[PROFILES] = str(PROFILE)
            os.environ[RANGE] = "SYSTEM_DEFAULT"
    elif os.environ[RANGE] != "SYSTEM_DEFAULT" and own:
        del os.environ[PROFILES]


@contextlib.contextmanager
def joined(context: Context | None = None) -> Iterator[None]:
    """Make this process a participant of the graph, one that hears; nodes are made inside.

    A process that takes the place of a killed one gets its shared memory, too. Others may still
    hold that then: they write to it for good, where nobody reads, or find it dead, and replace it
    behind the back of the new owner, who hears nothing from then on. So this takes no such place,
    and joins anew until its own memory has not been replaced.

    Parameters
    ----------
    context : rclpy.context.Context, optional
        Initialised; by default rclpy's own.

    Raises
    ------
    TssError
        If the participant does not hear, or can be reached from other machines although
        `stay_on_this_machine` has been called.
    """
    for attempt in range(JOIN_ATTEMPTS):
        # Hidden; its context's participant is that of the nodes made inside.
        with _past_the_dead((context or get_default_context()).get_domain_id()):
            node = rclpy.create_node(
                f"_joining_{os.getpid()}_{attempt}",
                context=context,
                use_global_arguments=False,  # which may name all nodes of the process alike
                enable_rosout=False,
                start_parameter_services=False,
            )
        try:
            time.sleep(SETTLE_S)
            if not (lost := lost_ports()):
                _check_reach()
                yield
                return
        finally:
            node.destroy_node()
        get_logger("network").warning(f"{shared_memory_lost(lost)}; joining anew")
    raise TssError(shared_memory_lost(lost))


@contextlib.contextmanager
def _past_the_dead(domain_id):
    """Keep the next participant away from ports of the dead whose memory others still hold."""
    with contextlib.ExitStack() as kept:
        for participant in range(PARTICIPANTS):
            port = FIRST_PORT + PER_DOMAIN * domain_id + UNICAST + 2 * participant
            taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                taken.bind(("127.0.0.1", port))
            except OSError:
                taken.close()  # somebody lives there
                continue
            kept.enter_context(taken)
            if not (_is_held(port) or _is_held(port + 1)):
                taken.close()
                break
        else:
            kept.close()  # better a place of the dead than one where nobody looks
        yield


def _is_held(port):
    """Whether another process holds the shared memory that somebody has left at a port."""
    if not Path(f"/dev/shm/fastrtps_port{port}").exists():
        return False
    others = (p for p in os.listdir("/proc") if p.isdecimal() and int(p) != os.getpid())
    for process in others:
        with contextlib.suppress(OSError):  # ended, or another user's
            maps = Path(f"/proc/{process}/maps").read_text(encoding="utf-8", errors="replace")
            if re.search(rf"fastrtps_port{port}\b", maps):
                return True
    return False


def lost_ports() -> list[int]:
    """Ports of this process at which nothing arrives, as their shared memory has been replaced."""
    maps = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace")
    deleted = {int(port) for port in re.findall(r"fastrtps_port(\d+) \(deleted\)", maps)}
    return sorted(deleted & {port for _, port in _own_sockets()}) if deleted else []


def shared_memory_lost(ports: Iterable[int]) -> str:
    """What to say of `lost_ports`."""
    shown = ", ".join(map(str, ports))
    return (
        f"another process has replaced the shared memory of port {shown}, "
        "so nothing is heard there (this may follow when a node is killed)"
    )


def _check_reach():
    if os.environ.get(PROFILES) == str(PROFILE):
        for address, _ in _own_sockets():
            if not address.startswith(_LOOPBACK):
                raise TssError(
                    f"the middleware listens beyond this machine (at {address}), though {PROFILE} "
                    f"forbids it; set {RANGE} to say what you want"
                )


def _own_sockets():
    """Hexadecimal address and port of each UDP socket of this process."""
    own = set()
    for number in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):  # closed meanwhile
            own.add(os.readlink(f"/proc/self/fd/{number}"))
    sockets = []
    for table in ("/proc/self/net/udp", "/proc/self/net/udp6"):
        for line in Path(table).read_text(encoding="ascii").splitlines()[1:]:
            (address, _, port), inode = line.split()[1].partition(":"), line.split()[9]
            if f"socket:[{inode}]" in own:
                sockets.append((address, int(port, 16)))
    return sockets
