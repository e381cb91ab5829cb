"""The quick median is the median."""

import numpy as np
import pytest

from skills.tracking.median import median


@pytest.mark.parametrize("count", [1, 2, 3, 6, 7])
@pytest.mark.parametrize("axis", [0, 1])
def test_it_is_what_numpy_says(count: int, axis: int) -> None:
    values = np.random.default_rng(count).normal(size=(count, count, 2))

    assert (median(values, axis) == np.median(values, axis=axis)).all()


def test_of_a_single_row_it_is_one_number() -> None:
    assert float(median(np.array([3.0, 1.0, 2.0, 10.0]))) == 2.5
