"""When an arm may be commanded again after a motion that failed."""

from hardware.codes import Code
from hardware.dvrk.obedience import QUIET, Obedience, Part


def test_a_motion_that_failed_stands_until_the_arm_was_quiet_for_a_while():
    obedience = Obedience()
    obedience.failed(Part.JAW, Code.MOVE_NOT_REACHED, "broken off")

    standing = [obedience.verdict("", 0.0), obedience.verdict("", QUIET - 0.01)]

    assert all(not one.ok and not one.latched and one.code is Code.MOVE_NOT_REACHED for one in standing)
    assert obedience.verdict("", QUIET + 0.01).ok


def test_while_the_arm_is_not_quiet_the_time_does_not_count_and_the_reason_says_why():
    obedience = Obedience()
    obedience.failed(Part.JAW, Code.MOVE_NOT_REACHED, "broken off")
    obedience.verdict("", 0.0)

    blocked = obedience.verdict("the jaw stands open", 0.9)

    assert "broken off; the jaw stands open" in blocked.message
    assert not obedience.verdict("", 1.0).ok and not obedience.verdict("", 1.9).ok
    assert obedience.verdict("", 2.1).ok


def test_what_the_robot_swallowed_ends_the_session_at_once():
    obedience = Obedience()
    obedience.failed(Part.JAW, Code.MOVE_REJECTED, "never began", swallowed=True)

    verdict = obedience.verdict("", 100.0)

    assert verdict.latched and verdict.code is Code.NOT_OBEYED
    assert obedience.verdict("", 200.0) == verdict


def test_the_second_failure_in_a_row_of_the_same_part_ends_the_session():
    obedience = Obedience()
    for part in (Part.JAW, Part.TIP):
        obedience.failed(part, Code.MOVE_NOT_REACHED, "away")
        assert not obedience.verdict("", 0.0).latched
    obedience.obeyed(Part.TIP)
    obedience.failed(Part.TIP, Code.MOVE_NOT_REACHED, "away")
    assert not obedience.verdict("", 0.0).latched

    obedience.failed(Part.JAW, Code.MOVE_NOT_REACHED, "away")

    verdict = obedience.verdict("", 0.0)
    assert verdict.latched and verdict.code is Code.NOT_OBEYED and "second time in a row: away" in verdict.message
