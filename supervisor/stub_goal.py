"""The goal that an expert would draw on a stub scene, when the user gives none."""

from hardware.stub.bench import StubBench
from skills.scene.goal import Goal


def drawn_goal(bench: StubBench) -> Goal:
    """The scene's own goal as pixels of the first image."""
    polyline, grasp = bench.drawn_goal()
    camera = bench.endoscope.camera
    return Goal(polyline, grasp, (camera.width, camera.height))
