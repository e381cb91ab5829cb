"""What starting to track gives back: whether the goal was found on the image."""

from dataclasses import dataclass

from hardware.codes import Code


@dataclass(frozen=True)
class TrackOutcome:
    """`code` OK when the goal is followed from now on; otherwise why not."""

    code: Code
    message: str
