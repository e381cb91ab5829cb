from __future__ import annotations

import pytest
from py_trees.common import Status

from behaviours.board import ATTEMPT, Attempt
from behaviours.look_first import LookFirst
from tests.mocks.stage import Stage, put


@pytest.mark.parametrize(("cut", "status"), [(True, Status.FAILURE), (False, Status.SUCCESS)])
def test_a_resumed_attempt_looks_first(cut: bool, status: Status) -> None:
    stage = Stage()
    stage.build(lambda services: LookFirst("look first?", services))
    put(ATTEMPT, Attempt(1, cut, 0))

    assert stage.tick() is status
