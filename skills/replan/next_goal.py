"""The corrective goal: segments, in order, and what each will sever (paper, Algorithm 1)."""

from dataclasses import dataclass

from hardware.codes import Code
from hardware.interface import Array


@dataclass(frozen=True)
class NextGoal:
    """`segments` (S, 2, 2) pixels (start, end) in cutting order on the image at the end of exposure.

    `severs[i]` are the indices of the graph's edges that segment i is there for (each edge belongs to one segment); `reasons[i]` says
    so to the operator. `proven`: no fewer segments of the length limit can sever them all. `greedy_segments` is how many the paper's
    greedy cover takes, None if that was not asked for or finds no cover. `left_out` counts unknown edges that are not seen now: those
    are never cut unseen.
    """

    code: Code
    message: str
    segments: Array
    severs: tuple[tuple[int, ...], ...]
    reasons: tuple[str, ...] = ()
    proven: bool = False
    greedy_segments: int | None = None
    left_out: int = 0

    @property
    def explanation(self) -> str:
        """What the operator is asked to approve, in one line: the message, and what each segment severs."""
        each = "; ".join(f"segment {k} {reason}" for k, reason in enumerate(self.reasons, start=1))
        return f"{self.message} {each[0].upper()}{each[1:]}." if each else self.message
