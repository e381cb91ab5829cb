"""The messages and services of crtk_msgs as text, so that a machine without that package speaks them all the same.

Field names and their order are what goes over the wire; the md5 sum that ROS 1 makes of them is what two nodes compare before they
talk, and is known here from the dVRK's own definitions. An arm from before dVRK 2.2 shows up by another sum.
"""

from __future__ import annotations

from collections.abc import Mapping

OPERATING_STATE = """\
std_msgs/Header header
string state
bool is_homed
bool is_busy
"""

STRING_STAMPED = """\
std_msgs/Header header
string string
"""

CARTESIAN_STATE = """\
std_msgs/Header header
geometry_msgs/Pose pose
std_msgs/Bool pose_is_valid
geometry_msgs/Twist twist
std_msgs/Bool twist_is_valid
geometry_msgs/Wrench wrench
std_msgs/Bool wrench_is_valid
"""

QUERY_FORWARD_KINEMATICS = """\
float64[] jp
geometry_msgs/Pose cp
---
geometry_msgs/Pose cp
bool result
string message
"""

QUERY_INVERSE_KINEMATICS = """\
geometry_msgs/Pose cp
float64[] jp
---
float64[] jp
bool result
string message
"""

TRIGGER_OPERATING_STATE = """\
---
crtk_msgs/OperatingState operating_state
"""

MESSAGES: Mapping[str, str] = {
    "crtk_msgs/OperatingState": OPERATING_STATE,
    "crtk_msgs/StringStamped": STRING_STAMPED,
    "crtk_msgs/CartesianState": CARTESIAN_STATE,
}

SERVICES: Mapping[str, str] = {
    "crtk_msgs/QueryForwardKinematics": QUERY_FORWARD_KINEMATICS,
    "crtk_msgs/QueryInverseKinematics": QUERY_INVERSE_KINEMATICS,
    "crtk_msgs/TriggerOperatingState": TRIGGER_OPERATING_STATE,
}

# What every node on the robot's side computes from its own definitions; the common types are here to notice an odd installation.
MD5: Mapping[str, str] = {
    "crtk_msgs/OperatingState": "b1bd4021639d9d9c5fbfff78d6ff3158",
    "crtk_msgs/StringStamped": "5e3e46086181199270f1ac3a28a5977f",
    "crtk_msgs/CartesianState": "3913bf7ef8bcc8fa7a8eb33a46f273db",
    "crtk_msgs/QueryForwardKinematics": "787c6da7a75e9886573c4af11f1a381f",
    "crtk_msgs/QueryInverseKinematics": "ce8dbc3b4384e2f7567488e7e75496d8",
    "crtk_msgs/TriggerOperatingState": "d941a2d049e2c9ac5773fc4a3a8a892d",
    "geometry_msgs/PoseStamped": "d3812c3cbc69362b77dc0b19b345f8f5",
    "geometry_msgs/TwistStamped": "98d34b0043a2093cf9d9345ab6eef12e",
    "geometry_msgs/WrenchStamped": "d78d3cb249ce23087ade7e7d0c40cfa7",
    "sensor_msgs/JointState": "3066dcd76a6cfaef579bd0f34173e9fd",
    "sensor_msgs/Joy": "5a9ea5f83505693b71e785041e67a8bb",
    "std_msgs/Bool": "8b94c1b53db61fb6aed406028ad6332a",
}
