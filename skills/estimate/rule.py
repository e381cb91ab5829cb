"""How edges are judged."""

from enum import StrEnum


class Rule(StrEnum):
    """What makes an edge severed."""

    LIKELIHOOD = "likelihood"  # the whole history of the pull, against what the tissue model expects of it
    ELONGATION = "elongation"  # paper, Sec. Tissue Connectivity Estimation: length against a threshold
