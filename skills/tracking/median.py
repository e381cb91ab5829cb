"""The median of few values: NumPy's own spends most of its time before it looks at them."""

from __future__ import annotations

import numpy as np

from hardware.interface import Array


def median(values: Array, axis: int = 0) -> Array:
    """Median of finite `values` along `axis`, of which there is at least one."""
    ordered, count = np.sort(values, axis=axis), values.shape[axis]
    return np.asarray((ordered.take((count - 1) // 2, axis) + ordered.take(count // 2, axis)) / 2.0)
