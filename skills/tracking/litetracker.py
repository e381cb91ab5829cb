"""LiteTracker (MICCAI 2025, arXiv 2504.09904) as a tracker here: the adapter to its upstream package, which a user installs.

Upstream's code and weights are for non-commercial use (CC BY-NC 4.0); none of it is part of this repository. See docs/trackers.md.
"""

from __future__ import annotations

import contextlib
import io
from typing import Any

import numpy as np

from hardware.interface import Array, Image
from skills.tracking.hidden import Mask
from skills.tracking.learned import as_tensor, queries_of


class ModelLiteTracker:
    """One call of the upstream network for each frame; it remembers the last frames by itself."""

    def __init__(self, network: Any, device: str) -> None:
        """Take the upstream `LiteTracker`, with its weights."""
        self._network = network.to(device).eval()
        self._device = device

    def start(self, image: Image, points: Array) -> None:
        """Begin a new video; the first frame gives the points' templates."""
        # Upstream prints here; standard output belongs to the command line.
        with contextlib.redirect_stdout(io.StringIO()):
            self._network.reset()
        self._queries = queries_of(points, self._device)
        self.update(image)

    def update(self, image: Image) -> tuple[Array, Mask, Array]:
        """Follow the points; visible is upstream's own threshold (visibility times confidence above 0.6)."""
        import torch

        with torch.no_grad():
            points, visible, confidence = self._network(as_tensor(image, self._device), queries=self._queries)
        return (
            points[0, -1].double().cpu().numpy(),
            visible[0, -1].cpu().numpy().astype(bool),
            confidence[0, -1].double().cpu().numpy().astype(np.float64),
        )
