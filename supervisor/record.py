"""The record of a session: a folder with `session.mcap` (the truth, append-only), `session.json` and `status.json`.

All that is written is in the file once `flush` returns, in whole chunks, so that a process killed at any moment leaves a
readable record of everything up to its last flush; that is at each transition, and at least each second of bench time. The
stamps are bench time. A write that fails (disk full) latches a fault which the tree's recorder guard reads; nothing is
written after it.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import threading
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import Writer

from hardware.codes import InputError
from hardware.gate import Decision
from hardware.interface import Array, Frame, Image
from skills.tracking.tracks import TrackedGoal
from supervisor import topics
from supervisor.exposing import some_paths
from supervisor.plain import plain
from supervisor.snapshot import TickSnapshot
from supervisor.status import StatusWriter, write_json

MCAP_FILE = "session.mcap"
HEADER_FILE = "session.json"
FORMAT = 1  # of the folder and the topics; grows when an old reader would misread
CHUNK = 256 * 1024  # [bytes]
FLUSH_PERIOD = 1.0  # [s], bench time
SIGNAL_PERIOD = 0.1  # [s]
GOAL_PERIOD = 0.5  # [s]
IMAGE_PERIOD = 2.0  # [s] between the JPEG images of a session; those beside estimates are PNG
JPEG_QUALITY = 88
DECIMALS = 5  # of the controller's points [m]: finer than 0.01 mm says nothing, and takes room
MIN_FREE = 64 * 1024 * 1024  # [bytes] of disk below which the record counts as failed, while it can still be closed


class Recorder:
    """Writes one session. `decision` may be called from the gate's thread; everything else from the session's.

    Raises:
        InputError: the folder cannot be made or already holds a session.
    """

    def __init__(self, folder: Path, header: dict[str, Any]) -> None:
        self._folder = folder
        self._header = {"format": FORMAT, "closed": False, **plain(header)}
        self._lock = threading.RLock()
        self._fault: str | None = None
        self._closed = False
        self._channels: dict[str, int] = {}
        self._sequence = 0
        self._log_time = 0
        self._flushed = -np.inf
        self._due: dict[str, float] = {}
        self._statuses: dict[str, str] = {}
        self._last: dict[str, Any] = {}
        self._told: list[Decision] = []  # by `decision` since the last snapshot, which brings them again
        self._frame: Frame | None = None
        self._tracked: TrackedGoal | None = None
        self._lossless = -1
        self._exposures = 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = (folder / MCAP_FILE).open("xb")
            write_json(folder / HEADER_FILE, self._header)
        except FileExistsError as error:
            raise InputError(f"The folder {folder} already holds a session; a record is never overwritten.") from error
        except OSError as error:
            raise InputError(f"The session cannot be recorded in {folder}: {error.strerror or error}.") from error
        self._writer = Writer(self._file, chunk_size=CHUNK)
        self._writer.start(profile="", library="dissection-supervisor")
        self._status = StatusWriter(folder)
        self.flush()

    @property
    def folder(self) -> Path:
        """The session's folder."""
        return self._folder

    def fault(self) -> str | None:
        """Why the session is no longer recorded, in one sentence; None while all is well."""
        return self._fault

    def write(self, topic: str, stamp: float, payload: Any) -> None:
        """Append one message at bench time `stamp` [s]; `payload` is a dict or a dataclass that `plain` understands.

        A topic may be given with or without its leading slash.

        Raises:
            TypeError: the payload cannot be held by a record (a programming error). A failing disk raises nothing: see `fault`.
        """
        data = json.dumps(plain(payload), allow_nan=False, separators=(",", ":")).encode()
        with self._lock:
            if self._fault is not None or self._closed:
                return
            topic = "/" + topic.lstrip("/")
            if np.isfinite(stamp):  # readers want times that never go back
                self._log_time = max(self._log_time, round(stamp * 1e9))
            self._sequence += 1
            try:
                self._writer.add_message(self._channel(topic), self._log_time, data, self._log_time, self._sequence)
            except OSError as error:
                self._failed(error)

    def image(self, topic: str, stamp: float, rgb: Image, *, lossless: bool = False) -> None:
        """Append an image (H, W, 3) uint8 RGB as PNG (`lossless`) or JPEG, in Foxglove's CompressedImage form."""
        kind, flags = (
            ("png", [cv2.IMWRITE_PNG_COMPRESSION, 3]) if lossless else ("jpeg", [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        )
        _, encoded = cv2.imencode(f".{kind}", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), flags)
        nanoseconds = round(stamp * 1e9)
        payload = {
            "timestamp": {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9},
            "frame_id": "left_camera",
            "data": base64.b64encode(encoded.tobytes()).decode(),
            "format": kind,
        }
        self.write(topic, stamp, payload)

    def decision(self, decision: Decision) -> None:
        """Record a command before it is sent; made to be the gate's `on_decision`.

        Raises:
            RuntimeError: the session is no longer recorded, so the command must not be sent.
        """
        with self._lock:
            self._told.append(decision)
            self.write(topics.DECISIONS, decision.stamp, decision)
        if self._fault is not None:
            raise RuntimeError(self._fault)

    def snapshot(self, snapshot: TickSnapshot) -> None:
        """Write what this tick changed, samples of the signals that are due, and the status file."""
        news = self._tree(snapshot)
        with self._lock:
            told, self._told = self._told, []
        known = {id(decision) for decision in told}
        for decision in snapshot.decisions:
            if id(decision) not in known:
                self.write(topics.DECISIONS, decision.stamp, decision)
        stamp = snapshot.stamp
        attempts = {"attempt": snapshot.attempt, "max_attempts": snapshot.max_attempts}
        self._changed(topics.PROGRESS, stamp, {**attempts, "message": snapshot.progress})
        for text in snapshot.log:
            self.write(topics.LOG, stamp, {"text": text})
        self._samples(snapshot)
        self._exposure(snapshot)
        news |= self._images(snapshot) | bool(snapshot.log)
        if news or stamp >= self._flushed + FLUSH_PERIOD:
            self._flushed = stamp
            self.flush()
        try:
            if self._fault is None and not self._closed:
                self._status.update(snapshot)
        except OSError as error:
            self._failed(error)

    def flush(self) -> None:
        """Hand everything written so far to the operating system, as a whole chunk."""
        with self._lock:
            if self._fault is not None or self._closed:
                return
            try:
                self._writer.flush()
                free = shutil.disk_usage(self._folder).free
            except OSError as error:
                self._failed(error)
                return
            if free < MIN_FREE:
                self._fault = f"The disk with the record has only {free / 1e6:.0f} MB left; {MIN_FREE / 1e6:.0f} MB are needed."

    def close(self, outcome: dict[str, Any]) -> None:
        """End the record: the last image, `outcome` (with the metrics), the index, and `closed: true` in session.json.

        Idempotent. After a fault the folder is closed as far as the disk allows, and session.json stays `closed: false`.
        """
        with self._lock:
            if self._closed:
                return
            if self._frame is not None and self._frame.sequence != self._lossless:
                self.image(topics.ENDOSCOPE, self._frame.stamp, self._frame.image, lossless=True)
            self.write(topics.OUTCOME, self._log_time * 1e-9, outcome)
            self.flush()
            self._closed = True
            try:
                if self._fault is None:
                    self._writer.finish()
                    self._file.flush()
                    os.fsync(self._file.fileno())
            except OSError as error:
                self._failed(error)
            try:
                self._file.close()
                ending = {"closed": self._fault is None, "fault": self._fault, "outcome": outcome}
                write_json(self._folder / HEADER_FILE, {**self._header, **ending})
                self._status.close(outcome)
            except OSError as error:
                self._failed(error)

    def _tree(self, snapshot: TickSnapshot) -> bool:
        """Nodes, and what changed its status since the last tick; whether anything did."""
        paths = [node.path for node in snapshot.nodes]
        news = self._last.get(topics.STRUCTURE) != paths
        if news:
            self._last[topics.STRUCTURE] = paths
            nodes = [{"path": n.path, "name": n.name, "kind": n.kind, "depth": n.depth} for n in snapshot.nodes]
            self.write(topics.STRUCTURE, snapshot.stamp, {"nodes": nodes})
        for node in snapshot.nodes:
            old = self._statuses.get(node.path, "INVALID")
            if node.status == old:
                continue
            self._statuses[node.path] = node.status
            change = {"path": node.path, "name": node.name, "kind": node.kind, "old": old, "status": node.status}
            self.write(topics.TREE, snapshot.stamp, {**change, "message": node.message})
            news = True
        return news

    def _samples(self, snapshot: TickSnapshot) -> None:
        """Signals, tools and the tracked goal, each at its own low rate."""
        stamp = snapshot.stamp
        if self._is_due(topics.SIGNALS, stamp, SIGNAL_PERIOD):
            signals = {"tension": snapshot.tension, "strain": snapshot.strain, "attachments": snapshot.attachments}
            self.write(topics.SIGNALS, stamp, signals)
            tools = {
                name: {"position": pose.position, "quaternion": pose.quaternion, "jaw": snapshot.jaws.get(name)}
                for name, pose in snapshot.tools.items()
            }
            self.write(topics.TOOLS, stamp, tools)
        self._tracked = snapshot.tracked or self._tracked
        if snapshot.tracked is not None and self._is_due(topics.GOAL, stamp, GOAL_PERIOD):
            self.write(topics.GOAL, snapshot.tracked.stamp, snapshot.tracked)

    def _exposure(self, snapshot: TickSnapshot) -> None:
        """A step that the exposure controller planned; before an exposure's first one, the triangles of its mesh."""
        view = snapshot.exposure
        if view is None:
            return
        if view.triangles is not self._last.get(topics.EXPOSURE_MESH):
            self._last[topics.EXPOSURE_MESH] = view.triangles
            self._exposures += 1
            mesh = {"exposure": self._exposures, "attempt": snapshot.attempt, "triangles": view.triangles}
            self.write(topics.EXPOSURE_MESH, snapshot.stamp, mesh)
        step = {
            "exposure": self._exposures,
            "attempt": snapshot.attempt,
            "number": view.number,
            "camera": view.camera,
            "deform": view.deform,
            "opening": view.opening,
            "tension": view.tension,
            "separation": view.separation,
            "vertices": _rounded(view.vertices),
            "paths": _rounded(some_paths(view)),
            "plan": _rounded(view.plan),
        }
        self.write(topics.EXPOSURE, snapshot.stamp, step)

    def _images(self, snapshot: TickSnapshot) -> bool:
        """A new estimate with the image it was made on, and an image now and then; whether there was an estimate."""
        frame = self._frame = snapshot.frame or self._frame
        graph = snapshot.graph
        estimated = graph is not None and graph is not self._last.get(topics.GRAPH)
        if estimated and graph is not None:
            self._last[topics.GRAPH] = graph
            about = {"attempt": snapshot.attempt, "attachments": snapshot.attachments, "complete": graph.complete}
            if self._tracked is not None:
                self.write(topics.GOAL, self._tracked.stamp, self._tracked)
        first = frame is not None and self._lossless < 0
        if frame is not None and frame.sequence != self._lossless and (estimated or first):
            self._lossless = frame.sequence
            self.image(topics.ENDOSCOPE, frame.stamp, frame.image, lossless=True)
            self._is_due(topics.ENDOSCOPE, frame.stamp, IMAGE_PERIOD)
        elif snapshot.frame is not None and self._is_due(topics.ENDOSCOPE, snapshot.frame.stamp, IMAGE_PERIOD):
            self.image(topics.ENDOSCOPE, snapshot.frame.stamp, snapshot.frame.image)
        if estimated:
            self.write(topics.GRAPH, snapshot.stamp, {**about, **plain(graph)})
        return estimated

    def _changed(self, topic: str, stamp: float, payload: dict[str, Any]) -> None:
        """Write `payload` if it is not what was written last on `topic`."""
        if self._last.get(topic) != payload:
            self._last[topic] = payload
            self.write(topic, stamp, payload)

    def _is_due(self, topic: str, stamp: float, period: float) -> bool:
        """Whether a sample of `topic` is due at `stamp` [s]; if so, the next one is due `period` [s] later."""
        if stamp < self._due.get(topic, -np.inf) - 1e-9:
            return False
        self._due[topic] = stamp + period
        return True

    def _channel(self, topic: str) -> int:
        if topic not in self._channels:
            name, schema = topics.schema_of(topic)
            schema_id = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        return self._channels[topic]

    def _failed(self, error: OSError) -> None:
        if self._fault is None:
            self._fault = f"The record cannot be written: {error.strerror or error}."


def _rounded(points: Array) -> Array:
    return np.round(points, DECIMALS)
