"""Traps of reference 7, by number, that are about the driver as a whole; those of one part are numbered in its own tests."""

from pathlib import Path

import numpy as np
import pytest

from hardware.codes import Code, InputError
from hardware.dvrk.local import LocalTransport
from hardware.dvrk.messages import Joy, PoseStamped
from hardware.interface import CUTTER, GRASPER, Pose
from tests.mocks.robot import Rig


@pytest.mark.parametrize("command", ["servo_cp", "hold", "state_command", "trajectory_j/set_ratio", "jaw/move_jp"])
def test_1_a_session_does_not_begin_before_each_command_has_a_listener(tmp_path: Path, command: str):
    rig = Rig(tmp_path, opened=False)
    rig.graph.listeners[f"/PSM1/{command}"] = [
        one for one in rig.graph.listeners[f"/PSM1/{command}"] if one.callback.__self__ is not rig.robot.arms["PSM1"]
    ]

    with pytest.raises(InputError, match=rf"/PSM1/{command} \(nobody listens\)"):
        rig.bench.open()


def test_4_no_motion_waits_behind_a_slow_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    queues: dict[str, int] = {}
    make = LocalTransport.publisher

    def noting(self: LocalTransport, topic: str, kind: type, latched: bool = False, queue: int = 1):
        if self._name == "driver":
            queues[topic] = queue
        return make(self, topic, kind, latched, queue)

    monkeypatch.setattr(LocalTransport, "publisher", noting)

    Rig(tmp_path)

    for arm in ("PSM1", "PSM2"):
        assert queues[f"/{arm}/servo_cp"] <= 1 and queues[f"/{arm}/jaw/move_jp"] <= 1 and queues[f"/{arm}/hold"] <= 1


def test_4_quaternions_that_are_sent_keep_their_sign_whatever_that_of_the_goal(tmp_path: Path):
    rig = Rig(tmp_path)
    arm = rig.bench.arms[CUTTER]
    start = arm.measured_cp().value
    turned = Pose.from_matrix(start.rotation() @ _about_z(0.4), start.position + np.array([4e-3, 0.0, 0.0]))

    for goal in (Pose(turned.position, -turned.quaternion), start):
        handle = arm.move_cp(goal)
        rig.bench.advance(5.0)
        assert handle.report().status == "done", handle.report()

    sent = np.array([one.quaternion for name, one in rig.robot.arms[CUTTER].heard if name == "servo_cp"])
    assert len(sent) > 50
    assert (np.sum(sent[1:] * sent[:-1], axis=1) > 0.99).all()


def test_7_the_robots_own_moves_of_the_arm_which_would_take_the_jaw_along_are_never_asked_for(tmp_path: Path):
    rig = Rig(tmp_path)
    heard: list[str] = []
    for name in ("move_cp", "move_jp", "move_jr", "servo_jp", "servo_jr", "jaw/servo_jp"):
        rig.graph.node("ear").subscribe(f"/PSM1/{name}", PoseStamped, lambda *_, name=name: heard.append(name))
    arm, start = rig.bench.arms[GRASPER], rig.bench.arms[GRASPER].measured_cp().value

    arm.move_jaw(0.1)
    rig.bench.advance(2.0)
    arm.move_cp(start.moved(np.array([3e-3, 0.0, 0.0])))
    rig.bench.advance(2.0)

    commands = [name for name, _ in rig.robot.arms[GRASPER].heard]
    assert heard == [] and {"servo_cp", "jaw/move_jp"} <= set(commands)
    jaw_sent = [value for name, value in rig.robot.arms[GRASPER].heard if name == "jaw/move_jp"]
    assert rig.robot.arms[GRASPER].jaw_setpoint == pytest.approx(jaw_sent[-1])


def test_7_a_jaw_that_is_taken_back_to_an_old_goal_while_the_arm_moves_ends_the_session(tmp_path: Path):
    rig = Rig(tmp_path)
    arm, scripted = rig.bench.arms[GRASPER], rig.robot.arms[GRASPER]
    arm.move_jaw(0.0)
    rig.bench.advance(2.0)

    handle = arm.move_cp(arm.measured_cp().value.moved(np.array([8e-3, 0.0, 0.0])))
    rig.bench.advance(0.2)
    holds = scripted.count_of("hold")
    scripted.jaw_setpoint = scripted.jaw_goal = 0.6
    rig.bench.advance(0.1)

    guard = arm.operating_state().guard
    assert (guard.code, guard.latched) == (Code.FOREIGN_MOTION, True)
    assert handle.report().status == "failed" and scripted.count_of("hold") > holds


@pytest.mark.parametrize("name", ["arm_clutch", "io/manip_clutch", "manip_clutch", "io/suj_clutch"])
def test_11_a_clutch_is_heard_by_each_name_that_it_ever_had(tmp_path: Path, name: str):
    rig = Rig(tmp_path)
    clutch = rig.graph.node("io").publisher(f"/PSM2/{name}", Joy)

    clutch.publish(Joy(2.0, (1,)))
    rig.bench.advance(0.1)
    pressed = rig.bench.arms[CUTTER].operating_state().guard
    clutch.publish(Joy(3.0, (0,)))
    rig.bench.advance(1.5)

    assert pressed.code is Code.ARM_NOT_READY and "clutch" in pressed.message
    assert rig.bench.arms[CUTTER].operating_state().guard.ok


def test_13_a_robot_that_tells_no_operating_state_gets_no_session(tmp_path: Path):
    rig = Rig(tmp_path, opened=False)
    rig.graph.offers["/PSM1/operating_state"].clear()

    with pytest.raises(InputError, match="/PSM1/operating_state"):
        rig.bench.open()


def _about_z(angle: float) -> np.ndarray:
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
