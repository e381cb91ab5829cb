"""The two straight pulls: the paper's naive one, from the goal's middle towards the grasp, and one along the goal's own normal."""

from concurrent.futures import Executor
from enum import StrEnum

import numpy as np

from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import GRASPER, Array, CameraModel
from skills.estimate.grid import Grid
from skills.expose.outcome import ExposeOutcome, Forecast
from skills.expose.pull import Stop
from skills.grasp import Grasped
from skills.scene.stereo import DepthMap, StereoConfig, depth_at, depth_from_stereo, region_around
from skills.skill import Progress, Steps, computed
from skills.tracking.tracks import TrackedGoal

LEAST_POINTS = 3  # of known depth on a row


class Direction(StrEnum):
    """Which way a straight pull goes."""

    NAIVE = "naive"  # paper, Evaluation of Exposure Maximization Control: from the goal's midpoint to the grasping point
    GOAL_NORMAL = "goal-normal"  # across the goal in the tissue's tangent plane, to the grasp's side


class SteeringStraight:
    """Looks once, then always the same step of `length` [m]."""

    turns = False

    def __init__(self, direction: Direction, length: float, stereo: StereoConfig, executor: Executor) -> None:
        self._direction = direction
        self._length = length
        self._stereo = stereo
        self._executor = executor
        self._step = np.zeros(3)

    def begin(self, lease: Lease, goal: TrackedGoal, grid: Grid, grasped: Grasped) -> Steps[Stop | None]:
        """Measure the depth of both sides of the goal."""
        yield Progress("looking")
        camera = lease.endoscope.camera
        rows = np.vstack([goal.near[goal.visible], goal.far[goal.visible]])
        region = region_around(rows, 70.0, (camera.width, camera.height))
        stereo = lease.endoscope.stereo()
        depth = yield from computed(self._executor, "measuring depth", depth_from_stereo, stereo, camera, self._stereo, region)
        vector = (
            away_from_middle(goal, depth, camera, lease.measured_cp(GRASPER).value.position)
            if self._direction is Direction.NAIVE
            else goal_normal(goal, depth, camera)
        )
        if vector is None:
            return Stop(Code.DEPTH_INVALID, "the depth of the goal cannot be seen", Code.DEPTH_INVALID)
        self._step = self._length * vector
        return None

    def step(self, lease: Lease, here: Array, number: int) -> Steps[Array | Stop]:
        """The same step again."""
        yield from ()
        return self._step

    def forecast(self) -> Forecast | None:
        """Nothing is expected."""
        return None

    def report(self, outcome: ExposeOutcome) -> ExposeOutcome:
        """Nothing to add."""
        return outcome


def away_from_middle(goal: TrackedGoal, depth: DepthMap, camera: CameraModel, grasp: Array) -> Array | None:
    """Unit vector (3,) from the goal's midpoint to the `grasp` (3,) [m]; None if the middle's depth is unknown."""
    third = len(goal.polyline) // 3
    middle = np.vstack([goal.near[third:-third], goal.far[third:-third]])
    points = _lifted(middle, depth, camera)
    if len(points) < LEAST_POINTS:
        return None
    vector = grasp - np.median(points, axis=0)
    return np.asarray(vector / np.linalg.norm(vector))


def goal_normal(goal: TrackedGoal, depth: DepthMap, camera: CameraModel) -> Array | None:
    """Unit vector (3,) in the tissue, across the goal's chord, towards the grasp's side.

    From station to station across the goal: a plane through both rows would be turned by a curved tissue or a tool before one of them.
    """
    near, far = (camera.unproject(row, depth_at(depth, row, 5)) for row in (goal.near, goal.far))
    known = np.isfinite(near).all(axis=1) & np.isfinite(far).all(axis=1)
    if known.sum() < LEAST_POINTS:
        return None
    near, far = near[known], far[known]
    chord = near[-1] + far[-1] - near[0] - far[0]
    chord = chord / np.linalg.norm(chord)
    across = np.median(near - far, axis=0)
    across = across - chord * (across @ chord)
    return np.asarray(across / np.linalg.norm(across))


def _lifted(pixels: Array, depth: DepthMap, camera: CameraModel) -> Array:
    """Points (N, 3) [m] of those pixels whose depth is known."""
    points = camera.unproject(pixels, depth_at(depth, pixels, 5))
    return np.asarray(points[np.isfinite(points).all(axis=1)])
