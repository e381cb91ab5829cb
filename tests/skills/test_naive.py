"""The naive exposure moves nothing that it should not, and says why it ends."""

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import CUTTER, GRASPER
from skills.expose.naive import ExposureNaive, NaiveConfig
from skills.grasp import Grasped
from skills.scene.stereo import StereoConfig
from skills.skill import ImmediateExecutor
from tests.mocks.table import Table
from tests.skills.test_planning import goal


def taken():
    """A reference image at once."""
    yield from ()
    return True


def finish(table: Table, tracked, grasped):
    park = table.lease.setpoint_cp(CUTTER)
    skill = ExposureNaive(NaiveConfig(), StereoConfig(), ImmediateExecutor())
    steps = skill.run(table.lease, tracked, grasped, park, taken)
    return table.finish(steps)


def test_without_a_grasp_nothing_is_pulled():
    table = Table()

    outcome = finish(table, goal, None)

    assert outcome.code is Code.GRASP_EMPTY
    assert table.bench.motions() == []


@pytest.mark.parametrize(
    ("seen", "code"), [(None, Code.GOAL_LOST), (goal(lost=True), Code.GOAL_LOST), (goal(), Code.DEPTH_INVALID)]
)
def test_what_cannot_be_seen_is_not_pulled(seen, code):
    table = Table()
    grasped = Grasped(table.lease.setpoint_cp(GRASPER), np.array([0.0, 0.0, -1.0]))

    outcome = finish(table, lambda: seen, grasped)

    assert outcome.code is code
    assert table.bench.motions(GRASPER) == []
    assert table.bench.holding()


def test_a_stretched_grasp_is_relaxed_before_the_reference():
    table = Table()
    here = table.lease.setpoint_cp(GRASPER)
    grasped = Grasped(here.moved(np.array([0.0, 0.010, 0.0])), np.array([0.0, 0.0, -1.0]))

    finish(table, goal, grasped)

    left = np.linalg.norm(table.lease.setpoint_cp(GRASPER).position - grasped.origin.position)
    assert left == pytest.approx(NaiveConfig().relaxed, abs=1e-4)
