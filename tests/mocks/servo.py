"""How a mock arm may follow its servo commands, other than at once, and where it was sent."""

from __future__ import annotations

import numpy as np

from hardware.interface import Array, Pose
from tests.mocks.bench import MockBench

LATENCY = 0.05  # [s]


def lag(bench: MockBench, arm: str, latency: float = LATENCY) -> None:
    """Let `arm` be where a servo command says only `latency` [s] after it."""
    device = bench.arms[arm]

    def servo(pose: Pose) -> None:
        bench.record(arm, "servo_cp", pose)
        bench.at(bench.now() + latency, lambda: setattr(device, "pose", pose))

    device.servo_cp = servo  # type: ignore[method-assign]


def stick(bench: MockBench, arm: str) -> None:
    """Let `arm` stay where it is, whatever servo commands say."""
    bench.arms[arm].servo_cp = lambda pose: bench.record(arm, "servo_cp", pose)  # type: ignore[method-assign]


def sent(bench: MockBench, arm: str) -> Array:
    """Positions (N, 3) [m] that `arm` was sent to, in order."""
    return np.array([command.target.position for command in bench.motions(arm) if isinstance(command.target, Pose)])
