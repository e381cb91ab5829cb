"""The corrective goal: segments, in order, and what each will sever (paper, Algorithm 1)."""

from dataclasses import dataclass

from hardware.codes import Code
from hardware.interface import Array


@dataclass(frozen=True)
class NextGoal:
    """`segments` (S, 2, 2) pixels (start, end) in cutting order on the image at the end of exposure.

    `severs[i]` are the indices of the graph's edges that segment i is first to cut.
    """

    code: Code
    message: str
    segments: Array
    severs: tuple[tuple[int, ...], ...]
