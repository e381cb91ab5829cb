"""Small statistics of the experiments: means with spread, and Wilson's interval for a rate."""

from collections.abc import Sequence

import numpy as np

Z95 = 1.959963984540054


def mean_sd(values: Sequence[float]) -> dict[str, float]:
    """Mean and sample standard deviation."""
    array = np.asarray(values, dtype=np.float64)
    return {"mean": float(array.mean()), "sd": float(array.std(ddof=1)) if len(array) > 1 else 0.0}


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Wilson's 95 % interval of the rate `successes` / `trials` (Wilson 1927): honest for few trials too."""
    if trials == 0:
        return (0.0, 1.0)
    rate = successes / trials
    centre = rate + Z95**2 / (2 * trials)
    spread = Z95 * np.sqrt(rate * (1 - rate) / trials + Z95**2 / (4 * trials**2))
    scale = 1 + Z95**2 / trials
    return (float(max(0.0, (centre - spread) / scale)), float(min(1.0, (centre + spread) / scale)))
