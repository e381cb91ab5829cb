"""The console, the endoscope's arm and the set-up joints (reference 1.5), as far as a client looks at them."""

import numpy as np
import pytest

from hardware.dvrk import messages as m


@pytest.fixture
def room(rig):
    for topic in ("operator_present", "clutch", "camera"):
        rig.listen(f"/console/{topic}", m.Joy)
    for topic in ("console/teleop/enabled", "MTMR_PSM1/following", "MTML_PSM2/following"):
        rig.listen(f"/{topic}", m.Bool)
    for body in ("ECM", "SUJ/PSM1", "SUJ/PSM2"):
        rig.listen(f"/{body}/local/measured_cp", m.PoseStamped)
    return rig


def test_a_quiet_room_is_told_to_whoever_comes(room):
    assert room.newest("/console/operator_present").buttons == (1,)
    assert room.newest("/console/clutch").buttons == (0,)
    assert room.newest("/console/teleop/enabled").data is False
    assert room.newest("/MTMR_PSM1/following").data is False


def test_the_console_speaks_on_changes_alone(room):
    start = room.go(0.5)

    assert room.since("/console/operator_present", start + 1e-6) == []


def test_operator_and_pedals_can_be_emulated(room):
    room.send("/console/emulate_operator_present", m.Joy(0.0, (0,)))
    room.send("/console/emulate_clutch", m.Joy(0.0, (1,)))

    assert room.newest("/console/operator_present").buttons == (0,)
    assert room.newest("/console/clutch").buttons == (1,)


def test_teleoperation_can_be_switched_on(room):
    room.send("/console/teleop/enable", m.Bool(True))

    assert room.newest("/console/teleop/enabled").data is True


def test_endoscope_and_set_up_joints_stand_still(room):
    start = room.go(0.5)

    for body in ("ECM", "SUJ/PSM1", "SUJ/PSM2"):
        poses = room.since(f"/{body}/local/measured_cp", start + 1e-6)
        assert len(poses) == 50
        assert np.ptp([pose.position for pose in poses], axis=0).max() == 0.0
