"""A whole session, with recorder, real skills and pictures, disturbed: both arms hold and the record says why, or it comes to its end."""

import multiprocessing
import pickle
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import pytest

from hardware.codes import Code
from hardware.served.faults import Fault as Served
from supervisor.experiments.faults_cases import Fault, Graph, Phase
from supervisor.experiments.faults_page import page
from supervisor.experiments.faults_reasons import UNEXPLAINED
from supervisor.experiments.faults_watch import Patience
from supervisor.experiments.faults_whole import SessionRow, run_alone, run_whole

PATIENCE = Patience(unnoticed=1.1, watched=0.5, recovery=1.5)  # a swallowed setpoint is judged 0.3 s after the last one was sent
PHASES = (Phase.APPROACH, Phase.RETRACT)
# What is noticed first, and with what code the session ends; one that waits and looks again is interrupted by its user then.
ENDS: dict[Fault, tuple[Code, Code]] = {
    Served.LOST_COMMANDS: (Code.MOVE_REJECTED, Code.NOT_OBEYED),
    Served.FAULT_POWER: (Code.ARM_FAULT, Code.ARM_FAULT),
    Served.EMERGENCY_STOP: (Code.EMERGENCY_STOP, Code.EMERGENCY_STOP),
    Served.BASE_JUMP: (Code.SETUP_CHANGED, Code.SETUP_CHANGED),
    Graph.MASTER_GONE: (Code.CONNECTION_LOST, Code.CONNECTION_LOST),
    Graph.DEADMAN_GONE: (Code.DEADMAN, Code.DEADMAN),
}
PASSES: dict[Fault, Code] = {Served.FROZEN: Code.ARM_DATA_STALE, Served.OPERATOR_ABSENT: Code.ARM_NOT_READY}
CASES: list[tuple[Fault, Phase]] = [(fault, phase) for phase in PHASES for fault in (*ENDS, *PASSES)]
IDS = [f"{fault}-{phase}" for fault, phase in CASES]
# Harmless: the session goes on to its end, where this ended the pulls that came after.
HARMLESS: dict[tuple[Fault, Phase], tuple[Code, ...]] = {
    (Served.JAW_SLIPS, Phase.EXPOSE): (Code.GRASP_SLIPPED,),
    (Served.JAW_STALE_GOAL, Phase.EXPOSE): (Code.TENSION,),
    (Served.BUSY_PULSE, Phase.ESTIMATE): (),
    (Served.LATCHED_ERROR, Phase.ESTIMATE): (),
}
WHILE_JUDGING: tuple[Fault, Phase] = (Served.CAMERA_STOPPED, Phase.ESTIMATE)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """A process that is split takes no threads along."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(0)
    yield
    cv2.setNumThreads(threads)


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory, one_thread: None) -> dict[tuple[str, str], SessionRow]:
    # In a process of its own: other tests have left threads in this one.
    folder: Path = tmp_path_factory.mktemp("whole")
    process = multiprocessing.get_context("spawn").Process(target=run_and_tell, args=(folder, folder / "rows.pickle"))
    process.start()
    process.join(500.0)
    if process.is_alive():
        process.kill()
    assert process.exitcode == 0
    return {(row.fault, row.phase): row for row in pickle.loads((folder / "rows.pickle").read_bytes())}


def run_and_tell(folder: Path, file: Path) -> None:
    cv2.setNumThreads(0)
    found: list[SessionRow] = []
    run_whole([*CASES, *HARMLESS, WHILE_JUDGING], folder, found.append, PATIENCE)
    file.write_bytes(pickle.dumps(found))


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_both_arms_hold_soon_and_nothing_is_sent_after_it_was_noticed(rows, case: tuple[Fault, Phase]):
    row = rows[case]

    assert row.verdict == "held"
    assert row.held is not None and row.held <= 0.3
    assert row.after_noticed == row.after_hold == row.next_step == 0


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_the_record_is_closed_and_holds_the_code_that_was_noticed(rows, case: tuple[Fault, Phase]):
    row = rows[case]

    assert row.code == (ENDS[case[0]][0] if case[0] in ENDS else PASSES[case[0]])
    assert row.closed and row.coded and row.message


@pytest.mark.parametrize("case", [case for case in CASES if case[0] in ENDS], ids=str)
def test_what_only_a_person_may_clear_ends_the_session_as_recorded(rows, case: tuple[Fault, Phase]):
    row = rows[case]

    assert row.recorded == ENDS[case[0]][1]
    assert row.outcome == f"ends: {row.recorded}"


@pytest.mark.parametrize("case", [case for case in CASES if case[0] in PASSES], ids=str)
def test_what_may_pass_makes_the_session_wait_and_look_again(rows, case: tuple[Fault, Phase]):
    row = rows[case]

    assert row.outcome == "waits; when the fault is gone: looks again"
    assert row.recorded == Code.ABORTED


@pytest.mark.parametrize("case", HARMLESS, ids=str)
def test_what_does_no_harm_lets_the_session_come_to_its_end(rows, case: tuple[Fault, Phase]):
    row = rows[case]

    assert row.verdict == "tolerated" and not row.code
    assert row.exposures == HARMLESS[case]
    assert row.recorded == Code.COMPLETE and row.closed and row.attachments == 0


def test_what_shows_while_the_estimate_is_made_makes_the_session_wait(rows):
    row = rows[WHILE_JUDGING]

    assert row.verdict in ("held", "at rest") and row.after_noticed == 0
    assert row.code == Code.CAMERA_STALE and row.coded
    assert row.outcome == "waits; when the fault is gone: looks again"


def test_the_page_says_why_what_nobody_noticed_is_tolerated_and_what_came_of_it(rows):
    said = page([], [asdict(row) for row in rows.values()])

    listed = said[said.index("### Where the session goes on") : said.index("### Unlike the light session")]
    for (fault, phase), codes in HARMLESS.items():
        assert f"| {fault} | {phase} | tolerated | {', '.join(codes) or '-'} | complete | 0 |" in listed
    assert UNEXPLAINED not in said


def test_a_session_that_was_split_is_the_session_that_was_not(rows, tmp_path: Path):
    alone = run_alone(Served.FAULT_POWER, Phase.APPROACH, tmp_path, PATIENCE)

    split = rows[Served.FAULT_POWER, Phase.APPROACH]
    assert replace(alone, drift=0.0) == replace(split, drift=0.0)
    assert alone.drift == pytest.approx(split.drift, abs=1e-9)
