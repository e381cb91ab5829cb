"""`dissect watch`: the terminal view of a session that runs in another process, from its status file."""

from __future__ import annotations

import time
from pathlib import Path

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from hardware.codes import InputError
from supervisor.status import STATUS_FILE, Status, read_status
from supervisor.terminal import picture

POLL = 0.25  # [s]
SILENT = 5.0  # [s] without news before the view says so
GONE = 30.0  # [s] without news before a session no longer counts as running


def find_running(where: Path) -> Path:
    """Give the folder of the newest running session: `where` itself or one of the folders in it.

    Raises:
        InputError: none is running; the sentence says where was looked.
    """
    folders = [where] if (where / STATUS_FILE).is_file() else [path.parent for path in where.glob(f"*/{STATUS_FILE}")]
    running: list[tuple[float, Path]] = []
    for folder in folders:
        try:
            status = read_status(folder)
        except InputError:
            continue
        if status.running and status.age < GONE:
            running.append((status.age, folder))
    if not running:
        raise InputError(
            f"No session is running in {where}; start one with `dissect run`, or see an ended one with `dissect replay`."
        )
    return min(running)[1]


def watch(where: Path, console: Console | None = None) -> Status:
    """Show the newest running session below `where` until it ends or falls silent; return its last status.

    Raises:
        InputError: none is running there.
    """
    folder = find_running(where)
    console = console or Console()
    status = read_status(folder)
    with Live(console=console, auto_refresh=False) as live:
        while True:
            live.update(_shown(status, folder, console), refresh=True)
            if not status.running or status.age >= GONE:
                return status
            time.sleep(POLL)
            status = read_status(folder)


def _shown(status: Status, folder: Path, console: Console) -> RenderableType:
    size = console.size
    view = picture(status.snapshot, status.recent, title=folder.resolve().name, width=size.width, height=size.height - 3)
    return Group(view, said(status))


def said(status: Status) -> Text:
    """Say below the view whether the session goes on."""
    if not status.running:
        outcome = str(status.outcome.get("outcome") or status.outcome.get("code") or "ended").replace("_", " ")
        return Text(f"The session has ended: {outcome}. {status.outcome.get('message', '')}".strip(), style="bold")
    if status.age >= GONE:
        return Text(
            f"No news for {status.age:.0f} s: the session was probably killed. See `dissect replay`.", style="bold #c8372d"
        )
    if status.age >= SILENT:
        return Text(f"No news for {status.age:.0f} s: it computes, waits for the operator, or was killed.", style="#c98a1b")
    return Text("watching; Ctrl-C ends the watching only", style="dim")
