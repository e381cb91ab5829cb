"""The bench as a whole: arms reach the tissue, frames come when asked for, faults can be commanded."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.codes import InputError
from hardware.interface import CUTTER, GRASPER, OperatingState, Pose
from hardware.stub.bench import STEP, StubBench
from hardware.stub.scene import load_scene
from hardware.stub.truth import measure


@pytest.fixture
def bench() -> StubBench:
    scene = load_scene("silicone")
    tissue = replace(scene.tissue, fine_spacing=1.5e-3, coarse_spacing=4e-3, puncture_variation=0.0)
    bench = StubBench(replace(scene, tissue=tissue, arms=replace(scene.arms, bias=0.0)), 0)
    for command in ("enable", "home"):
        for arm in bench.arms.values():
            arm.state_command(command)
        bench.advance(1.0)
    return bench


def pose_at(bench: StubBench, x: float, y: float, below: float) -> Pose:
    """Tool straight down at table x, y, its tip `below` the mid-surface at rest; jaws open along the goal."""
    rest = bench.phantom.mesh.rest
    height = bench.phantom.positions[np.argmin(np.linalg.norm(rest - [x, y], axis=1)), 2]
    rotation, _ = bench.scene.camera_from_table()
    position = bench.to_camera(np.array([[x, y, height - below]]))[0]
    return Pose.looking(position, rotation @ np.array([0.0, 0.0, -1.0]), rotation @ np.array([1.0, 0.0, 0.0]))


def go(bench: StubBench, arm: str, pose: Pose) -> None:
    bench.arms[arm].move_cp(pose)
    bench.advance(4.0)


def test_the_grasper_catches_tissue_and_feels_it(bench):
    pose = pose_at(bench, 0.0, 0.009, 0.3e-3)
    bench.arms[GRASPER].move_jaw(0.9)
    go(bench, GRASPER, pose)
    bench.arms[GRASPER].move_jaw(0.0)
    bench.advance(1.0)
    go(bench, GRASPER, pose.moved(np.array([0.0, 0.0, -5e-3])))

    assert bench.phantom.grip is not None
    assert np.linalg.norm(bench.arms[GRASPER].measured_cf().value) > 0.15


def test_closing_above_the_tissue_catches_nothing(bench):
    bench.arms[GRASPER].move_jaw(0.9)
    go(bench, GRASPER, pose_at(bench, 0.0, 0.009, -8e-3))
    bench.arms[GRASPER].move_jaw(0.0)
    bench.advance(1.0)

    assert bench.phantom.grip is None


def test_opening_the_grasper_lets_the_tissue_go(bench):
    bench.arms[GRASPER].move_jaw(0.9)
    go(bench, GRASPER, pose_at(bench, 0.0, 0.009, 0.3e-3))
    for angle in (0.0, 0.9):
        bench.arms[GRASPER].move_jaw(angle)
        bench.advance(1.0)

    assert bench.phantom.grip is None


def test_closing_the_scissors_in_the_tissue_cuts_it_there(bench):
    bench.arms[CUTTER].move_jaw(0.8)
    go(bench, CUTTER, pose_at(bench, 0.005, 0.0, 2.5e-3))
    bench.arms[CUTTER].move_jaw(0.0)
    bench.advance(1.0)

    cut = measure(bench.phantom)
    assert cut.effective_cut_ratio == pytest.approx(0.11, abs=0.05)
    middle = np.mean([edge.a for edge in bench.phantom.mesh.cut_edges], axis=0)
    assert np.linalg.norm(middle - [0.005, 0.0]) < 1.5e-3


def test_closing_the_scissors_in_the_air_cuts_nothing(bench):
    bench.arms[CUTTER].move_jaw(0.8)
    bench.advance(1.0)
    bench.arms[CUTTER].move_jaw(0.0)
    bench.advance(1.0)

    assert bench.phantom.mesh.cut_edges == []


def test_a_frame_is_drawn_once_and_a_new_one_comes_every_thirtieth_second(bench):
    first = bench.endoscope.left()
    assert bench.endoscope.left().image is first.image
    bench.advance(STEP * 4)

    assert bench.endoscope.left().sequence == first.sequence + 1


def test_the_pair_is_of_one_instant(bench):
    pair = bench.endoscope.stereo()

    assert pair.left.image.shape == pair.right.shape == (480, 640, 3)
    assert pair.left.stamp == bench.endoscope.stamp()


def test_a_stale_endoscope_gives_no_new_frames_until_it_is_cleared(bench):
    bench.inject("endoscope", "stale")
    stamp = bench.endoscope.stamp()
    bench.advance(0.5)
    assert bench.endoscope.stamp() == stamp

    bench.inject("endoscope", "clear")
    assert bench.endoscope.stamp() > stamp


def test_the_emergency_stop_takes_the_power_away_and_keeps_the_grasp(bench):
    bench.arms[GRASPER].move_jaw(0.9)
    go(bench, GRASPER, pose_at(bench, 0.0, 0.009, 0.3e-3))
    bench.arms[GRASPER].move_jaw(0.0)
    bench.advance(1.0)

    bench.press_emergency_stop()
    bench.advance(1.0)

    assert bench.emergency_stop()
    assert all(arm.operating_state().state is OperatingState.DISABLED for arm in bench.arms.values())
    assert bench.phantom.grip is not None


@pytest.mark.parametrize(("target", "fault"), [("PSM9", "fault"), ("endoscope", "melts"), (CUTTER, "melts")])
def test_an_unknown_fault_is_refused(bench, target, fault):
    with pytest.raises(InputError):
        bench.inject(target, fault)


def test_one_seed_gives_one_bench_to_the_bit():
    def run() -> bytes:
        bench = StubBench(load_scene("silicone"), 7)
        bench.advance(0.2)
        return bench.endoscope.left().image.tobytes() + bench.arms[CUTTER].measured_cf().value.tobytes()

    assert run() == run()


def test_another_seed_gives_another_calibration_error():
    offsets = []
    for seed in (0, 1):
        arm = StubBench(load_scene("silicone"), seed).arms[CUTTER]
        offsets.append(arm.true_pose().position - arm.setpoint_cp().position)

    assert np.linalg.norm(offsets[0] - offsets[1]) > 1e-4
