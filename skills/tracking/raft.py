"""RAFT (Teed and Deng, ECCV 2020) as the flow of a tracker here: the adapter to its upstream code, which a user installs.

See docs/trackers.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from skills.tracking.flow import Field
from skills.tracking.learned import as_tensor
from skills.tracking.padding import padded
from skills.tracking.picture import Picture

ITERATIONS = 20  # upstream's demo
CHECK_ITERATIONS = 8


class FlowRAFT:
    """Flow by the upstream network, on pictures in colour."""

    def __init__(self, network: Any, device: str) -> None:
        """Take the upstream `RAFT`, with its weights."""
        self._network = network.to(device).eval()
        self._device = device

    def sees(self, picture: Picture) -> NDArray[np.uint8]:
        """Colour, as it was trained."""
        return picture.image

    def flow(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> Field:
        """Flow after upstream's usual number of iterations."""
        return self._run(old, new, ITERATIONS)

    def near(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> Field:
        """Flow after upstream's usual number of iterations too."""
        return self._run(old, new, ITERATIONS)

    def check(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> Field:
        """Flow after fewer iterations."""
        return self._run(old, new, CHECK_ITERATIONS)

    def _run(self, old: NDArray[np.uint8], new: NDArray[np.uint8], iterations: int) -> Field:
        import torch

        a, (top, left) = padded(old)
        b, _ = padded(new)
        height, width = old.shape[:2]
        with torch.no_grad():
            _, flow = self._network(as_tensor(a, self._device), as_tensor(b, self._device), iters=iterations, test_mode=True)
        inner = flow[0, :, top : top + height, left : left + width]
        return np.ascontiguousarray(inner.permute(1, 2, 0).float().cpu().numpy())
