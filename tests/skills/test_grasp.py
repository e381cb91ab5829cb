"""Taking tissue: caught tissue stays in the jaws where the test pull left them; empty jaws get out of the way."""

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import GRASPER, MoveStatus
from skills.grasp import GraspConfig, take
from tests.mocks.table import Table

POINT, NORMAL, AWAY = np.array([0.0, 0.0, 0.08]), np.array([0.0, 0.0, -1.0]), np.array([0.0, -1.0, 0.0])


@pytest.mark.parametrize(("tension", "caught"), [(0.3, True), (0.0, False), (float("nan"), False)])
def test_empty_jaws_back_off_and_caught_tissue_is_held(tension, caught, monkeypatch):
    table, config = Table(), GraspConfig()
    monkeypatch.setattr(type(table.lease), "tension", lambda self: tension)

    report, grasped = table.finish(take(table.lease, POINT, NORMAL, AWAY, config))

    above = float((table.lease.setpoint_cp(GRASPER).position - POINT) @ NORMAL)
    assert (grasped is not None) is caught
    if caught:
        assert report.status is MoveStatus.DONE
        assert above == pytest.approx(config.test_pull - config.bite, abs=1e-4)
    else:
        assert report.code is Code.GRASP_EMPTY
        assert above == pytest.approx(config.clearance * np.cos(config.shaft_tilt) - config.bite, abs=1e-4)


def test_tissue_that_comes_along_at_first_is_pulled_on_until_it_is_felt(monkeypatch):
    table, config = Table(), GraspConfig()

    def tension(lease):
        lifted = float((lease.setpoint_cp(GRASPER).position - POINT) @ NORMAL) + config.bite
        return 0.2 if lifted > 1.5 * config.test_pull else 0.01

    monkeypatch.setattr(type(table.lease), "tension", tension)

    report, grasped = table.finish(take(table.lease, POINT, NORMAL, AWAY, config))

    assert report.status is MoveStatus.DONE and grasped is not None
    assert (grasped.test_pull, grasped.test_tension) == (2 * config.test_pull, 0.2)


def test_jaws_that_hold_nothing_open_before_they_leave(monkeypatch):
    table, config = Table(), GraspConfig()
    monkeypatch.setattr(type(table.lease), "tension", lambda self: 0.0)

    table.finish(take(table.lease, POINT, NORMAL, AWAY, config))

    opening, leaving = table.bench.motions(GRASPER)[-2:]
    assert (opening.name, opening.target) == ("move_jaw", config.jaw_open)
    assert leaving.name == "move_cp"
