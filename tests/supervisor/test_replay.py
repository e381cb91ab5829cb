"""The time line of a recorded session, as a person reads it."""

from __future__ import annotations

from pathlib import Path

import pytest

from supervisor.reading import read
from supervisor.replay import timeline
from tests.supervisor.sessions import record_session


@pytest.fixture(scope="module")
def lines(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = record_session(tmp_path_factory.mktemp("sessions") / "one", images=False)
    return [text.plain for text in timeline(read(folder))]


def test_the_time_line_begins_with_what_the_session_was(lines: list[str]) -> None:
    assert lines[0] == "Session one   bench stub, scene silicone, agent planning, exposure optimal, seed 7"


def test_leaves_are_told_in_order_of_time(lines: list[str]) -> None:
    assert "    3.00 s  ▶ dissect running  dissect: 0 s" in lines
    assert "   14.00 s  ✓ dissect success" in lines
    stamps = [float(line[:8]) for line in lines if line[8:11] == " s "]
    assert stamps == sorted(stamps)


def test_refused_commands_are_grouped(lines: list[str]) -> None:
    refused = [line for line in lines if "refused" in line and "✋" in line]
    assert len(refused) == 1
    assert "PSM1 servo_cp refused 4 times until 18.30 s (tension): The tissue is under 4.1 N" in refused[0]


def test_attempts_approvals_and_estimates_are_told(lines: list[str]) -> None:
    assert sum("── attempt" in line for line in lines) == 2
    assert any("✎ goal 3fa9c1 approved by auto" in line for line in lines)
    assert any("◈ estimate: 1 attachment left. 3 edges still hold and 2 are hidden" in line for line in lines)
    assert any("truth of the bench: no attachments left, 100 % of the goal severed, deviation 0.6 mm" in line for line in lines)


def test_guards_that_hold_are_not_told(lines: list[str]) -> None:
    assert not any("emergency stop" in line for line in lines)


def test_the_end_tells_the_outcome_and_the_sums(lines: list[str]) -> None:
    assert "Complete  No tissue connection crosses the goal any more." in lines
    assert "2 attempts, 236 commands sent, 4 refused, 30.0 s of bench time" in lines
    assert not any("NOT CLOSED" in line for line in lines)


def test_an_unclosed_session_is_told_to_its_last_transition_and_says_so(tmp_path: Path) -> None:
    folder = record_session(tmp_path / "s", until=16.0, close=False, images=False)
    lines = [text.plain for text in timeline(read(folder))]
    assert "   14.00 s  ▶ expose running  expose: 0 s" in lines
    assert any(line.startswith("Not closed") for line in lines)
    assert lines[-1].startswith("NOT CLOSED: all that was flushed before is shown")
