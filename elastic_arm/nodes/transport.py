"""Transport of the nodes' samples: UDP, also on this machine, never Fast DDS's shared memory.

Fast DDS 2.14 keeps the queue of a reader in a file of shared memory, under a lock that outlives its
holder (`boost::interprocess::interprocess_mutex` is not robust). A reader that is killed while it
takes a sample leaves the lock held, and every publisher to it waits in
`SharedMemManager::Port::try_push`: the death of a recorder would stop the arm. A socket is closed
together with its process.

For `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` a variable is not sufficient, because rmw_fastrtps
then sets up shared memory itself. `fastdds_loopback.xml` therefore states the set-up of that range,
and the variable is set to the range that changes nothing.
"""

from collections.abc import MutableMapping
from pathlib import Path

PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
TRANSPORTS_VARIABLE = "FASTDDS_BUILTIN_TRANSPORTS"
RANGE_VARIABLE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCALHOST_VARIABLE = "ROS_LOCALHOST_ONLY"
PEERS_VARIABLE = "ROS_STATIC_PEERS"
PROFILE = Path(__file__).with_name("fastdds.xml")
LOOPBACK_PROFILE = Path(__file__).with_name("fastdds_loopback.xml")


def choose_transport(environment: MutableMapping[str, str]) -> None:
    """Set the variables of Fast DDS and rmw_fastrtps; other middleware ignores them.

    A profile or transports of the user's own count. Static peers beside `LOCALHOST` keep what
    rmw_fastrtps sets up.

    environment: of the process, before ROS is initialised; changed in place.
    """
    if PROFILE_VARIABLE in environment:
        return
    own_transports = TRANSPORTS_VARIABLE in environment
    local = (
        environment.get(LOCALHOST_VARIABLE) == "1" or environment.get(RANGE_VARIABLE) == "LOCALHOST"
    )
    if local and not own_transports and not environment.get(PEERS_VARIABLE):
        environment[PROFILE_VARIABLE] = str(LOOPBACK_PROFILE)
        environment[RANGE_VARIABLE] = "SYSTEM_DEFAULT"
        environment.pop(LOCALHOST_VARIABLE, None)
        return
    environment[PROFILE_VARIABLE] = str(PROFILE)
    if not own_transports:
        environment[TRANSPORTS_VARIABLE] = "UDPv4"
