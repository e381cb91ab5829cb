"""The guards: all of them are asked at every tick, before the procedure goes on."""

from __future__ import annotations

from py_trees.behaviour import Behaviour
from py_trees.common import ParallelPolicy
from py_trees.composites import Parallel

from behaviours.guard import Guard, no_trip, recorder_writing
from behaviours.lease_intact import LeaseIntact
from behaviours.services import Services


def guards(services: Services) -> Behaviour:
    """Emergency stop and trips, arms, camera, recorder, workspace, tension, and the lease of what is running.

    A parallel, so that one guard that waits never hides another that must end the session, and people see all of them.
    """
    gate = services.gate
    return Parallel(
        "guards",
        policy=ParallelPolicy.SuccessOnAll(synchronise=False),
        children=[
            Guard("emergency stop", services, lambda: no_trip(gate)),
            Guard("arms ready", services, gate.check_arms, once_checked=True),
            Guard("camera fresh", services, gate.check_camera),
            Guard("recorder writing", services, lambda: recorder_writing(services.recorder_fault())),
            Guard("workspace", services, gate.check_workspace, once_checked=True),
            Guard("tension", services, gate.check_tension, once_checked=True),
            LeaseIntact("lease intact", services),
        ],
    )
