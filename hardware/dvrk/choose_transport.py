"""The transport that a configuration asks for. ROS is imported here and nowhere earlier, so that all else runs without it."""

from __future__ import annotations

import time

from hardware.dvrk.transport import Clock, Transport, TransportError

ROS1_MISSING = (
    "ROS 1 is not installed for this Python ({error}); on Debian 12 run `make ros` in the repository as root, "
    "elsewhere install rospy, sensor_msgs, geometry_msgs and std_srvs for Python 3.11"
)
ROS2_MISSING = "ROS 2 is not installed for this Python ({error}); source the setup.bash of the dVRK's workspace first"
KINDS = ("ros1", "ros2")


def make_transport(kind: str, node_name: str, clock: Clock = time.monotonic) -> Transport:
    """Join the graph as a node called `node_name`, by `kind` "ros1" (the master of ROS_MASTER_URI) or "ros2" (of ROS_DOMAIN_ID).

    `clock` is what tells receive times [s].

    Raises:
        TransportError: ROS is not installed, its master does not answer, or `kind` is unknown; one sentence says what to do.
    """
    if kind == "ros1":
        try:
            from hardware.dvrk.ros1 import TransportROS1
        except ImportError as error:
            raise TransportError(ROS1_MISSING.format(error=error)) from None
        return TransportROS1(node_name, clock)
    if kind == "ros2":
        try:
            from hardware.dvrk.ros2 import TransportROS2
        except ImportError as error:
            raise TransportError(ROS2_MISSING.format(error=error)) from None
        return TransportROS2(node_name, clock)
    raise TransportError(f"there is no transport {kind!r}; choose one of {', '.join(KINDS)}")
