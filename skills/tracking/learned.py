"""Trackers that a learned model makes: the model follows the points, this says which of them a tool hides and keeps frames in order."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hardware.codes import InputError
from hardware.interface import Array, Frame, Image
from skills.tracking.hidden import Mask, covered, inside
from skills.tracking.tracks import Tracks

if TYPE_CHECKING:
    import torch


class PointModel(Protocol):
    """A model that follows points through a video, one frame at a time. Images are (H, W, 3) uint8 RGB."""

    def start(self, image: Image, points: Array) -> None:
        """Begin a new video: follow `points` (N, 2) pixels from `image` on."""
        ...

    def update(self, image: Image) -> tuple[Array, Mask, Array]:
        """Follow them into the next image: points (N, 2), visible (N,), confidence (N,) 0..1."""
        ...


class TrackerLearned:
    """A `PointTracker` around a `PointModel`; the model keeps each point apart, so groups change nothing. One thread."""

    def __init__(self, model: PointModel) -> None:
        self._model = model
        self._tracks: Tracks | None = None

    def start(
        self, frame: Frame, points: Array, groups: NDArray[np.int64] | None = None, tool_mask: Mask | None = None
    ) -> Tracks:
        """Follow `points` (N, 2) pixels from `frame` on. Covered ones start hidden."""
        points = np.array(points, dtype=np.float64).reshape(-1, 2)
        if groups is not None and len(groups) != len(points):
            raise ValueError("each point needs a group")
        self._size, self._sequence = frame.image.shape, frame.sequence
        if len(points):
            self._model.start(frame.image, points)
        seen = inside(points, frame.image) & ~covered(points, tool_mask)
        return self._keep(frame, points, seen, np.ones(len(points)))

    def tracks(self) -> Tracks:
        """Give where the points were in the newest frame.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._tracks is None:
            raise RuntimeError("a tracker must be started before it is asked")
        return self._tracks

    def update(self, frame: Frame, tool_mask: Mask | None = None) -> Tracks:
        """Follow the points into `frame`. A frame seen before changes nothing; a place that is not finite is that of before, unseen.

        Raises:
            RuntimeError: `start` was not called.
            ValueError: the frame is of another size.
        """
        before = self._tracks
        if before is None:
            raise RuntimeError("a tracker must be started before it is updated")
        if frame.image.shape != self._size:
            raise ValueError("a tracker must be given frames of one size")
        if frame.sequence == self._sequence or not len(before.points):
            return self._keep(frame, before.points, before.visible, before.confidence)
        points, visible, confidence = self._model.update(frame.image)
        finite = np.isfinite(points).all(axis=1) & np.isfinite(confidence)
        points = np.where(finite[:, None], points, before.points)
        seen = visible & finite & inside(points, frame.image) & ~covered(points, tool_mask)
        return self._keep(frame, points, seen, np.clip(np.nan_to_num(confidence), 0.0, 1.0))

    def _keep(self, frame: Frame, points: Array, seen: Mask, confidence: Array) -> Tracks:
        self._sequence = frame.sequence
        self._tracks = Tracks(frame.stamp, points.copy(), seen.copy(), np.where(seen, confidence, 0.0))
        return self._tracks


def as_tensor(image: Image, device: str) -> torch.Tensor:
    """The image (1, 3, H, W) float32 RGB 0..255 that all the models take."""
    import torch

    return torch.from_numpy(np.ascontiguousarray(image)).to(device).permute(2, 0, 1)[None].float()


def queries_of(points: Array, device: str) -> torch.Tensor:
    """Points (N, 2) as queries (1, N, 3): (frame 0, u, v)."""
    import torch

    rows = np.column_stack([np.zeros(len(points)), points])
    return torch.from_numpy(rows).float()[None].to(device)


def read_weights(path: Path, name: str) -> dict[str, Any]:
    """Read the weights of a checkpoint, a bare state_dict or one under `model`.

    Raises:
        InputError: the file is missing or is no checkpoint; `name` is what it should be of.
    """
    import torch

    try:
        # Weights only: a pickle from elsewhere must not run code.
        state = torch.load(path, map_location="cpu", weights_only=True)
        state = state.get("model", state)
        # Saved from DataParallel, names carry a prefix.
        return {str(key).removeprefix("module."): value for key, value in state.items()}
    except FileNotFoundError as error:
        raise InputError(f"there is no file {path} with the weights of {name}") from error
    except Exception as error:  # what torch raises on a file that is no checkpoint depends on its first bytes
        raise InputError(f"{path} is not a checkpoint of {name}: it does not hold plain torch weights") from error


def fill(network: Any, weights: dict[str, Any], path: Path, name: str) -> None:
    """Give a torch network its weights; each must be there.

    Raises:
        InputError: the weights are another network's.
    """
    try:
        network.load_state_dict(weights)
    except (RuntimeError, AttributeError) as error:
        raise InputError(f"the weights in {path} are not those of {name}: {str(error).splitlines()[-1].strip()}") from error
