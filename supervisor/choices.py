"""What a user chooses of the skills by name, and the settings that follow from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from skills.estimate.rule import Rule
from skills.expose.optimal import OptimalConfig
from skills.expose.xpbd import choose_device
from skills.replan.candidates import ReplanConfig
from skills.tracking.choose import TrackerChoice
from supervisor.skillset import ExposureKind, SkillConfig


@dataclass(frozen=True)
class Choices:
    """`device` is where the exposure is planned and where a learned tracker computes."""

    exposure: ExposureKind = ExposureKind.OPTIMAL
    rule: Rule = Rule.LIKELIHOOD
    cover: Literal["optimal", "greedy"] = "optimal"
    tracker: str = "dis"
    tracker_weights: Path | None = None
    device: str = "auto"

    def skills(self, threads: int | None = None) -> SkillConfig:
        """Settings of the skills; the exposure is planned with so many `threads`.

        Raises:
            InputError: there is no such device or tracker, or what it needs is missing.
        """
        device = choose_device(self.device)
        weights = None if self.tracker_weights is None else str(self.tracker_weights)
        return SkillConfig(
            exposure=self.exposure,
            rule=self.rule,
            choice=TrackerChoice(self.tracker, weights, device),
            optimal=OptimalConfig(device=device, threads=threads),
            replan=ReplanConfig(cover=self.cover),
        )
