"""The served bench as a whole: in step with the stub, repeatable, and safe to be commanded from within a callback."""

import time
from dataclasses import replace

import numpy as np
import pytest

from hardware.codes import InputError
from hardware.dvrk import messages as m
from hardware.dvrk.local import LocalGraph
from hardware.served.impostor import Impostor
from hardware.served.node import ServedBench
from hardware.served.site import bases, write_site
from hardware.stub.bench import StubBench
from tests.hardware.served.conftest import scene


@pytest.mark.parametrize("duration", [0.001, 1 / 120, 0.01, 1 / 30, 0.1, 0.25])
def test_the_physics_steps_exactly_as_often_as_the_stubs_own(rig, duration):
    alone = StubBench(scene(), 0)
    alone.advance(duration)
    steps = []
    rig.bench.observe(lambda: steps.append(1))
    rig.go(duration)

    assert rig.bench.now() == alone.now()
    assert len(steps) == round(alone.now() * 120)


def test_the_same_commands_give_the_same_messages(make_rig):
    def story(rig):
        rig.ready()
        rig.joints("PSM1", "move_jp", [0.05, 0, 0.13, 0.2, 0, 0])
        rig.joints("PSM2", "jaw/move_jp", 0.1)
        rig.go(1.0)
        return rig

    first, second = story(make_rig()), story(make_rig())

    assert first.heard.keys() == second.heard.keys()
    for topic, heard in first.heard.items():
        assert [str(message) for message in heard] == [str(message) for message in second.heard[topic]]


def test_a_command_from_within_a_callback_is_obeyed_after_what_was_being_said(robot):
    heard = []

    def react(message, received):
        heard.append(message.is_busy)
        if message.is_busy:
            robot.send("/PSM1/hold", m.Empty())

    robot.client.subscribe("/PSM1/operating_state", m.OperatingState, react)
    robot.joints("PSM1", "move_jp", [0.2, 0, 0.14, 0, 0, 0])
    robot.go(0.5)

    assert heard == [False, True, False]  # the first is the latched one
    assert abs(robot.newest("/PSM1/setpoint_js").position[0]) < 1e-3


def test_a_master_that_is_gone_stops_the_messages_and_not_the_robot(robot):
    robot.joints("PSM1", "move_jp", [0.05, 0, 0.13, 0, 0, 0])
    robot.graph.up = False
    start = robot.go(2.0)

    assert robot.since("/PSM1/measured_cp", start + 1e-6) == []
    np.testing.assert_allclose(robot.served.arms["PSM1"].motion.setpoint[:3], [0.05, 0, 0.13], atol=1e-12)


def test_a_master_that_comes_back_hears_the_robot_again(robot):
    robot.graph.up = False
    robot.go(0.2)
    robot.graph.up = True
    start = robot.go(0.2)

    assert len(robot.since("/PSM1/measured_cp", start)) >= 20


def test_another_publisher_can_tell_lies_beside_the_robot(robot):
    impostor = Impostor(robot.graph.node("impostor"), robot.config, "PSM1")
    robot.go(0.02)
    impostor.report()

    assert robot.newest("/PSM1/measured_cp").frame_id == "elsewhere"
    assert robot.client.publishers_of("/PSM1/measured_cp") == ("dvrk", "impostor")


def test_another_source_of_commands_moves_the_arm(robot):
    impostor = Impostor(robot.graph.node("impostor"), robot.config, "PSM1")
    robot.go(0.02)
    before = robot.newest("/PSM1/setpoint_cp").position
    for _ in range(10):
        assert impostor.command()
        robot.go(0.02)

    np.testing.assert_allclose(robot.newest("/PSM1/setpoint_cp").position - before, [5e-3, 0, 0], atol=1e-6)


def test_an_impostor_does_not_command_an_arm_whose_pose_it_does_not_know(rig):
    impostor = Impostor(rig.graph.node("impostor"), rig.config, "PSM1")
    rig.go(0.05)

    assert not impostor.command()


def test_the_stubs_own_faults_show_on_the_graph(robot):
    robot.bench.inject("PSM1", "stale")
    robot.go(0.5)
    stamp = robot.newest("/PSM1/measured_js").stamp
    robot.bench.inject("PSM2", "fault")
    robot.go(0.05)

    assert 0.45 < robot.client.stamp() - stamp < 0.6
    assert robot.state("PSM2").state == "FAULT"


def test_everything_can_lie_below_a_namespace(tmp_path):
    bench = StubBench(scene(), 0)
    config = write_site(bench, tmp_path, prefix="/dvrk")
    graph = LocalGraph(bench.now)
    ServedBench(bench, graph.node("dvrk"), config)

    assert all(topic.startswith("/dvrk/") for topic in (*graph.offers, *graph.listeners, *graph.services))


def test_closing_holds_the_arms(robot):
    robot.joints("PSM1", "move_jp", [0.2, 0, 0.14, 0, 0, 0])
    robot.go(0.2)
    start = robot.bench.now()
    robot.served.close()

    assert not robot.served.arms["PSM1"].motion.moving
    assert [message.data for message in robot.since("/PSM1/goal_reached", start)] == [False] or robot.state("PSM1").is_busy


def test_the_site_lies_within_the_reach_of_both_arms(tmp_path):
    """Both tool frames: the homing posture is the waiting pose, and the remote centre is where a patient's skin might be."""
    bench = StubBench(scene(), 0)
    config = write_site(bench, tmp_path)

    for frames in bases(bench, config).values():
        assert 0.08 < np.linalg.norm(frames.camera_from_base[:3, 3]) < 0.3


def test_a_site_needs_a_name_for_its_namespace(tmp_path):
    with pytest.raises(InputError, match="prefix"):
        write_site(StubBench(replace(scene()), 0), tmp_path, prefix="no slash")


def test_publishing_costs_a_fraction_of_the_time_that_it_lasts(robot):
    """All topics heard, both arms moving, on one core; generous, for a machine that does other work too."""
    for arm in ("PSM1", "PSM2"):
        robot.joints(arm, "move_jp", [0.1, 0.05, 0.14, 1.0, 0.4, -0.3])
    began = time.process_time()
    robot.go(1.0)

    assert time.process_time() - began < 1.0


def test_the_second_arm_holds_the_instrument_that_is_asked_for(tmp_path):
    config = write_site(StubBench(scene(), 0), tmp_path, cutter="CURVED_SCISSORS:400178")

    assert config.cutter.instrument.jaw_upper > 1.3
    with pytest.raises(InputError, match="HAMMER:1"):
        write_site(StubBench(scene(), 0), tmp_path, cutter="HAMMER:1")
