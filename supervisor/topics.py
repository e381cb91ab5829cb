"""The topics of a session's record and their JSON schemas, so that the file explains itself to Foxglove, Rerun or a script.

All messages are JSON. SI units, bench time [s], poses in the left camera frame, pixels (u, v) of the left image. A number
that was not finite is null.
"""

from __future__ import annotations

from typing import Any

TREE = "/tree"  # a node changed its status
STRUCTURE = "/tree/structure"  # all nodes, in tree order
DECISIONS = "/decisions"  # every command with the gate's verdict
PROGRESS = "/progress"  # which attempt, doing what
SIGNALS = "/signals"  # tension, strain, attachments left
TOOLS = "/tools"
GOAL = "/goal"  # the tracked goal
GRAPH = "/graph"  # the connectivity estimate
LOG = "/log"
# What the behaviours note
APPROVAL = "/approval"  # asked, approved, refused or void
RECOVERY = "/recovery"
WAITING = "/waiting"  # a guard holds everything until a condition passes
INTERRUPTION = "/interruption"
PLAN = "/plan"  # the corrective segments
EXPOSED = "/exposed"  # how a pull went and why it ended; with the controller, what it expected of it
EXPOSURE = "/exposure"  # each step that the exposure controller planned
EXPOSURE_MESH = "/exposure/mesh"  # triangles of its expected mesh, once for each exposure
TRUTH = "/truth"  # the simulated bench only; never read by the controller
BENCH = "/bench"  # a robot only: rates, delays and losses of its topics since the session began
OUTCOME = "/outcome"
ENDOSCOPE = "/endoscope"  # left image, foxglove.CompressedImage

NUMBER: dict[str, Any] = {"type": ["number", "null"]}
TEXT: dict[str, Any] = {"type": "string"}
INTEGER: dict[str, Any] = {"type": "integer"}
LIST: dict[str, Any] = {"type": ["array", "null"]}
FLAG: dict[str, Any] = {"type": "boolean"}

# Topic: (name of the schema, fields)
SCHEMAS: dict[str, tuple[str, dict[str, Any]]] = {
    TREE: ("dissect.NodeChange", {"path": TEXT, "name": TEXT, "kind": TEXT, "old": TEXT, "status": TEXT, "message": TEXT}),
    STRUCTURE: ("dissect.TreeStructure", {"nodes": LIST}),
    DECISIONS: (
        "dissect.Decision",
        {
            "stamp": NUMBER,
            "holder": TEXT,
            "arm": TEXT,
            "command": TEXT,
            "accepted": FLAG,
            "code": TEXT,
            "message": TEXT,
            "target": LIST,
        },
    ),
    APPROVAL: (
        "dissect.Approval",
        {"event": TEXT, "kind": TEXT, "goal_id": TEXT, "by": TEXT, "frame_sequence": INTEGER, "reason": TEXT},
    ),
    RECOVERY: ("dissect.Recovery", {"step": TEXT, "code": TEXT, "recovery": TEXT}),
    WAITING: ("dissect.Waiting", {"guard": TEXT, "code": TEXT, "message": TEXT}),
    INTERRUPTION: ("dissect.Interruption", {"count": INTEGER}),
    PLAN: (
        "dissect.Plan",
        {
            "code": TEXT,
            "message": TEXT,
            "segments": LIST,
            "severs": LIST,
            "reasons": LIST,
            "proven": {"type": "boolean"},
            "greedy_segments": {"type": ["integer", "null"]},
            "left_out": INTEGER,
        },
    ),
    EXPOSED: (
        "dissect.Exposed",
        {
            "code": TEXT,
            "message": TEXT,
            "stopped_by": TEXT,
            "steps": INTEGER,
            "path": LIST,
            "tension": LIST,
            "strain": LIST,
            "stamps": LIST,
            "forecast": {"type": "object"},
            "planned": {"type": "object"},
        },
    ),
    EXPOSURE: (
        "dissect.ExposureStep",
        {
            "exposure": INTEGER,
            "attempt": INTEGER,
            "number": INTEGER,
            "camera": NUMBER,
            "deform": NUMBER,
            "opening": NUMBER,
            "tension": NUMBER,
            "separation": NUMBER,
            "vertices": LIST,
            "paths": LIST,
            "plan": LIST,
        },
    ),
    EXPOSURE_MESH: ("dissect.ExposureMesh", {"exposure": INTEGER, "attempt": INTEGER, "triangles": LIST}),
    PROGRESS: ("dissect.Progress", {"attempt": INTEGER, "max_attempts": INTEGER, "message": TEXT}),
    SIGNALS: ("dissect.Signals", {"tension": NUMBER, "strain": NUMBER, "attachments": {"type": ["integer", "null"]}}),
    TOOLS: ("dissect.Tools", {}),
    GOAL: (
        "dissect.TrackedGoal",
        {
            "polyline": LIST,
            "near": LIST,
            "far": LIST,
            "visible": LIST,
            "grasp": LIST,
            "grasp_visible": FLAG,
            "lost": FLAG,
            "strain": NUMBER,
        },
    ),
    GRAPH: (
        "dissect.ConnectivityGraph",
        {
            "attempt": INTEGER,
            "attachments": {"type": ["integer", "null"]},
            "complete": FLAG,
            "code": TEXT,
            "message": TEXT,
            "reference": LIST,
            "points": LIST,
            "edges": LIST,
            "elongation": LIST,
            "state": LIST,
            "probability": LIST,
            "crosses_goal": LIST,
            "station": LIST,
        },
    ),
    LOG: ("dissect.Log", {"text": TEXT}),
    TRUTH: (
        "dissect.Truth",
        {
            "attempt": INTEGER,
            "attachments": INTEGER,
            "effective_cut_ratio": NUMBER,
            "excessive_cut_ratio": NUMBER,
            "length_deviation_m": NUMBER,
            "visible_area_px": NUMBER,
        },
    ),
    BENCH: ("dissect.Bench", {"topics": LIST, "unpaired_images": INTEGER, "monitor": {"type": "object"}, "late_ticks": INTEGER}),
    OUTCOME: ("dissect.Outcome", {}),
    ENDOSCOPE: (
        "foxglove.CompressedImage",
        {
            "timestamp": {"type": "object", "properties": {"sec": INTEGER, "nsec": INTEGER}},
            "frame_id": TEXT,
            "data": {"type": "string", "contentEncoding": "base64"},
            "format": TEXT,
        },
    ),
}


def is_image(topic: str) -> bool:
    """Whether a topic carries images: the left eye's, or another below it."""
    return topic == ENDOSCOPE or topic.startswith(ENDOSCOPE + "/")


def schema_of(topic: str) -> tuple[str, dict[str, Any]]:
    """Name and JSON schema of a topic; all images share one, and a topic that is unknown here is any object."""
    if is_image(topic):
        topic = ENDOSCOPE
    name, properties = SCHEMAS.get(topic, ("dissect" + topic.replace("/", ".").rstrip("."), {}))
    return name, {"title": name, "type": "object", "properties": properties}
