"""The end of a procedure: the scissors are lifted clear, both arms hold; the grasp is kept."""

from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import CUTTER, MoveStatus, Pose
from skills.motion import wait
from skills.retreat_outcome import RetreatOutcome
from skills.skill import Steps


def retreat(lease: Lease, park: Pose) -> Steps[RetreatOutcome]:
    """Move the scissors to `park`; the grasper stays, since it may hold tissue under load."""
    try:
        report = yield from wait(lease.move_cp(CUTTER, park), "lifting the scissors clear")
        if report.status is MoveStatus.FAILED:
            return RetreatOutcome(report.code, report.message)
        return RetreatOutcome(Code.OK, "the scissors are clear of the tissue and both arms hold")
    finally:
        lease.hold()
