"""What a view may show of one tick: plain data, made once by the session and given to every view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hardware.gate import Decision
from hardware.interface import Frame, Pose
from skills.estimate.graph import ConnectivityGraph
from skills.tracking.tracks import TrackedGoal

if TYPE_CHECKING:  # the controller brings Warp and CasADi with it, which watching and replaying do without
    from skills.expose.optimal import View


@dataclass(frozen=True)
class NodeState:
    """One node of the tree: `path` is its stable name (`session/procedure/...`), `depth` its distance from the root."""

    path: str
    name: str
    kind: str
    depth: int
    status: str
    message: str


@dataclass(frozen=True)
class TickSnapshot:
    """One tick of a session, for live views and the record. Forces [N], angles [rad], poses in the left camera frame.

    `frame`, `tracked` and `exposure` (what the exposure controller has in mind) are given once, when they are new.
    """

    tick: int
    stamp: float
    nodes: tuple[NodeState, ...]
    attempt: int
    max_attempts: int
    progress: str
    attachments: int | None
    tension: float
    strain: float
    tools: dict[str, Pose]
    jaws: dict[str, float]
    decisions: tuple[Decision, ...] = ()
    log: tuple[str, ...] = ()
    frame: Frame | None = None
    tracked: TrackedGoal | None = None
    graph: ConnectivityGraph | None = None
    exposure: View | None = None
