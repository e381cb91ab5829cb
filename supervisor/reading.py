"""Reading a session's record back, whole or cut short by a kill: everything up to the first broken byte counts.

Images are left in the file until they are asked for, so that a long session fits into memory.
"""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.exceptions import InvalidMagic
from mcap.records import Channel, Footer, Message
from mcap.stream_reader import StreamReader

from hardware.codes import InputError
from hardware.interface import Image
from supervisor import topics
from supervisor.record import HEADER_FILE, MCAP_FILE

RECORD_LIMIT = 512 * 1024 * 1024  # [bytes]; a longer MCAP record is taken for a broken length


@dataclass(frozen=True)
class Entry:
    """One message of a record at bench time `stamp` [s]."""

    topic: str
    stamp: float
    payload: dict[str, Any]


@dataclass(frozen=True)
class SessionRecord:
    """A session as its folder tells it.

    `closed` when it ended as it should; `whole` when the file has its end (a killed session's has not). `messages` are by
    topic, in order; `image_stamps` are the bench times [s] of the images of the left eye, in order.
    """

    folder: Path
    header: dict[str, Any]
    closed: bool
    whole: bool
    messages: dict[str, tuple[Entry, ...]] = field(repr=False)
    image_stamps: tuple[float, ...] = field(repr=False)

    def topic(self, name: str) -> tuple[Entry, ...]:
        """Messages of one topic in order, empty if there are none."""
        return self.messages.get(name, ())

    @property
    def outcome(self) -> dict[str, Any]:
        """What the session ended with; empty when it was not closed."""
        entries = self.topic(topics.OUTCOME)
        return dict(self.header.get("outcome") or (entries[-1].payload if entries else {}))

    @property
    def end(self) -> float:
        """Bench time [s] of the last thing recorded."""
        stamps = [entries[-1].stamp for entries in self.messages.values() if entries]
        return max([*stamps, *self.image_stamps[-1:]], default=0.0)

    def images(self, stamps: Collection[float]) -> Iterator[tuple[float, Image]]:
        """Images (H, W, 3) uint8 RGB of the left eye at the given `image_stamps`, in order of time."""
        wanted = set(stamps)
        for topic, stamp, data in _messages(self.folder / MCAP_FILE, []):
            if topic == topics.ENDOSCOPE and stamp in wanted:
                image = _decoded(data)
                if image is not None:
                    yield stamp, image


def read(folder: Path) -> SessionRecord:
    """Read the session in `folder`.

    Raises:
        InputError: there is no session, or it is none of ours; one sentence says which.
    """
    folder = Path(folder)
    path = folder / MCAP_FILE
    if not path.is_file():
        raise InputError(f"There is no session record in {folder}: {MCAP_FILE} is missing.")
    header = _header(folder / HEADER_FILE)
    messages: dict[str, list[Entry]] = {}
    image_stamps: list[float] = []
    ending: list[Footer] = []
    for topic, stamp, data in _messages(path, ending):
        if topics.is_image(topic):
            if topic == topics.ENDOSCOPE:
                image_stamps.append(stamp)
            continue
        try:
            payload = json.loads(data)
        except ValueError:
            continue  # the checksum held, so this is not ours: a foreign message in our file
        if isinstance(payload, dict):
            messages.setdefault(topic, []).append(Entry(topic, stamp, payload))
    return SessionRecord(
        folder=folder,
        header=header,
        closed=bool(header.get("closed")) and bool(ending),
        whole=bool(ending),
        messages={topic: tuple(entries) for topic, entries in messages.items()},
        image_stamps=tuple(image_stamps),
    )


def _header(path: Path) -> dict[str, Any]:
    try:
        header = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"The session's {HEADER_FILE} cannot be read: {error.strerror or error}.") from error
    except ValueError as error:
        raise InputError(f"The session's {HEADER_FILE} is not valid JSON.") from error
    if not isinstance(header, dict):
        raise InputError(f"The session's {HEADER_FILE} must hold one JSON object.")
    return header


def _messages(path: Path, ending: list[Footer]) -> Iterator[tuple[str, float, bytes]]:
    """Topic, stamp [s] and data of each message up to the end or the first broken record; the footer goes to `ending`."""
    channels: dict[int, Channel] = {}
    try:
        with path.open("rb") as file:
            records = StreamReader(file, validate_crcs=True, record_size_limit=RECORD_LIMIT).records
            while True:
                try:
                    record = next(records)
                except StopIteration:
                    return
                except InvalidMagic as error:
                    if file.tell() <= 8 and path.stat().st_size >= 8:
                        raise InputError(f"The file {path} is not a session record.") from error
                    return
                except Exception:  # whatever a torn record makes the decoder say, the record ends here
                    return
                if isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message) and record.channel_id in channels:
                    yield channels[record.channel_id].topic, record.log_time * 1e-9, record.data
                elif isinstance(record, Footer):
                    ending.append(record)
    except OSError as error:
        raise InputError(f"The session record {path} cannot be read: {error.strerror or error}.") from error


def _decoded(data: bytes) -> Image | None:
    """The image (H, W, 3) uint8 RGB in a CompressedImage message, None if it is damaged."""
    try:
        encoded = base64.b64decode(json.loads(data)["data"], validate=True)
    except (ValueError, KeyError, TypeError, binascii.Error):
        return None
    bgr = cv2.imdecode(np.frombuffer(encoded, dtype=np.uint8), cv2.IMREAD_COLOR)
    return None if bgr is None else np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))
