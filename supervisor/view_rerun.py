"""The live view in Rerun, written to `session.rrd` as well: state lanes, tree graph, endoscope, 3D, exposure, forces, gate and log.

The server is bound to the loopback interface only; Rerun's own `serve_*` functions bind all interfaces and are not used.
"""

from __future__ import annotations

import logging
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from behaviours.board import slug
from hardware.interface import Array
from skills.estimate.graph import ConnectivityGraph
from skills.tracking.tracks import TrackedGoal
from supervisor.exposing import is_exposing, some_paths
from supervisor.history import is_guard
from supervisor.palette import EDGE, GOAL, GRASP, STATUS, rgb
from supervisor.snapshot import NodeState, TickSnapshot
from supervisor.tree_layout import tidy

APPLICATION = "dissection"
RRD_FILE = "session.rrd"
LOOPBACK = "127.0.0.1"
PORT = 9876
TIMELINE = "bench"
JPEG_QUALITY = 85
ROW, COLUMN = 46.0, 130.0  # between nodes of the graph, in its own units
EDGES_STALE = 4.0  # [px] by which the goal may move before the edges of an estimate no longer fit the image
TOOL_AXIS = 0.012  # [m], length of the arrow along the shaft
EXPECTED, PLAN = (111, 95, 168), (255, 211, 63)

log = logging.getLogger(__name__)


