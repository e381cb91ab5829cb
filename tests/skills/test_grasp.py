"""Taking tissue: caught tissue stays in the jaws where the test pull left them; empty jaws get out of the way."""

from collections.abc import Callable

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import GRASPER, MoveReport, MoveStatus, Stamped
from skills.grasp import GraspConfig, Grasped, take
from tests.mocks.table import Table

POINT, NORMAL, AWAY = np.array([0.0, 0.0, 0.08]), np.array([0.0, 0.0, -1.0]), np.array([0.0, -1.0, 0.0])
CONFIG = GraspConfig()
NOISE = 0.05  # [N], of the bench's force


def taken(
    pulled: Callable[[float], float], monkeypatch: pytest.MonkeyPatch, seed: int | None = None
) -> tuple[Table, MoveReport, Grasped | None]:
    """Grasp tissue that pulls with `pulled` [N] at a height [m] over where the jaws closed; noise in the force with a `seed`."""
    table = Table()
    noise = None if seed is None else np.random.default_rng(seed)

    def force(arm: object) -> Stamped[np.ndarray]:
        lifted = float((table.lease.setpoint_cp(GRASPER).position - POINT) @ NORMAL) + CONFIG.bite
        error = np.zeros(3) if noise is None else NOISE * noise.standard_normal(3)
        return Stamped(-pulled(lifted) * NORMAL + error, table.bench.now())

    monkeypatch.setattr(type(table.bench.grasper), "measured_cf", force)
    report, grasped = table.finish(take(table.lease, POINT, NORMAL, AWAY, CONFIG))
    return table, report, grasped


@pytest.mark.parametrize(("tension", "caught"), [(0.3, True), (0.0, False), (-0.3, False)])
def test_empty_jaws_back_off_and_caught_tissue_is_held(tension, caught, monkeypatch):
    table, report, grasped = taken(lambda lifted: tension, monkeypatch)

    above = float((table.lease.setpoint_cp(GRASPER).position - POINT) @ NORMAL)
    assert (grasped is not None) is caught
    if caught:
        assert report.status is MoveStatus.DONE
        assert above == pytest.approx(CONFIG.test_pull - CONFIG.bite, abs=1e-4)
    else:
        assert report.code is Code.GRASP_EMPTY
        assert above == pytest.approx(CONFIG.clearance * np.cos(CONFIG.shaft_tilt) - CONFIG.bite, abs=1e-4)


def test_an_unknown_force_is_no_grasp(monkeypatch):
    _, report, grasped = taken(lambda lifted: float("nan"), monkeypatch)

    assert grasped is None and report.status is MoveStatus.FAILED


def test_tissue_that_comes_along_at_first_is_pulled_on_until_it_is_felt(monkeypatch):
    _, report, grasped = taken(lambda lifted: 0.2 if lifted > 1.5 * CONFIG.test_pull else 0.01, monkeypatch)

    assert report.status is MoveStatus.DONE and grasped is not None
    assert (grasped.test_pull, grasped.test_tension) == pytest.approx((2 * CONFIG.test_pull, 0.2))


def test_noise_is_not_taken_for_tissue_nor_light_tissue_for_noise(monkeypatch):
    empty = [taken(lambda lifted: 0.0, monkeypatch, seed)[2] for seed in range(100)]
    light = [taken(lambda lifted: 50.0 * lifted, monkeypatch, seed)[2] for seed in range(100)]

    assert sum(grasped is not None for grasped in empty) <= 5
    assert sum(grasped is None for grasped in light) == 0


def test_jaws_that_hold_nothing_open_before_they_leave(monkeypatch):
    table, _, _ = taken(lambda lifted: 0.0, monkeypatch)

    opening, leaving = table.bench.motions(GRASPER)[-2:]
    assert (opening.name, opening.target) == ("move_jaw", CONFIG.jaw_open)
    assert leaving.name == "move_cp"
