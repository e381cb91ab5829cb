"""What a dissection agent gives back: the snips it made, where, and why it ended."""

from dataclasses import dataclass

from hardware.codes import Code
from hardware.interface import Pose


@dataclass(frozen=True)
class Snip:
    """One commanded snip: `start` and `end` pixels of its stretch on the image, the `pose` at closing, and how it went."""

    stamp: float
    start: tuple[float, float]
    end: tuple[float, float]
    pose: Pose
    code: Code
    message: str


@dataclass(frozen=True)
class DissectOutcome:
    """`code` OK when every planned snip was closed; otherwise why the agent stopped."""

    code: Code
    message: str
    snips: tuple[Snip, ...]
