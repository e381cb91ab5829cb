"""What the operator is asked, what the operator answers, and whether the scene has moved between the two."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from hardware.interface import Array
from skills.scene.polyline import resample


@dataclass(frozen=True)
class Proposal:
    """One question to the operator, whether this may be cut.

    `polyline` (M, 2) pixels is the whole goal where it is on frame `frame_sequence`, at bench time `stamp` [s]. A corrective
    proposal cuts only `segments` (S, 2, 2) pixels (start, end), which are empty otherwise. `reason` says what will be severed,
    and why.
    """

    kind: Literal["goal", "corrective"]
    goal_id: str
    polyline: Array
    segments: Array
    frame_sequence: int
    stamp: float
    reason: str


@dataclass(frozen=True)
class Answer:
    """The answer `by` a person to the proposal `goal_id`; an answer to any other proposal is not heard."""

    goal_id: str
    approved: bool
    by: str
    comment: str = ""


class Approver(Protocol):
    """Whoever answers proposals: the operator, or on the stub an automatic approval. Never blocks; one proposal at a time."""

    def request(self, proposal: Proposal) -> None:
        """Ask; a new request replaces the old one."""
        ...

    def answer(self) -> Answer | None:
        """Give the answer to the newest request, None while waiting; an answer closes the question."""
        ...

    def cancel(self) -> None:
        """Withdraw the question; nothing when none is open."""
        ...


def goal_id(pixels: Array) -> str:
    """Name the pixels to be cut by their content, to a hundredth of a pixel: 12 hexadecimal digits."""
    rounded = np.rint(np.asarray(pixels, dtype=np.float64) * 100).astype(np.int64)
    return hashlib.sha256(str(rounded.shape).encode() + rounded.tobytes()).hexdigest()[:12]


def displacement(before: Array, after: Array) -> float:
    """Median distance [px] between polylines (M, 2) and (K, 2) of one goal, at equal shares of their lengths; nan if unknown."""
    if not (np.isfinite(before).all() and np.isfinite(after).all()):
        return float("nan")
    count = 33
    return float(np.median(np.linalg.norm(resample(after, count) - resample(before, count), axis=1)))
