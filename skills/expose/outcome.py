"""What an exposure gives back: the gripper's path, the region seen, and why it ended."""

from dataclasses import dataclass

from hardware.codes import Code
from hardware.interface import Array


@dataclass(frozen=True)
class ExposeOutcome:
    """`code` OK when the tissue was pulled as far as planned or as far as a limit allows (then `stopped_by` says which).

    `path` (S, 3) [m] are the gripper positions, `tension` (S,) [N], `strain` (S,) the strain seen by tracking (nan unknown).
    """

    code: Code
    message: str
    stopped_by: Code
    path: Array
    tension: Array
    strain: Array
