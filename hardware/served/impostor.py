"""A second node that the robot should not have: it reports for an arm as if it were the robot, or commands it beside the supervisor.

python -m hardware.served.impostor robot.toml PSM1 --command
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hardware.codes import InputError
from hardware.dvrk.choose_transport import make_transport
from hardware.dvrk.config import RobotConfig, load_robot
from hardware.dvrk.messages import PoseStamped
from hardware.dvrk.transport import Transport, TransportError

STEP = 0.5e-3  # [m], from one command to the next
EVERY = 0.02  # [s]


class Impostor:
    """Stands beside the robot on the graph as `transport`'s own node. It learns the arm's pose, and does nothing by itself."""

    def __init__(self, transport: Transport, config: RobotConfig, arm: str) -> None:
        self._transport = transport
        self._pose: PoseStamped | None = None
        transport.subscribe(config.topic(f"{arm}/setpoint_cp"), PoseStamped, self._see)
        self._reports = transport.publisher(config.topic(f"{arm}/measured_cp"), PoseStamped)
        self._commands = transport.publisher(config.topic(f"{arm}/servo_cp"), PoseStamped)

    def report(self) -> None:
        """Tell the arm's pose beside the robot, where it is not."""
        self._reports.publish(PoseStamped(self._transport.stamp(), "elsewhere", np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])))

    def command(self) -> bool:
        """Send the arm a little further along x; gives False while its pose is not known."""
        if self._pose is None:
            return False
        goal = self._pose.position + np.array([STEP, 0.0, 0.0])
        self._commands.publish(PoseStamped(self._transport.stamp(), self._pose.frame_id, goal, self._pose.quaternion))
        return True

    def _see(self, message: PoseStamped, received: float) -> None:
        self._pose = message if message.stamp > 0.0 else None


def main(arguments: Sequence[str] | None = None) -> int:
    """Report for an arm, or command it, until interrupted."""
    parser = argparse.ArgumentParser(prog="python -m hardware.served.impostor", description="Disturb a served robot.")
    parser.add_argument("config", type=Path, help="the robot.toml that `dissect serve-stub` wrote")
    parser.add_argument("arm", help="CRTK name of the arm, such as PSM1")
    parser.add_argument("--command", action="store_true", help="command the arm, instead of reporting for it")
    options = parser.parse_args(arguments)
    try:
        config = load_robot(options.config)
        transport = make_transport(config.transport, "impostor")
    except (InputError, TransportError) as error:
        print(error, file=sys.stderr)
        return 1
    impostor = Impostor(transport, config, options.arm)
    try:
        while True:
            if options.command:
                impostor.command()
            else:
                impostor.report()
            time.sleep(EVERY)
    except KeyboardInterrupt:
        return 0
    finally:
        transport.close()


if __name__ == "__main__":
    sys.exit(main())
