"""The live view in a terminal: tree, guards, attempt, attachments, exposure, forces, refusals, log; else a line for each change."""

from __future__ import annotations

import math
import time
from types import TracebackType

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from hardware.limits import Limits
from supervisor.exposing import in_words
from supervisor.history import GUARDS, is_guard
from supervisor.palette import STATUS, STATUS_SIGN
from supervisor.recent import Recent
from supervisor.snapshot import NodeState, TickSnapshot

PERIOD = 0.125  # [s] of wall time between two pictures
DEFAULT_LIMITS = Limits()
EVERY = 5  # of the exposure controller's steps, one is told as a plain line


class TerminalView:
    """Shows each tick, at most 8 a second; a context manager. Without a terminal: one line for each change that matters."""

    def __init__(self, console: Console | None = None, limits: Limits = DEFAULT_LIMITS, title: str = "dissection") -> None:
        self._console = console or Console()
        self._limits = limits
        self._title = title
        self._recent = Recent()
        self._due = -math.inf
        self._lines = PlainLines(self._console)
        self._live: Live | None = None
        self._last: TickSnapshot | None = None
        if self._console.is_terminal:
            self._live = Live(console=self._console, auto_refresh=False, transient=False, redirect_stdout=False)
            self._live.start()

    def __enter__(self) -> TerminalView:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def update(self, snapshot: TickSnapshot) -> None:
        """Show this tick, if it is time for a new picture."""
        self._recent = self._recent.after(snapshot)
        self._last = snapshot
        if self._live is None:
            self._lines.update(snapshot)
            return
        now = time.monotonic()
        if now >= self._due:
            self._due = now + PERIOD
            self._draw(self._live, snapshot)

    def pause(self) -> None:
        """Give the terminal to somebody else, a question to the operator say; the next `update` takes it back."""
        if self._live is not None and self._live.is_started:
            self._live.stop()

    def close(self) -> None:
        """Show the last tick and leave it standing."""
        if self._live is not None and self._live.is_started:
            if self._last is not None:
                self._draw(self._live, self._last)
            self._live.stop()
        self._live = None

    def _draw(self, live: Live, snapshot: TickSnapshot) -> None:
        if not live.is_started:
            live.start()
        size = self._console.size
        live.update(picture(snapshot, self._recent, self._limits, self._title, size.width, size.height - 1), refresh=True)


