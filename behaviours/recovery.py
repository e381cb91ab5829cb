"""What may help after a step of an attempt failed with a code. What is not in the table ends the attempts: fail closed."""

from enum import Enum

from hardware.codes import Code


class Recovery(Enum):
    """What to do next."""

    LOOK = "expose and estimate anyway"
    RETRY = "begin the next attempt"
    END = "end the attempts"


_TABLE = {
    # A command was refused or a motion not finished: some of the goal may be cut, and looking tells how much.
    **dict.fromkeys(
        (
            Code.MOVE_REJECTED,
            Code.MOVE_TIMEOUT,
            Code.MOVE_NOT_REACHED,
            Code.WORKSPACE,
            Code.STEP_TOO_LONG,
            Code.TOO_FAST,
            Code.TOOLS_TOO_CLOSE,
            Code.TENSION,
            Code.STRAIN,
            Code.NOT_FINITE,
            Code.ARM_DATA_STALE,
            Code.CAMERA_STALE,
        ),
        Recovery.LOOK,
    ),
    # The permission ended while cutting: look, plan, and ask for what is left.
    Code.CUT_NOT_APPROVED: Recovery.LOOK,
    Code.CUT_LIMIT: Recovery.LOOK,
    # The tools hide the goal while they cut; exposing moves them out of sight, and another pull may show more.
    Code.GOAL_LOST: Recovery.LOOK,
    Code.DEPTH_INVALID: Recovery.LOOK,
    Code.SURFACE_INVALID: Recovery.LOOK,
    Code.TOO_MANY_UNKNOWN: Recovery.LOOK,
    # Without tissue in the jaws nothing can be exposed; dissecting grasps anew.
    Code.GRASP_EMPTY: Recovery.RETRY,
    Code.GRASP_SLIPPED: Recovery.RETRY,
    # What is left was not seen, or not within reach as the tissue lay; the next attempt looks first, and cuts nothing before.
    Code.NO_CANDIDATE: Recovery.RETRY,
}


def recovery(code: Code) -> Recovery:
    """Tell what may help after a failure with `code`."""
    return _TABLE.get(code, Recovery.END)
