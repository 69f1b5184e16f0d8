"""How far the nodes reach: this machine only, unless the user asks for more."""

import contextlib
import os
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

from tss_ros.core import TssError

#: Fast DDS for this machine only. rmw_fastrtps itself binds to all interfaces for LOCALHOST,
#: whatever a profile says; for SYSTEM_DEFAULT it leaves everything to the profile.
PROFILE = Path(__file__).with_name("loopback.xml")
RANGE, PROFILES = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"
#: Beginnings of the addresses of this machine in /proc/net/udp and /proc/net/udp6.
_LOOPBACK = ("0100007F:", f"{0:024X}01000000:")


def stay_on_this_machine() -> None:
    """Before ROS starts: nobody on the network sees or drives the nodes of this process.

    A range, peers or a profile of the middleware that the user has set are left as they are.
    """
    os.environ[RANGE] = os.environ.get(RANGE) or "LOCALHOST"
    wanted = os.environ[RANGE] == "LOCALHOST" and not os.environ.get("ROS_STATIC_PEERS")
    if wanted and not os.environ.get(PROFILES):
        if get_rmw_implementation_identifier().startswith("rmw_fastrtps"):
            os.environ[PROFILES] = str(PROFILE)
            os.environ[RANGE] = "SYSTEM_DEFAULT"
    elif os.environ[RANGE] != "SYSTEM_DEFAULT" and os.environ.get(PROFILES) == str(PROFILE):
        del os.environ[PROFILES]  # inherited from a process that stayed on this machine


def check_reach() -> None:
    """After a node is made: whether `stay_on_this_machine` has had its way.

    Raises
    ------
    TssError
        If a socket of the middleware can be reached from other machines all the same.
    """
    if os.environ.get(PROFILES) != str(PROFILE):
        return
    own = set()
    for number in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):  # closed meanwhile
            own.add(os.readlink(f"/proc/self/fd/{number}"))
    for table in ("/proc/self/net/udp", "/proc/self/net/udp6"):
        for line in Path(table).read_text(encoding="ascii").splitlines()[1:]:
            address, inode = line.split()[1], line.split()[9]
            if f"socket:[{inode}]" in own and not address.startswith(_LOOPBACK):
                raise TssError(
                    f"the middleware listens beyond this machine (at {address}), though {PROFILE} "
                    f"forbids it; set {RANGE} to say what you want"
                )
