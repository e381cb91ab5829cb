"""What the checklist gives back: every item checked, and the first that was not as it must be."""

from dataclasses import dataclass

from hardware.codes import Code


@dataclass(frozen=True)
class CheckOutcome:
    """`code` OK when motion may begin; otherwise why not. `items` are the checks made, one short phrase each."""

    code: Code
    message: str
    items: tuple[str, ...] = ()
