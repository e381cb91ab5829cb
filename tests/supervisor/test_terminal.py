"""The live view in a terminal, and the view of another process's session."""

from __future__ import annotations

import io
import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console
from rich.live import Live

from hardware.codes import InputError
from supervisor.exposing import in_words
from supervisor.recent import Recent
from supervisor.record import Recorder
from supervisor.snapshot import NodeState, TickSnapshot
from supervisor.status import STATUS_FILE, read_status
from supervisor.terminal import TerminalView, picture
from supervisor.watch import find_running, said, watch
from tests.supervisor.sessions import OUTCOME, exposure_view, record_session, snapshots


def shown(snapshot: TickSnapshot, recent: Recent | None = None, width: int = 120, height: int = 40) -> str:
    console = Console(width=width, height=height, file=io.StringIO())
    with console.capture() as capture:
        console.print(picture(snapshot, recent or Recent(), width=width, height=height))
    return capture.get()


def at(stamp: float) -> tuple[TickSnapshot, Recent]:
    recent = Recent()
    for snapshot in snapshots(images=False):
        recent = recent.after(snapshot)
        if snapshot.stamp >= stamp - 1e-9:
            return snapshot, recent
    raise AssertionError("the session ends before")


def test_the_picture_shows_tree_attempt_guards_forces_and_refusals() -> None:
    text = shown(*at(18.4))
    parts = ("▶ expose", "✓ dissect", "· replan", "1 of 3", "not known yet", "● emergency stop", "1.52 N", "×4", "expose begins")
    for part in parts:
        assert part in text


def test_attachments_left_are_shown_once_known() -> None:
    text = shown(*at(20.0))
    assert "attachments left  1" in text


def test_while_exposing_one_line_says_what_the_controller_expects() -> None:
    assert "exposing          step 8, 3200 px² open, 0.80 N, 2.4 SD apart" in shown(*at(18.4))
    assert "px² open" not in shown(*at(14.2)) and "px² open" not in shown(*at(19.2))


def test_a_step_without_a_plan_is_said_plainly() -> None:
    view = replace(exposure_view(1, 3), opening=float("nan"))
    assert in_words(view) == "step 3, no plan"
    assert in_words(replace(view, opening=5.0, tension=float("nan"))) == "step 3, 5 px² open, tension unknown, 0.9 SD apart"


def test_watching_shows_the_line_of_the_exposure_and_an_older_status_file_has_none(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, {})
    _, recent = at(18.4)
    for snapshot in snapshots(images=False):
        recorder._status._due = -1.0  # no wall time passes in a test
        recorder.snapshot(snapshot)
        if snapshot.stamp >= 18.4 - 1e-9:
            break
    assert read_status(tmp_path).recent.exposing == recent.exposing != ""
    status = json.loads((tmp_path / STATUS_FILE).read_text())
    del status["recent"]["exposing"]
    (tmp_path / STATUS_FILE).write_text(json.dumps(status))
    assert read_status(tmp_path).recent.exposing == ""
    recorder.close(OUTCOME)


def test_a_guard_that_waits_says_why() -> None:
    snapshot, _ = at(5.0)
    why = "the newest image is 0.4 s old"
    nodes = tuple(replace(n, status="RUNNING", message=why) if n.name == "camera fresh" else n for n in snapshot.nodes)
    assert "the newest image is 0.4 s old" in shown(replace(snapshot, nodes=nodes))


def test_a_reading_that_is_not_a_number_is_not_shown_as_zero() -> None:
    snapshot, _ = at(5.0)
    assert shown(replace(snapshot, tension=float("nan"))).count("no reading") == 1


@pytest.mark.parametrize(("width", "height"), [(60, 24), (100, 20), (240, 70)])
def test_the_picture_keeps_to_the_terminal(width: int, height: int) -> None:
    text = shown(*at(18.4), width=width, height=height)
    assert all(len(line) <= width for line in text.splitlines())


def test_a_low_terminal_folds_what_is_at_rest_but_never_what_runs() -> None:
    snapshot, _ = at(18.4)
    resting = tuple(NodeState(f"session/procedure/checklist/{k}", f"item {k}", "leaf", 3, "SUCCESS", "") for k in range(40))
    text = shown(replace(snapshot, nodes=snapshot.nodes + resting), height=24)
    assert "item 3" not in text and "▶ expose" in text


def test_words_in_brackets_are_shown_as_they_are() -> None:
    snapshot, _ = at(5.0)
    nodes = (replace(snapshot.nodes[0], message="cut [red]here[/red]"), *snapshot.nodes[1:])
    assert "cut [red]here[/red]" in shown(replace(snapshot, nodes=nodes))


def test_without_a_terminal_each_transition_is_one_line() -> None:
    out = io.StringIO()
    with TerminalView(Console(file=out, width=200)) as view:
        for snapshot in snapshots(images=False):
            view.update(snapshot)
    lines = out.getvalue().splitlines()
    assert "    3.00 s  attempt 1 of 3" in lines
    assert "    3.00 s  dissect running: dissect: 0 s" in lines
    assert sum("refused PSM1 servo_cp (tension)" in line for line in lines) == 1
    assert [line for line in lines if "px²" in line] == [
        "   16.50 s  exposing: step 5, 2000 px² open, 0.50 N, 1.5 SD apart",
        "   25.50 s  exposing: step 5, 2000 px² open, 0.50 N, 1.5 SD apart",
    ]
    assert len(lines) < 50 and "\x1b" not in out.getvalue()


def test_on_a_terminal_pictures_come_at_a_limited_rate_and_the_last_tick_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.StringIO()
    drawn: list[int] = []
    original = TerminalView._draw

    def draw(view: TerminalView, live: Live, snapshot: TickSnapshot) -> None:
        drawn.append(snapshot.tick)
        original(view, live, snapshot)

    monkeypatch.setattr(TerminalView, "_draw", draw)
    given = list(snapshots(images=False))
    with TerminalView(Console(file=out, width=100, height=40, force_terminal=True)) as view:
        for snapshot in given:
            view.update(snapshot)
    assert drawn[-1] == given[-1].tick
    assert len(drawn) < len(given) / 5


def test_pausing_gives_the_terminal_away_and_the_next_update_takes_it_back() -> None:
    given, _ = at(5.0)
    view = TerminalView(Console(file=io.StringIO(), width=100, height=40, force_terminal=True))
    view.pause()
    assert view._live is not None and not view._live.is_started
    view.update(given)
    assert view._live.is_started
    view.close()


def test_watching_finds_the_newest_running_session(tmp_path: Path) -> None:
    record_session(tmp_path / "ended", until=1.0, images=False)
    for name, age in (("old", 10.0), ("new", 1.0)):
        record_session(tmp_path / name, until=1.0, close=False, images=False)
        stamp = (tmp_path / name / STATUS_FILE).stat().st_mtime - age
        os.utime(tmp_path / name / STATUS_FILE, (stamp, stamp))
    assert find_running(tmp_path) == tmp_path / "new"
    assert find_running(tmp_path / "old") == tmp_path / "old"


def test_watching_where_nothing_runs_is_one_clear_sentence(tmp_path: Path) -> None:
    record_session(tmp_path / "ended", until=1.0, images=False)
    with pytest.raises(InputError, match="No session is running in"):
        find_running(tmp_path)


def test_a_session_that_fell_silent_is_not_called_running(tmp_path: Path) -> None:
    path = record_session(tmp_path / "s", until=1.0, close=False, images=False) / STATUS_FILE
    os.utime(path, (path.stat().st_mtime - 100, path.stat().st_mtime - 100))
    with pytest.raises(InputError, match="No session is running"):
        find_running(tmp_path)
    assert "probably killed" in said(read_status(tmp_path / "s")).plain


def test_watching_ends_with_the_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = list(snapshots(images=False))
    recorder = Recorder(tmp_path / "s", {})
    recorder.snapshot(given[0])

    def meanwhile(_: float) -> None:
        recorder.snapshot(given[-1])
        recorder.close(OUTCOME)

    monkeypatch.setattr("supervisor.watch.time.sleep", meanwhile)
    out = io.StringIO()
    status = watch(tmp_path, Console(file=out, width=100, height=40))
    assert not status.running and status.outcome["code"] == "complete"
    assert "The session has ended: complete." in out.getvalue()


def test_a_status_file_of_another_make_is_one_clear_sentence(tmp_path: Path) -> None:
    (tmp_path / STATUS_FILE).write_text('{"running": true}')
    with pytest.raises(InputError, match="cannot be understood"):
        read_status(tmp_path)
