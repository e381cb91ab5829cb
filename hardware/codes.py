"""The one enumeration of outcome codes: every failure, refusal and end of a session carries one of these."""

from enum import StrEnum


class Code(StrEnum):
    """Why something ended, was refused or is waiting. Machine-readable; a sentence for people goes beside it."""

    OK = "ok"
    # How a session ends
    COMPLETE = "complete"
    ATTEMPTS_USED = "attempts_used"
    UNVERIFIED = "unverified"
    ABORTED = "aborted"
    INTERNAL_ERROR = "internal_error"
    # Latched: a person must clear these
    EMERGENCY_STOP = "emergency_stop"
    ARM_FAULT = "arm_fault"
    TENSION_ABORT = "tension_abort"
    RECORDER_FAILED = "recorder_failed"
    SETUP_CHANGED = "setup_changed"  # instrument, frame or base are not what was configured and calibrated
    FOREIGN_MOTION = "foreign_motion"  # somebody else drives an arm
    NOT_OBEYED = "not_obeyed"  # an arm that says it is ready does not do what it is told
    DEADMAN = "deadman"  # it is gone, or it holds the arms
    CONNECTION_LOST = "connection_lost"
    # Recoverable conditions and refusals by the safety gate
    ARM_NOT_READY = "arm_not_ready"
    ARM_DATA_STALE = "arm_data_stale"
    CAMERA_STALE = "camera_stale"
    WORKSPACE = "workspace"
    STEP_TOO_LONG = "step_too_long"
    TOO_FAST = "too_fast"
    TOOLS_TOO_CLOSE = "tools_too_close"
    TENSION = "tension"
    STRAIN = "strain"
    NOT_FINITE = "not_finite"
    LEASE_REVOKED = "lease_revoked"
    TRIPPED = "tripped"
    CUT_NOT_APPROVED = "cut_not_approved"
    CUT_LIMIT = "cut_limit"
    # Motion
    MOVE_REJECTED = "move_rejected"
    MOVE_TIMEOUT = "move_timeout"
    MOVE_NOT_REACHED = "move_not_reached"
    # Approval by the operator
    NOT_APPROVED = "not_approved"
    APPROVAL_EXPIRED = "approval_expired"
    SCENE_MOVED = "scene_moved"
    # Skills
    CHECKLIST = "checklist"
    PREEMPTED = "preempted"
    DEPTH_INVALID = "depth_invalid"
    GRASP_EMPTY = "grasp_empty"
    GRASP_SLIPPED = "grasp_slipped"
    GOAL_LOST = "goal_lost"
    SURFACE_INVALID = "surface_invalid"
    EXPOSURE_STEPS_DONE = "exposure_steps_done"
    EXPOSURE_SEPARATED = "exposure_separated"
    EXPOSURE_INFEASIBLE = "exposure_infeasible"
    SMOOTHING_INFEASIBLE = "smoothing_infeasible"
    TOO_MANY_UNKNOWN = "too_many_unknown"
    NO_CANDIDATE = "no_candidate"
    # Input
    BAD_INPUT = "bad_input"


LATCHED = (
    Code.EMERGENCY_STOP,
    Code.ARM_FAULT,
    Code.TENSION_ABORT,
    Code.RECORDER_FAILED,
    Code.SETUP_CHANGED,
    Code.FOREIGN_MOTION,
    Code.NOT_OBEYED,
    Code.DEADMAN,
    Code.CONNECTION_LOST,
)


class InputError(ValueError):
    """Bad input from a person: one clear sentence that says what was wrong, where, and what would be right."""
