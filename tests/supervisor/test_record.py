"""The record: what is written can be read back, whole or cut short."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hardware.codes import Code, InputError
from hardware.gate import Decision
from supervisor.reading import read
from supervisor.record import HEADER_FILE, MCAP_FILE, Recorder
from supervisor.status import read_status, write_json
from tests.supervisor.sessions import HEADER, OUTCOME, exposure_view, picture, record_session, snapshots

ROOT = Path(__file__).parents[2]
SERVED = Decision(1.0, "dissect", "PSM2", "servo_cp", True, Code.OK, "", (0.0, 0.1, 0.2, 0.0, 0.0, 0.0, 1.0))

KILLED = """
import sys
from pathlib import Path
from supervisor.record import Recorder
recorder = Recorder(Path(sys.argv[1]), {"seed": 1})
k = 0
while True:
    recorder.write("/log", k * 0.01, {"text": f"line {k}", "filler": "x" * 3000})
    if k % 10 == 0:
        recorder.flush()
        print(k, flush=True)
    k += 1
"""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_session(tmp_path_factory.mktemp("sessions") / "one")


def test_a_closed_session_reads_back_whole(session: Path) -> None:
    record = read(session)
    assert record.closed and record.whole
    assert record.header["seed"] == HEADER["seed"] and record.header["limits"] == HEADER["limits"]
    assert record.outcome["code"] == OUTCOME["code"]
    assert record.end == pytest.approx(30.0)
    assert len(record.topic("/graph")) == 2
    assert record.topic("/truth")[1].payload["effective_cut_ratio"] == 1.0


def test_every_change_of_status_is_recorded_with_the_old_one(session: Path) -> None:
    changes = [entry.payload for entry in read(session).topic("/tree") if entry.payload["name"] == "expose"]
    assert [(c["old"], c["status"]) for c in changes] == [("INVALID", "RUNNING"), ("RUNNING", "SUCCESS")] * 1 + [
        ("SUCCESS", "RUNNING"),
        ("RUNNING", "SUCCESS"),
    ]
    assert changes[0]["message"] == "expose: 0 s"


def test_stamps_are_bench_time_and_never_go_back(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "s", {})
    for stamp in (1.0, 3.0, 2.0, float("nan"), 4.0):
        recorder.write("/log", stamp, {"text": ""})
    recorder.close({})
    assert [entry.stamp for entry in read(tmp_path / "s").topic("/log")] == [1.0, 3.0, 3.0, 3.0, 4.0]


def test_all_decisions_are_in_the_record_once(tmp_path: Path) -> None:
    given = list(snapshots(images=False))
    recorder = Recorder(tmp_path / "s", {})
    for snapshot in given:
        for decision in snapshot.decisions:
            recorder.decision(decision)
        recorder.snapshot(snapshot)
    recorder.close({})
    expected = [(d.stamp, d.accepted) for snapshot in given for d in snapshot.decisions]
    found = [(e.payload["stamp"], e.payload["accepted"]) for e in read(tmp_path / "s").topic("/decisions")]
    assert found == expected


def test_decisions_that_came_with_the_snapshot_only_are_recorded_too(session: Path) -> None:
    expected = sum(len(snapshot.decisions) for snapshot in snapshots(images=False))
    assert len(read(session).topic("/decisions")) == expected


def test_each_planned_step_is_recorded_and_the_triangles_once_for_each_exposure(session: Path) -> None:
    steps = [entry.payload for entry in read(session).topic("/exposure")]
    meshes = [entry.payload for entry in read(session).topic("/exposure/mesh")]
    assert [(s["exposure"], s["attempt"], s["number"]) for s in steps] == [(k, k, n) for k in (1, 2) for n in range(1, 10)]
    assert [(m["exposure"], m["triangles"]) for m in meshes] == [(k, [[0, 1, 2], [2, 1, 3]]) for k in (1, 2)]
    assert {k: steps[2][k] for k in ("opening", "camera", "tension")} == {
        "opening": 1200.0,
        "camera": -0.9,
        "tension": pytest.approx(0.3),
    }


def test_the_controllers_points_are_recorded_to_a_hundredth_of_a_millimetre_and_few_of_its_paths(session: Path) -> None:
    step = read(session).topic("/exposure")[2].payload
    assert step["vertices"][0] == [-0.0015, 0.0, 0.1]
    assert np.shape(step["paths"]) == (16, 6, 3) and np.shape(step["plan"]) == (6, 3)
    np.testing.assert_array_equal(np.round(step["paths"], 5), step["paths"])


def test_a_step_without_a_plan_is_recorded_with_its_numbers_unknown(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "s", {})
    nothing = float("nan")
    view = replace(exposure_view(1, 1), opening=nothing, camera=nothing, deform=nothing, tension=nothing)
    recorder.snapshot(replace(next(snapshots(images=False)), exposure=view))
    recorder.close({})
    step = read(tmp_path / "s").topic("/exposure")[0].payload
    assert [step[name] for name in ("opening", "camera", "deform", "tension")] == [None] * 4 and step["separation"] == 0.3


def test_images_are_read_when_asked_for_and_those_of_estimates_are_lossless(session: Path) -> None:
    record = read(session)
    first = dict(record.images(record.image_stamps[:1]))
    assert list(first) == [0.0]
    np.testing.assert_array_equal(first[0.0], picture(0, (230, 240), 0))
    assert any(abs(stamp - 19.0) < 1e-6 for stamp in record.image_stamps)


def test_numbers_that_are_not_finite_become_null(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "s", {"age": float("inf")})
    recorder.write("/truth", 0.0, {"values": np.array([1.0, np.nan])})
    recorder.close({})
    record = read(tmp_path / "s")
    assert record.topic("/truth")[0].payload == {"values": [1.0, None]}
    assert record.header["age"] is None


def test_a_path_leaves_only_its_last_part_in_the_record(tmp_path: Path) -> None:
    Recorder(tmp_path / "s", {"goal": Path("/home/somebody/goal.json")}).close({})
    assert read(tmp_path / "s").header["goal"] == "goal.json"


def test_what_a_record_cannot_hold_is_a_programming_error(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="cannot hold a object"):
        Recorder(tmp_path / "s", {}).write("/log", 0.0, {"text": object()})


def test_a_record_is_never_overwritten(session: Path) -> None:
    before = (session / MCAP_FILE).read_bytes()
    with pytest.raises(InputError, match="already holds a session"):
        Recorder(session, {})
    assert (session / MCAP_FILE).read_bytes() == before


def test_a_session_killed_while_writing_reads_back_to_its_last_flush(tmp_path: Path) -> None:
    folder = tmp_path / "killed"
    child = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(folder)], stdout=subprocess.PIPE, cwd=ROOT, text=True, env=dict(os.environ)
    )
    assert child.stdout is not None
    flushed = -1
    while flushed < 200:
        assert select.select([child.stdout], [], [], 60)[0], "the child wrote nothing"
        flushed = int(child.stdout.readline())
    child.send_signal(signal.SIGKILL)
    child.wait()
    record = read(folder)
    assert not record.closed and not record.whole
    texts = [entry.payload["text"] for entry in record.topic("/log")]
    assert len(texts) > flushed
    assert texts == [f"line {k}" for k in range(len(texts))]


@pytest.mark.parametrize("kept", [0, 5, 8, 40, 3_000, 60_000, -1, -9])
def test_a_record_cut_at_any_byte_still_opens(session: Path, tmp_path: Path, kept: int) -> None:
    (tmp_path / HEADER_FILE).write_bytes((session / HEADER_FILE).read_bytes())
    (tmp_path / MCAP_FILE).write_bytes((session / MCAP_FILE).read_bytes()[:kept])
    whole = read(session)
    record = read(tmp_path)
    assert not record.closed or kept == -1  # the very last byte is padding of the magic: the footer was seen
    for topic, entries in record.messages.items():
        assert entries == whole.topic(topic)[: len(entries)]


def test_a_flipped_byte_ends_the_reading_there(session: Path, tmp_path: Path) -> None:
    data = bytearray((session / MCAP_FILE).read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / HEADER_FILE).write_bytes((session / HEADER_FILE).read_bytes())
    (tmp_path / MCAP_FILE).write_bytes(bytes(data))
    record = read(tmp_path)
    assert not record.whole
    assert record.topic("/log") == read(session).topic("/log")[: len(record.topic("/log"))]


def test_no_session_no_header_or_another_file_is_one_clear_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no session record"):
        read(tmp_path)
    (tmp_path / MCAP_FILE).write_bytes(b"something else altogether")
    with pytest.raises(InputError, match=r"session\.json cannot be read"):
        read(tmp_path)
    (tmp_path / HEADER_FILE).write_text("{")
    with pytest.raises(InputError, match="not valid JSON"):
        read(tmp_path)
    (tmp_path / HEADER_FILE).write_text("{}")
    with pytest.raises(InputError, match="is not a session record"):
        read(tmp_path)


class _FullDisk:
    """A file that takes `room` bytes and then says that the disk is full."""

    def __init__(self, file: object, room: int) -> None:
        self._file, self._room = file, room

    def write(self, data: bytes) -> int:
        self._room -= len(data)
        if self._room < 0:
            raise OSError(28, "No space left on device")
        return self._file.write(data)  # type: ignore[attr-defined, no-any-return]

    def __getattr__(self, name: str) -> object:
        return getattr(self._file, name)


def test_a_full_disk_is_a_fault_that_stays_and_stops_commands(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "s", {})
    writer = recorder._writer
    writer._Writer__stream = _FullDisk(writer._Writer__stream, room=20_000)  # type: ignore[attr-defined]
    rng = np.random.default_rng(0)
    assert recorder.fault() is None
    for k in range(40):
        recorder.write("/log", k, {"text": rng.bytes(800).hex()})
        recorder.flush()
    assert recorder.fault() == "The record cannot be written: No space left on device."
    with pytest.raises(RuntimeError, match="No space left"):
        recorder.decision(SERVED)
    recorder.close(OUTCOME)
    record = read(tmp_path / "s")
    assert not record.closed and record.header["fault"] == recorder.fault()
    assert len(record.topic("/log")) > 5


def test_a_nearly_full_disk_is_a_fault_before_it_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder(tmp_path / "s", {})
    monkeypatch.setattr("supervisor.record.MIN_FREE", 1 << 62)
    recorder.flush()
    assert "MB left" in (recorder.fault() or "")


def test_a_folder_that_cannot_be_made_is_one_clear_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be recorded"):
        Recorder(tmp_path / "file" / "s", {})


def test_closing_twice_changes_nothing(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "s", {})
    recorder.close(OUTCOME)
    before = (tmp_path / "s" / HEADER_FILE).read_bytes()
    recorder.close({"code": "aborted"})
    recorder.write("/log", 1.0, {"text": "late"})
    assert (tmp_path / "s" / HEADER_FILE).read_bytes() == before


def test_two_sessions_that_went_alike_are_alike_to_the_byte(tmp_path: Path) -> None:
    one, two = (record_session(tmp_path / name, images=False) for name in ("one", "two"))
    assert (one / MCAP_FILE).read_bytes() == (two / MCAP_FILE).read_bytes()


def test_every_topic_registers_its_schema(session: Path) -> None:
    from mcap.reader import make_reader

    with (session / MCAP_FILE).open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    schemas = {c.topic: summary.schemas[c.schema_id] for c in summary.channels.values()}
    assert schemas["/endoscope"].name == "foxglove.CompressedImage"
    assert all(schema.encoding == "jsonschema" and json.loads(schema.data)["type"] == "object" for schema in schemas.values())
    assert {"/tree", "/decisions", "/graph", "/signals", "/outcome", "/exposure/mesh"} <= set(schemas)
    assert (schemas["/exposure"].name, schemas["/exposed"].name) == ("dissect.ExposureStep", "dissect.Exposed")


def test_the_status_file_follows_the_session_and_tells_its_end(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "s", {})
    given = list(snapshots(images=False))
    for snapshot in given:
        recorder.snapshot(snapshot)
    running = read_status(tmp_path / "s")
    recorder.close(OUTCOME)
    status = read_status(tmp_path / "s")
    assert running.running and not status.running
    assert status.outcome["code"] == "complete"
    assert status.snapshot.nodes == given[-1].nodes
    assert status.recent.refusals[-1].times == 4


def test_a_file_is_replaced_in_one_step(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"a": 1})
    with pytest.raises(TypeError):
        write_json(tmp_path / "a.json", {"a": object()})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": 1}