class RerunView:
    """Logs to `session.rrd` in `folder` and, if `serve`, to viewers on this machine. Only what changed is logged.

    Raises:
        OSError: the file cannot be made or the port is taken.
    """

    def __init__(self, folder: Path, serve: bool = False, port: int = PORT) -> None:
        self._stream = rr.RecordingStream(APPLICATION)
        # Wall times would differ from run to run, and they say nothing: bench time is the session's clock.
        self._stream.set_log_time_enabled(False)
        self._uri: str | None = None
        sinks: list[rr.FileSink | rr.GrpcServerSink] = [rr.FileSink(str(folder / RRD_FILE))]
        if serve:
            server = rr.GrpcServerSink(bind_ip=LOOPBACK, port=port)
            self._uri = f"rerun+http://{LOOPBACK}:{port}/proxy"
            sinks.append(server)
        self._stream.set_sinks(*sinks, default_blueprint=blueprint())
        self._statuses: dict[str, str] = {}
        self._lanes: dict[str, str] = {}
        self._structure: tuple[str, ...] = ()
        self._frame = -1
        self._estimated_goal: Array | None = None
        self._graph: ConnectivityGraph | None = None
        self._tracked: TrackedGoal | None = None
        self._triangles: NDArray[np.int32] | None = None
        self._sides = np.zeros((0, 2), dtype=np.int32)
        self._exposing = False
        self._open = True
        self._describe_series()

    @property
    def how_to_open(self) -> str:
        """Say in a few lines how a person sees this view, now or later; nothing is sent anywhere by this view itself."""
        if self._uri is None:
            return f"rerun {RRD_FILE}"
        page = f"rerun --serve-web --bind {LOOPBACK} {self._uri}"
        return f"In a window:  rerun {self._uri}\nIn a browser: {page}\nOnce, against usage statistics: rerun analytics disable"

    def update(self, snapshot: TickSnapshot) -> None:
        """Log this tick."""
        if not self._open:
            return
        stream = self._stream
        stream.set_time("tick", sequence=snapshot.tick)
        stream.set_time(TIMELINE, duration=snapshot.stamp)
        self._tree(snapshot.nodes)
        stream.log("signals/tension", rr.Scalars([snapshot.tension]))
        stream.log("signals/strain", rr.Scalars([snapshot.strain]))
        if snapshot.attachments is not None:
            stream.log("signals/attachments", rr.Scalars([float(snapshot.attachments)]))
        self._image(snapshot)
        self._tools(snapshot)
        self._exposure(snapshot)
        for d in snapshot.decisions:
            if not d.accepted:
                stream.log("log/gate", rr.TextLog(f"{d.arm} {d.command} ({d.code}): {d.message}", level=rr.TextLogLevel.WARN))
        for text in snapshot.log:
            stream.log("log/session", rr.TextLog(text, level=rr.TextLogLevel.INFO))

    def mesh(self, vertices: NDArray[np.floating], triangles: NDArray[np.integer]) -> None:
        """Log the tissue's surface at the last tick's time: `vertices` (V, 3) [m], left camera frame; `triangles` (T, 3)."""
        if self._open:
            surface = rr.Mesh3D(vertex_positions=vertices, triangle_indices=triangles, albedo_factor=(206, 132, 118))
            self._stream.log("bench/tissue", surface)

    def close(self) -> None:
        """Finish the file and end the server."""
        if self._open:
            self._open = False
            self._stream.flush()
            self._stream.disconnect()

    def _tree(self, nodes: tuple[NodeState, ...]) -> None:
        """State lanes in tree order, and the graph, whenever a status changed."""
        paths = tuple(node.path for node in nodes)
        if paths != self._structure:
            self._structure = paths
            self._new_structure(nodes)
        news = False
        for node in nodes:
            if self._statuses.get(node.path) == node.status:
                continue
            self._statuses[node.path] = node.status
            news = True
            # A node at rest is a gap in its lane.
            change = rr.StateChange.cleared() if node.status == "INVALID" else rr.StateChange(state=node.status)
            self._stream.log(self._lanes[node.path], change)
            if node.status == "FAILURE" or (is_guard(node.path) and node.status == "RUNNING"):
                self._stream.log("log/tree", rr.TextLog(f"{node.name}: {node.message}", level=rr.TextLogLevel.WARN))
        if news:
            places = tidy(nodes)
            self._stream.log(
                "tree",
                rr.GraphNodes(
                    node_ids=list(paths),
                    positions=[(COLUMN * places[p][0], ROW * places[p][1]) for p in paths],
                    labels=[node.name for node in nodes],
                    colors=[rgb(STATUS.get(node.status, "#9aa0a6")) for node in nodes],
                ),
            )

    def _new_structure(self, nodes: tuple[NodeState, ...]) -> None:
        """Lanes are sorted by their path, so a running number keeps them in tree order."""
        self._lanes = {node.path: f"states/{k:03d}_{slug(node.name)}" for k, node in enumerate(nodes)}
        shown = ["RUNNING", "SUCCESS", "FAILURE"]
        look = rr.StateConfiguration(values=shown, labels=[s.lower() for s in shown], colors=[rgb(STATUS[s]) for s in shown])
        for lane in self._lanes.values():
            self._stream.log(lane, look, static=True)
        edges = [(node.path.rpartition("/")[0], node.path) for node in nodes if "/" in node.path]
        self._stream.log("tree", rr.GraphEdges(edges, graph_type="directed"), static=True)
        self._statuses = {}
        self._stream.send_blueprint(blueprint(len(nodes), 1 + max(node.depth for node in nodes)))

    def _image(self, snapshot: TickSnapshot) -> None:
        """Endoscope image, tracked goal and grasp, edges of the newest estimate as long as the tissue stays where it was."""
        stream, frame, tracked, graph = self._stream, snapshot.frame, snapshot.tracked, snapshot.graph
        then = self._estimated_goal
        if then is not None and tracked is not None and float(np.median(np.abs(tracked.polyline - then))) > EDGES_STALE:
            self._estimated_goal = None
            stream.log("endoscope/edges", rr.Clear(recursive=False))
        if frame is not None and frame.sequence != self._frame:
            self._frame = frame.sequence
            bgr = cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR)
            _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            stream.log("endoscope", rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg"))
        if tracked is not None and tracked is not self._tracked:
            self._tracked = tracked
            stream.log("endoscope/goal", rr.LineStrips2D([tracked.polyline], colors=[rgb(GOAL)], radii=1.5, draw_order=20.0))
            stream.log("endoscope/grasp", rr.Points2D([tracked.grasp], colors=[rgb(GRASP)], radii=5.0, draw_order=21.0))
        if graph is not None and graph is not self._graph:
            ends = graph.points[graph.edges]
            known = np.isfinite(ends).all(axis=(1, 2))
            strips = rr.LineStrips2D(
                list(ends[known]),
                colors=[rgb(EDGE[int(state)]) for state in graph.state[known]],
                radii=np.where(graph.crosses_goal[known], 1.6, 0.5),
                draw_order=10.0,
            )
            stream.log("endoscope/edges", strips)
            self._estimated_goal = None if self._tracked is None else self._tracked.polyline
            stream.log("log/session", rr.TextLog(f"estimate: {graph.message}", level=rr.TextLogLevel.INFO))
        self._graph = graph

    def _tools(self, snapshot: TickSnapshot) -> None:
        """Tool tips as points, shafts as arrows that end at the tip."""
        for name, pose in snapshot.tools.items():
            if pose.is_finite():
                along = pose.rotation()[:, 2] * TOOL_AXIS
                tip = rr.Points3D([pose.position], radii=0.0012, labels=[name], colors=[(90, 96, 104)])
                shaft = rr.Arrows3D(origins=[pose.position - along], vectors=[along], radii=0.0006, colors=[(90, 96, 104)])
                self._stream.log(f"bench/{name}", tip)
                self._stream.log(f"bench/{name}/shaft", shaft)

    def _exposure(self, snapshot: TickSnapshot) -> None:
        """What the exposure controller expects, as long as it pulls: mesh as a wire frame, sampled paths thin, the plan thick."""
        stream, view = self._stream, snapshot.exposure
        if view is not None:
            self._exposing = True
            if view.triangles is not self._triangles:
                self._triangles = view.triangles
                sides = np.sort(view.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
                self._sides = np.unique(sides, axis=0)
            thin, thick = rr.Radius.ui_points(0.5), rr.Radius.ui_points(3.0)
            wires = rr.LineStrips3D(list(view.vertices[self._sides]), colors=[(*EXPECTED, 110)], radii=thin)
            stream.log("bench/exposure/expected", wires)
            stream.log("bench/exposure/paths", rr.LineStrips3D(list(some_paths(view)), colors=[(*rgb(GRASP), 160)], radii=thin))
            stream.log("bench/exposure/plan", rr.LineStrips3D([view.plan], colors=[PLAN], radii=thick))
            for name, value in (
                ("tension/expected", view.tension),
                ("losses/camera", view.camera),
                ("losses/deform", view.deform),
                ("opening", view.opening),
                ("separation", view.separation),
            ):
                stream.log(f"signals/{name}", rr.Scalars([value]))
        if self._exposing and not is_exposing(snapshot.nodes):
            self._exposing = False
            stream.log("bench/exposure", rr.Clear(recursive=True))

    def _describe_series(self) -> None:
        for name, colour in (
            ("tension", (200, 55, 45)),
            ("strain", (58, 134, 212)),
            ("attachments", (201, 138, 27)),
            ("tension/expected", EXPECTED),
            ("losses/camera", EXPECTED),
            ("losses/deform", (60, 157, 139)),
            ("opening", EXPECTED),
            ("separation", EXPECTED),
        ):
            self._stream.log(f"signals/{name}", rr.SeriesLines(colors=[colour], names=[name]), static=True)
        # x right, y down, z forward: the left camera's frame.
        self._stream.log("bench", rr.ViewCoordinates.RDF, static=True)


def blueprint(rows: int = 40, columns: int = 6) -> rrb.Blueprint:
    """Lay the view out: image and 3D beside the tree of `rows` x `columns`, states and signals below, log last."""
    graph_bounds = rrb.VisualBounds2D(x_range=(-COLUMN, (columns + 0.5) * COLUMN), y_range=(-ROW, rows * ROW))
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial2DView(origin="endoscope", name="endoscope"),
                rrb.Spatial3DView(origin="bench", name="bench"),
                rrb.GraphView(origin="tree", name="tree", visual_bounds=graph_bounds),
                column_shares=[4, 3, 3],
            ),
            rrb.Horizontal(
                rrb.StateTimelineView(origin="states", name="states"),
                rrb.Vertical(
                    rrb.TimeSeriesView(origin="signals/tension", name="tension [N]"),
                    rrb.TimeSeriesView(origin="signals/strain", name="strain"),
                    rrb.TextLogView(origin="log", name="gate and log"),
                ),
                rrb.Vertical(
                    rrb.TimeSeriesView(origin="signals/opening", name="expected opening [px²]"),
                    rrb.TimeSeriesView(origin="signals/losses", name="losses a pixel"),
                    rrb.TimeSeriesView(origin="signals/separation", name="severed from connected [SD]"),
                ),
                column_shares=[3, 2, 2],
            ),
            row_shares=[5, 4],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )
