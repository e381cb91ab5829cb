"""Keeps the results of an experiment's jobs as they end, so that an interrupted experiment goes on where it was."""

from __future__ import annotations

import json
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from hardware.codes import InputError


class Journal:
    """A file with one line of JSON for each result. Only lines of the same condition and the same program are read again."""

    def __init__(self, path: Path, condition: dict[str, Any]) -> None:
        """Open the journal at `path`, or begin it.

        Raises:
            InputError: it cannot be written.
        """
        self._path = path
        self._settings = {**condition, "program": program()}
        try:
            cut_off = path.exists() and path.read_bytes()[-1:] not in (b"", b"\n")
            with path.open("a", encoding="utf-8") as file:
                # What a kill cut off in the middle of a line must not spoil the next one.
                file.write("\n" if cut_off else "")
        except OSError as error:
            raise InputError(f"the journal {path} cannot be written: {error.strerror}") from error

    def read(self) -> list[dict[str, Any]]:
        """Results of this condition, in the order in which they were kept; a line cut off by a kill is left out."""
        kept = []
        for line in self._path.read_text(encoding="utf-8").splitlines():
            try:
                entry = json.loads(line)
            except json.JSONDecodeError:
                continue
            if entry.get("settings") == self._settings:
                kept.append(entry["trial"])
        return kept

    def keep(self, trial: dict[str, Any]) -> None:
        """Add one result."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"settings": self._settings, "trial": trial}) + "\n")


@cache
def program() -> str:
    """A hash over the sources and scenes: a changed program does not go on with another's trials."""
    root = Path(__file__).parents[2]
    rooms = ("hardware", "skills", "behaviours", "trees", "supervisor")
    digest = sha256()
    for path in sorted(path for room in rooms for path in (root / room).rglob("*") if path.suffix in (".py", ".toml")):
        digest.update(path.relative_to(root).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
