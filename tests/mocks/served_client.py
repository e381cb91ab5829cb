"""A client of the served stub on a ROS 1 graph: homes both arms, moves one, injects a fault, and prints what it saw as JSON."""

from __future__ import annotations

import json
import sys
import time
from collections import defaultdict
from typing import Any

import numpy as np

from hardware.dvrk import messages as m
from hardware.dvrk.choose_transport import make_transport

ARMS = ("PSM1", "PSM2")


def main() -> int:
    transport = make_transport("ros1", "served_client")
    heard: dict[str, list[tuple[float, Any]]] = defaultdict(list)

    def listen(topic: str, kind: type[m.Message]) -> None:
        transport.subscribe(topic, kind, lambda message, received: heard[topic].append((received, message)), queue=100)

    def wait(what: str, until: Any, within: float = 20.0) -> None:
        deadline = time.monotonic() + within
        while not until():
            if time.monotonic() > deadline:
                raise TimeoutError(what)
            time.sleep(0.005)

    for arm in ARMS:
        listen(f"/{arm}/operating_state", m.OperatingState)
        listen(f"/{arm}/measured_js", m.JointState)
        listen(f"/{arm}/measured_cp", m.PoseStamped)
        listen(f"/{arm}/goal_reached", m.Bool)
        listen(f"/{arm}/tool_type", m.String)
    for eye in ("left", "right"):
        listen(f"/stereo/{eye}/image_rect_color", m.Picture)
        listen(f"/stereo/{eye}/camera_info", m.CameraInfo)
    commands = {arm: transport.publisher(f"/{arm}/state_command", m.StringStamped, queue=10) for arm in ARMS}
    move = transport.publisher("/PSM1/move_jp", m.JointState)
    inject = transport.publisher("/dissection_stub/inject", m.String)

    def state(arm: str) -> m.OperatingState:
        return heard[f"/{arm}/operating_state"][-1][1]  # type: ignore[no-any-return]

    everyone = (*commands.values(), move, inject)
    wait("listeners", lambda: all(one.listeners() for one in everyone))
    wait("states", lambda: all(heard[f"/{arm}/operating_state"] for arm in ARMS))
    for command, done in (("enable", lambda s: s.state == "ENABLED"), ("home", lambda s: s.is_homed and not s.is_busy)):
        for publisher in commands.values():
            publisher.publish(m.StringStamped(transport.stamp(), command))
        wait(command, lambda done=done: all(done(state(arm)) for arm in ARMS))
    began, count = time.monotonic(), len(heard["/PSM1/measured_cp"])
    images = len(heard["/stereo/left/image_rect_color"])
    goal = np.array([0.05, 0.0, 0.13, 0.2, 0.0, 0.0])
    move.publish(m.JointState(transport.stamp(), (), goal))
    wait("the move", lambda: heard["/PSM1/goal_reached"] and heard["/PSM1/goal_reached"][-1][0] > began)
    wait("two seconds", lambda: time.monotonic() - began > 2.0)
    seconds = time.monotonic() - began
    received = [at for at, _ in heard["/PSM1/measured_cp"][count:]]
    answer = transport.call("/PSM1/operating_state", m.TRIGGER_STATE, m.Ask(), 5.0)
    inject.publish(m.String("fault_power PSM2"))
    wait("the fault", lambda: state("PSM2").state == "FAULT")
    print(
        json.dumps(
            {
                "rate": len(received) / seconds,
                "longest_gap": float(np.diff(received).max()),
                "pictures": (len(heard["/stereo/left/image_rect_color"]) - images) / seconds,
                "error": float(np.abs(heard["/PSM1/measured_js"][-1][1].position - goal).max()),
                "reached": heard["/PSM1/goal_reached"][-1][1].data,
                "tool": heard["/PSM2/tool_type"][-1][1].data,
                "homed": answer.operating_state.is_homed,
                "focal": float(heard["/stereo/left/camera_info"][-1][1].K[0, 0]),
            }
        )
    )
    transport.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
