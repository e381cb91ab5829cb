"""Judge which connections across the goal are severed; the graph goes to the blackboard."""

from __future__ import annotations

from py_trees.common import Status

from behaviours.board import ATTEMPT, ESTIMATE, INTERRUPTIONS, LOOKED_AGAIN, Estimate
from behaviours.run_skill import RunSkill
from behaviours.services import Services
from hardware.codes import Code
from hardware.gate import Lease
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.skill import Steps


class EstimateConnectivity(RunSkill[ConnectivityGraph]):
    """SUCCESS when the graph can be relied on; FAILURE with its code otherwise. `ESTIMATE` is None until then.

    Too many unknown edges are a FAILURE at first, so that the tissue is exposed once more. After that the graph is kept as it is: it is
    never complete, and what is to be cut of it is for the operator to approve.
    """

    def __init__(self, name: str, services: Services) -> None:
        super().__init__(name, services, reads=(ATTEMPT, INTERRUPTIONS, LOOKED_AGAIN), writes=(ESTIMATE,))

    def skill(self, lease: Lease | None) -> Steps[ConnectivityGraph]:
        """Estimate; the last estimate is forgotten first."""
        self.board.set(ESTIMATE, None)
        return self.services.skills.estimate()

    def judge(self, outcome: ConnectivityGraph) -> Status:
        """Keep the graph with the attempt and the interruptions that it belongs to."""
        crossing = outcome.state[outcome.crosses_goal]
        attempt = self.board.get(ATTEMPT).number
        self.services.tell(
            "estimate",
            attempt=attempt,
            code=outcome.code.value,
            message=outcome.message,
            complete=outcome.complete,
            crossing=len(crossing),
            connected=int((crossing == EdgeState.CONNECTED).sum()),
            severed=int((crossing == EdgeState.SEVERED).sum()),
            unknown=int((crossing == EdgeState.UNKNOWN).sum()),
        )
        asks_the_operator = outcome.code is Code.TOO_MANY_UNKNOWN and self.board.get(LOOKED_AGAIN) == attempt
        if outcome.code is Code.OK or asks_the_operator:
            self.board.set(ESTIMATE, Estimate(outcome, attempt, self.board.get(INTERRUPTIONS)))
        return self.succeed(outcome.message) if asks_the_operator else super().judge(outcome)
