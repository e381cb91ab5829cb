"""What a retreat gives back: whether the tools are clear of the tissue."""

from dataclasses import dataclass

from hardware.codes import Code


@dataclass(frozen=True)
class RetreatOutcome:
    """`code` OK when the tools are lifted clear and both arms hold; otherwise why not."""

    code: Code
    message: str
