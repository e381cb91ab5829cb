"""Every fault of a robot once, and every phase of a session with several: both arms hold, a code says why, and nothing is sent after it."""

from pathlib import Path

import pytest

from hardware.served.faults import Fault as Served
from supervisor.experiments.faults import run_all
from supervisor.experiments.faults_cases import FAULTS, Fault, Graph, Phase
from supervisor.experiments.faults_page import page
from supervisor.experiments.faults_reasons import TOLERATED
from supervisor.experiments.faults_watch import Patience, Row

LATCHED = {
    Served.FRAME_ID: ("setup_changed", Phase.APPROACH),
    Served.BASE_JUMP: ("setup_changed", Phase.RETRACT),
    Served.TOOL_REMOVED: ("setup_changed", Phase.CUT),
    Served.TOOL_CHANGED: ("setup_changed", Phase.ESTIMATE),
    Served.FAULT_TRACKING: ("arm_fault", Phase.RETRACT),
    Served.FAULT_POWER: ("arm_fault", Phase.CUT),
    Served.FAULT_WATCHDOG: ("arm_fault", Phase.EXPOSE),
    Served.EMERGENCY_STOP: ("emergency_stop", Phase.GRASP),
    Served.ENDOSCOPE_MOVED: ("setup_changed", Phase.EXPOSE),
    Served.ZERO_K: ("setup_changed", Phase.CUT),
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
    Served.FROZEN: Phase.RETRACT,
    Served.CLOCK_BEHIND: Phase.APPROACH,
    Served.CLOCK_AHEAD: Phase.EXPOSE,
    Served.TELEOP_FOLLOWING: Phase.ESTIMATE,
    Served.TELEOP_ENABLED: Phase.EXPOSE,
    Served.OPERATOR_ABSENT: Phase.CUT,
    Served.EYE_MISSING: Phase.GRASP,
    Served.CAMERA_STOPPED: Phase.ESTIMATE,
    Served.SKEWED_STAMPS: Phase.GRASP,
}
# The robot does not do what it is told, or does what somebody else tells it: with the code that ends the session.
DISOBEYING = {
    Served.NOT_READY: ("not_obeyed", Phase.APPROACH),
    Served.LOST_COMMANDS: ("not_obeyed", Phase.EXPOSE),
    Served.IK_FAILURE: ("not_obeyed", Phase.RETRACT),
    Served.FOREIGN_SERVO: ("foreign_motion", Phase.CUT),
    Graph.FOREIGN_COMMANDS: ("foreign_motion", Phase.GRASP),
}
# Over at once: the arm proves that it is quiet, and the session looks again.
OVER = {Served.INTERRUPT: Phase.GRASP}
HARMLESS = {
    Served.JAW_BLOCKED: Phase.EXPOSE,
    Served.BUSY_PULSE: Phase.CUT,
    Served.JAW_SLIPS: Phase.EXPOSE,
    Served.JAW_STALE_GOAL: Phase.CUT,
    Served.LATCHED_ERROR: Phase.EXPOSE,
}
ENDING: dict[Fault, tuple[str, Phase]] = {**LATCHED, **DISOBEYING}
CASES: dict[Fault, Phase] = {**{one: phase for one, (_, phase) in ENDING.items()}, **PASSING, **OVER, **HARMLESS}


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Row]:
    folder: Path = tmp_path_factory.mktemp("served")
    found = run_all(CASES.items(), folder, Patience(unnoticed=1.1, watched=0.5, recovery=1.5))
    return {row.fault: row for row in found}


def test_every_fault_is_tried_and_every_phase_sees_several():
    assert set(CASES) == set(FAULTS)
    assert all(list(CASES.values()).count(phase) >= 2 for phase in Phase)


@pytest.mark.parametrize("fault", [*ENDING, *PASSING, *OVER])
def test_both_arms_hold_soon_and_nothing_is_sent_after(rows, fault):
    row = rows[fault]

    assert row.verdict in (("held", "at rest") if row.phase == "estimate" else ("held",))
    assert row.after_hold == row.next_step == 0
    assert row.code and row.message
    assert row.held is None or row.held <= 0.3


@pytest.mark.parametrize("fault", ENDING)
def test_what_only_a_person_may_clear_ends_the_session_with_its_code(rows, fault):
    code, _ = ENDING[fault]

    assert rows[fault].outcome == f"ends: {code}"


@pytest.mark.parametrize("fault", LATCHED)
def test_what_ends_the_session_is_the_first_thing_noticed(rows, fault):
    assert rows[fault].code == LATCHED[fault][0]


@pytest.mark.parametrize("fault", [Served.FOREIGN_SERVO, Graph.FOREIGN_COMMANDS])
def test_a_stranger_drags_no_arm_that_is_held(rows, fault):
    assert rows[fault].drift < 1e-3


@pytest.mark.parametrize("fault", PASSING)
def test_what_may_pass_makes_the_session_wait(rows, fault):
    assert rows[fault].outcome.startswith("waits; when the fault is gone: ")


@pytest.mark.parametrize("fault", OVER)
def test_what_is_over_makes_the_session_look_again_when_the_arm_was_quiet(rows, fault):
    assert rows[fault].code == "move_not_reached"
    assert rows[fault].outcome.endswith("looks again")


@pytest.mark.parametrize("fault", HARMLESS)
def test_what_does_no_harm_lets_the_step_end_well_and_has_a_reason_on_the_page(rows, fault):
    assert rows[fault].verdict == "tolerated"
    assert ": ok" in rows[fault].outcome
    assert TOLERATED[fault.value]


def test_the_page_lists_what_did_not_hold_first(rows):
    bad = vars(next(iter(rows.values()))) | {"verdict": "not held", "after_hold": 2}

    said = page([bad, *(vars(row) for row in rows.values())])

    listed = said[said.index("## Not held") : said.index("## Not noticed")]
    assert bad["fault"] in listed and "2 commands after it" in listed
