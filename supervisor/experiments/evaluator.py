"""Judges a session on the stub by the truth of the mesh. The session never sees it: completion is judged independently."""

from dataclasses import dataclass

import numpy as np

from hardware.stub.bench import StubBench
from hardware.stub.renderer import Label
from hardware.stub.truth import Truth, measure

BORDER = 5e-3  # [m]: bed seen nearer than this to the sheet's outline is not the dissected region


@dataclass(frozen=True)
class Evaluation:
    """Truth after one attempt; `visible_area_px` is the part of the bed and cut faces that the left eye sees through the opening."""

    attempt: int
    truth: Truth
    visible_area_px: int

    def as_dict(self) -> dict[str, float | int | bool]:
        """Plain numbers for the record."""
        t = self.truth
        return {
            "attempt": self.attempt,
            "attachments": t.attachments,
            "effective_cut_ratio": t.effective_cut_ratio,
            "excessive_cut_ratio": t.excessive_cut_ratio,
            "length_deviation_m": t.length_deviation,
            "visible_area_px": self.visible_area_px,
            "tears": t.tears,
            "bed_contact_m": t.bed_contact,
            "success": t.success,
        }


def evaluate(bench: StubBench, attempt: int) -> Evaluation:
    """The truth about the tissue on `bench` now."""
    return Evaluation(attempt, measure(bench.phantom), visible_area(bench))


def visible_area(bench: StubBench) -> int:
    """Pixels of the left image that show the bed or a cut face within the sheet's outline."""
    rendering = bench.endoscope.rendering()
    inside = (rendering.label == Label.BASE) | (rendering.label == Label.WALL)
    v, u = np.nonzero(inside)
    if not len(u):
        return 0
    points = bench.endoscope.camera.unproject(np.column_stack([u, v]).astype(float), rendering.depth[v, u].astype(np.float64))
    table = bench.to_table(points)[:, :2]
    half = np.array([bench.scene.tissue.width, bench.scene.tissue.height]) / 2 - BORDER
    return int((np.abs(table) < half).all(axis=1).sum())
