"""`status.json` beside a record: the newest tick of a running session, for whoever watches from another terminal.

Written atomically and seldom, without images; the record itself is the truth. A reader never sees half a file.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hardware.codes import Code, InputError
from supervisor.plain import plain
from supervisor.recent import Recent, Refused
from supervisor.snapshot import NodeState, TickSnapshot

STATUS_FILE = "status.json"
PERIOD = 0.2  # [s] of wall time between two writes


@dataclass(frozen=True)
class Status:
    """What `status.json` says: the newest tick (without frame, tools and estimates), what is kept, whether it goes on."""

    snapshot: TickSnapshot
    recent: Recent
    running: bool
    outcome: dict[str, Any]
    age: float  # [s] of wall time since it was written


class StatusWriter:
    """Writes `status.json` into `folder`, at most every `PERIOD` of wall time."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / STATUS_FILE
        self._recent = Recent()
        self._snapshot: TickSnapshot | None = None
        self._due = -float("inf")

    def update(self, snapshot: TickSnapshot) -> None:
        """Take note of this tick, and write it if it is time.

        Raises:
            OSError: the file cannot be written.
        """
        self._snapshot, self._recent = snapshot, self._recent.after(snapshot)
        now = time.monotonic()
        if now >= self._due:
            self._due = now + PERIOD
            self._write(running=True, outcome={})

    def close(self, outcome: dict[str, Any]) -> None:
        """Write the last tick and the session's outcome.

        Raises:
            OSError: the file cannot be written.
        """
        if self._snapshot is not None:
            self._write(running=False, outcome=outcome)

    def _write(self, *, running: bool, outcome: dict[str, Any]) -> None:
        assert self._snapshot is not None
        s = self._snapshot
        shown = {
            "tick": s.tick,
            "stamp": s.stamp,
            "nodes": s.nodes,
            "attempt": s.attempt,
            "max_attempts": s.max_attempts,
            "progress": s.progress,
            "attachments": s.attachments,
            "tension": s.tension,
            "strain": s.strain,
            "jaws": s.jaws,
        }
        data = {"running": running, "outcome": outcome, "snapshot": shown, "recent": self._recent}
        write_json(self._path, data)


def read_status(folder: Path) -> Status:
    """Read the status of the session in `folder`.

    Raises:
        InputError: there is none, or it cannot be understood.
    """
    path = folder / STATUS_FILE
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        age = time.time() - path.stat().st_mtime
        shown = data["snapshot"]
        snapshot = TickSnapshot(
            tick=int(shown["tick"]),
            stamp=_number(shown["stamp"]),
            nodes=tuple(NodeState(**node) for node in shown["nodes"]),
            attempt=int(shown["attempt"]),
            max_attempts=int(shown["max_attempts"]),
            progress=str(shown["progress"]),
            attachments=shown["attachments"],
            tension=_number(shown["tension"]),
            strain=_number(shown["strain"]),
            tools={},
            jaws={name: _number(angle) for name, angle in shown["jaws"].items()},
        )
        kept = data["recent"]
        recent = Recent(
            tuple(Refused(**{**refused, "code": str(Code(refused["code"]))}) for refused in kept["refusals"]),
            tuple((_number(stamp), str(text)) for stamp, text in kept["lines"]),
            str(kept.get("exposing", "")),
        )
        return Status(snapshot, recent, bool(data["running"]), dict(data["outcome"]), max(0.0, age))
    except OSError as error:
        raise InputError(f"There is no session status in the folder {folder}: {error.strerror or error}.") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"The session status in the folder {folder} cannot be understood.") from error


def write_json(path: Path, data: Any) -> None:
    """Write `data` as JSON to `path` in one step: a reader, or a kill in the middle, finds the old file or the new one.

    Raises:
        OSError: the file cannot be written.
    """
    temporary = path.with_name(path.name + ".new")
    temporary.write_text(json.dumps(plain(data), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    temporary.replace(path)


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)