class PlainLines:
    """One line for each change of status of a leaf or the root, each refusal's first, each line of the log, some steps of a pull."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._statuses: dict[str, str] = {}
        self._attempt = 0
        self._refusal: tuple[str, str, str] | None = None

    def update(self, snapshot: TickSnapshot) -> None:
        """Print what this tick changed."""
        parents = {node.path.rpartition("/")[0] for node in snapshot.nodes}
        if snapshot.attempt != self._attempt:
            self._attempt = snapshot.attempt
            self._say(snapshot, f"attempt {snapshot.attempt} of {snapshot.max_attempts}")
        for node in snapshot.nodes:
            old = self._statuses.get(node.path, "INVALID")
            self._statuses[node.path] = node.status
            shown = node.path not in parents or node.depth == 0
            passed = is_guard(node.path) and {node.status, old} == {"SUCCESS", "INVALID"}
            if node.status != old and shown and not passed and not (node.status == "INVALID" and old != "RUNNING"):
                status = "interrupted" if node.status == "INVALID" else node.status.lower()
                self._say(snapshot, f"{node.name} {status}" + (f": {node.message}" if node.message else ""))
        for d in snapshot.decisions:
            kind = None if d.accepted else (d.arm, d.command, str(d.code))
            if kind is not None and kind != self._refusal:
                self._say(snapshot, f"refused {d.arm} {d.command} ({d.code}): {d.message}")
            self._refusal = kind
        if snapshot.exposure is not None and snapshot.exposure.number % EVERY == 0:
            self._say(snapshot, f"exposing: {in_words(snapshot.exposure)}")
        for text in snapshot.log:
            self._say(snapshot, text)

    def _say(self, snapshot: TickSnapshot, text: str) -> None:
        self._console.print(Text(f"{snapshot.stamp:8.2f} s  {text}"), soft_wrap=True)


def picture(
    snapshot: TickSnapshot,
    recent: Recent,
    limits: Limits = DEFAULT_LIMITS,
    title: str = "dissection",
    width: int = 100,
    height: int = 40,
) -> RenderableType:
    """Make the whole view of one tick for a terminal of `width` x `height` characters."""
    inner = height - 4
    right: list[RenderableType] = [
        _facts(snapshot, recent),
        Text(""),
        _meters(snapshot, limits),
        Text(""),
        _guards(snapshot),
    ]
    if recent.refusals:
        right += [Text("\nrefused by the safety gate", style="bold")]
        right += [
            Text(
                f"{r.stamp:7.1f} s {r.arm} {r.command}" + (f" ×{r.times}" if r.times > 1 else "") + f": {r.message}",
                style="#c98a1b",
            )
            for r in recent.refusals[-3:]
        ]
    if recent.lines:
        right += [Text("\nlog", style="bold")]
        right += [Text(f"{stamp:7.1f} s {text}", style="dim", overflow="ellipsis", no_wrap=True) for stamp, text in recent.lines]
    body = Table.grid(expand=True, padding=(0, 2))
    if width >= 80:
        body.add_column(ratio=5)
        body.add_column(ratio=6)
        body.add_row(_tree(snapshot, inner), Group(*right))
    else:
        body.add_column()
        body.add_row(Group(*right))
    heading = Text.assemble((f" {title} ", "bold"), (f" {snapshot.stamp:.1f} s ", "dim"))
    return Panel(
        body,
        title=heading,
        title_align="left",
        border_style=_border(snapshot),
        subtitle=Text(" Ctrl-C holds the arms and ends ", style="dim"),
    )


def _border(snapshot: TickSnapshot) -> str:
    return STATUS.get(snapshot.nodes[0].status, "dim") if snapshot.nodes else "dim"


def _tree(snapshot: TickSnapshot, height: int) -> RenderableType:
    """The tree, guards apart; what is at rest folds away when the terminal is too low for all of it."""
    nodes = [node for node in snapshot.nodes if not is_guard(node.path)]
    while len(nodes) > height:
        status = {node.path: node.status for node in nodes}
        folded = [n for n in nodes if n.depth < 2 or status.get(n.path.rpartition("/")[0]) == "RUNNING"]
        if len(folded) == len(nodes):
            break
        nodes = folded
    return Group(*(_node(node) for node in nodes[:height]))


def _node(node: NodeState) -> Text:
    colour = STATUS.get(node.status, "")
    text = Text("  " * node.depth, no_wrap=True, overflow="ellipsis")
    text.append(f"{STATUS_SIGN.get(node.status, '?')} ", style=colour)
    quiet = node.status == "INVALID"
    text.append(node.name, style="dim" if quiet else ("bold " + colour if node.status == "RUNNING" else ""))
    if node.message and not quiet:
        text.append(f"  {node.message}", style="dim")
    return text


def _facts(snapshot: TickSnapshot, recent: Recent) -> RenderableType:
    left = "not known yet" if snapshot.attachments is None else str(snapshot.attachments)
    table = Table.grid(padding=(0, 2))
    table.add_row("attempt", Text(f"{snapshot.attempt} of {snapshot.max_attempts}", style="bold"))
    table.add_row("attachments left", Text(left, style="bold"))
    table.add_row("now", Text(snapshot.progress or "–", style="bold"))
    if recent.exposing:
        table.add_row("exposing", Text(recent.exposing))
    return table


def _meters(snapshot: TickSnapshot, limits: Limits) -> RenderableType:
    """Tension and strain against the limits at which pulling on is refused."""
    table = Table.grid(padding=(0, 2))
    table.add_row("tension", *_meter(snapshot.tension, limits.tension_warn, limits.tension_stop, f"{snapshot.tension:4.2f} N"))
    table.add_row("strain", *_meter(snapshot.strain, limits.strain_warn, limits.strain_stop, f"{100 * snapshot.strain:4.0f} %"))
    return table


def _meter(value: float, warn: float, stop: float, said: str) -> tuple[RenderableType, Text]:
    if not math.isfinite(value):
        return Text("no reading", style="bold #c8372d"), Text("")
    colour = "#2e8b57" if value < warn else ("#c98a1b" if value < stop else "#c8372d")
    bar = ProgressBar(total=stop, completed=min(max(value, 0.0), stop), width=24, complete_style=colour, finished_style=colour)
    return bar, Text(said, style=colour)


def _guards(snapshot: TickSnapshot) -> RenderableType:
    table = Table.grid(padding=(0, 1))
    for node in snapshot.nodes:
        if is_guard(node.path):
            holds = node.status == "SUCCESS"
            said = "" if holds else node.message or {"RUNNING": "waiting", "FAILURE": "stopped"}.get(node.status, "not asked yet")
            colour = "#c98a1b" if node.status == "RUNNING" else STATUS.get(node.status, "")
            table.add_row(Text("●" if node.status != "INVALID" else "○", style=colour), node.name, Text(said, style=colour))
    return Group(Text(GUARDS, style="bold"), table) if table.row_count else Text("")
