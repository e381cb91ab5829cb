"""Every fault of a robot once, and every phase of a session with several: both arms hold, a code says why, and nothing is sent after it."""

from pathlib import Path

import pytest

from hardware.served.faults import Fault as Served
from supervisor.experiments.faults import FAULTS, Fault, Graph, Patience, Phase, Row, run_all
from supervisor.experiments.faults_page import REASONS, page

LATCHED = {
    Served.FRAME_ID: ("setup_changed", Phase.APPROACH),
    Served.BASE_JUMP: ("setup_changed", Phase.RETRACT),
    Served.TOOL_REMOVED: ("setup_changed", Phase.CUT),
    Served.TOOL_CHANGED: ("setup_changed", Phase.ESTIMATE),
    Served.FAULT_TRACKING: ("arm_fault", Phase.RETRACT),
    Served.FAULT_POWER: ("arm_fault", Phase.CUT),
    Served.FAULT_WATCHDOG: ("arm_fault", Phase.EXPOSE),
    Served.EMERGENCY_STOP: ("arm_fault", Phase.GRASP),
    Served.ENDOSCOPE_MOVED: ("setup_changed", Phase.EXPOSE),
    Graph.MASTER_GONE: ("connection_lost", Phase.RETRACT),
    Graph.DUPLICATE_PUBLISHER: ("setup_changed", Phase.APPROACH),
    Graph.DEADMAN_GONE: ("deadman", Phase.CUT),
}
PASSING = {
    Served.SILENT: Phase.RETRACT,
    Served.STAMP_ZERO: Phase.APPROACH,
    Served.STAMP_STALE: Phase.EXPOSE,
    Served.NAN_POSE: Phase.CUT,
    Served.NON_UNIT_QUATERNION: Phase.GRASP,
    Served.CLUTCH: Phase.RETRACT,
    Served.CLOCK_BEHIND: Phase.APPROACH,
    Served.TELEOP_FOLLOWING: Phase.ESTIMATE,
    Served.TELEOP_ENABLED: Phase.EXPOSE,
    Served.OPERATOR_ABSENT: Phase.CUT,
    Served.EYE_MISSING: Phase.GRASP,
    Served.CAMERA_STOPPED: Phase.ESTIMATE,
}
# The motion under way fails by its own rule, and its step ends; or somebody else drives the arm.
FAILING = {
    Served.NOT_READY: Phase.APPROACH,
    Served.LOST_COMMANDS: Phase.EXPOSE,
    Served.IK_FAILURE: Phase.APPROACH,
    Served.FROZEN: Phase.RETRACT,
    Served.FOREIGN_SERVO: Phase.GRASP,
    Served.INTERRUPT: Phase.GRASP,
    Graph.FOREIGN_COMMANDS: Phase.GRASP,
}
UNNOTICED = {
    Served.JAW_BLOCKED: Phase.APPROACH,
    Served.BUSY_PULSE: Phase.APPROACH,
    Served.JAW_SLIPS: Phase.APPROACH,
    Served.JAW_STALE_GOAL: Phase.APPROACH,
    Served.LATCHED_ERROR: Phase.APPROACH,
    Served.CLOCK_AHEAD: Phase.APPROACH,
    Served.SKEWED_STAMPS: Phase.APPROACH,
    Served.ZERO_K: Phase.APPROACH,
}
CASES: dict[Fault, Phase] = {**{one: phase for one, (_, phase) in LATCHED.items()}, **PASSING, **FAILING, **UNNOTICED}


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Row]:
    folder: Path = tmp_path_factory.mktemp("served")
    found = run_all(CASES.items(), folder, Patience(unnoticed=1.1, watched=0.15, recovery=0.3))
    return {row.fault: row for row in found}


def test_every_fault_is_tried_and_every_phase_sees_several():
    assert set(CASES) == set(FAULTS)
    assert all(list(CASES.values()).count(phase) >= 2 for phase in Phase)


@pytest.mark.parametrize("fault", [*LATCHED, *PASSING, *FAILING])
def test_both_arms_hold_soon_and_nothing_is_sent_after(rows, fault):
    row = rows[fault]

    assert row.verdict in (("held", "at rest") if row.phase == "estimate" else ("held",))
    assert row.after_hold == 0
    assert row.code and row.message
    assert row.held is None or row.held <= 1.0


@pytest.mark.parametrize("fault", LATCHED)
def test_what_only_a_person_may_clear_ends_the_session_with_its_code(rows, fault):
    code, _ = LATCHED[fault]

    assert rows[fault].code == code
    assert rows[fault].outcome == f"ends: {code}"
    assert rows[fault].next_step == 0


@pytest.mark.parametrize("fault", PASSING)
def test_what_may_pass_makes_the_session_wait(rows, fault):
    assert rows[fault].outcome.startswith("waits")
    assert rows[fault].next_step == 0


@pytest.mark.parametrize("fault", UNNOTICED)
def test_what_cannot_be_noticed_then_has_a_reason_on_the_page(rows, fault):
    assert rows[fault].verdict == "not noticed"
    assert REASONS[fault.value]


def test_the_page_lists_what_did_not_hold_first(rows):
    bad = vars(next(iter(rows.values()))) | {"verdict": "not held", "after_hold": 2}

    said = page([bad, *(vars(row) for row in rows.values())])

    listed = said[said.index("## Not held") : said.index("## Not noticed")]
    assert bad["fault"] in listed and "2 commands after it" in listed
