"""CoTracker3 online (arXiv 2410.11831) as a tracker here: the adapter to its upstream package, which a user installs.

Upstream's code and weights are for non-commercial use (CC BY-NC 4.0); none of it is part of this repository. See docs/trackers.md.

The online predictor takes a window of 16 frames and moves on by 8, so it knows the newest frame only every eighth time. Between, a point
is wanted all the same: the window is filled up to the newest frame and run as it stands, and what the network remembers of it is put back,
so that the run at the step itself is upstream's own. Each frame therefore costs one run of the window.
"""

from __future__ import annotations

import copy
from collections import deque
from typing import Any

import numpy as np

from hardware.interface import Array, Image
from skills.tracking.hidden import Mask
from skills.tracking.learned import as_tensor, queries_of

REMEMBERED = "online_"  # what begins so is the upstream network's memory of the video
UNSURE = 0.75  # confidence of a point seen in a window that is not full yet; upstream gives a threshold, no confidence


class ModelCoTracker3:
    """A sliding window over the newest frames, for upstream's `CoTrackerOnlinePredictor`."""

    def __init__(self, predictor: Any, device: str) -> None:
        """Take the upstream predictor, with its weights."""
        self._predictor = predictor.to(device).eval()
        self._device = device
        self._step = int(predictor.step)

    def start(self, image: Image, points: Array) -> None:
        """Begin a new video; upstream stores the queries on its first call and follows nothing yet."""
        self._frames: deque[Any] = deque([as_tensor(image, self._device)], maxlen=2 * self._step)
        self._count = 1
        self._predictor(video_chunk=self._chunk(), is_first_step=True, queries=queries_of(points, self._device))

    def update(self, image: Image) -> tuple[Array, Mask, Array]:
        """Follow the points into `image`."""
        import torch

        self._frames.append(as_tensor(image, self._device))
        self._count += 1
        # Full windows end at frames 16, 24, 32 ...: there, and only there, the network moves on.
        full = self._count >= 2 * self._step and self._count % self._step == 0
        memory = {} if full else self._memory()
        with torch.no_grad():
            tracks, visible = self._predictor(video_chunk=self._chunk(), is_first_step=False)
        if not full:
            self._restore(memory)
        seen = visible[0, -1].cpu().numpy().astype(bool)
        return tracks[0, -1].double().cpu().numpy(), seen, np.where(seen, 1.0 if full else UNSURE, 0.0)

    def _chunk(self) -> Any:
        """The frames (1, T, 3, H, W) from where the network's window begins to the newest."""
        import torch

        begin = max(0, (self._count - self._step - 1) // self._step * self._step)
        return torch.stack(list(self._frames)[-(self._count - begin) :], dim=1)

    def _memory(self) -> dict[str, Any]:
        network = self._predictor.model
        return {name: copy.copy(value) for name, value in vars(network).items() if name.startswith(REMEMBERED)}

    def _restore(self, memory: dict[str, Any]) -> None:
        for name, value in memory.items():
            setattr(self._predictor.model, name, value)
