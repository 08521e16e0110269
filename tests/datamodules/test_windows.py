"""A window's arrays of the judged grid on the wide one, worked out by hand."""

import numpy as np

from envpred.datamodules.windows import widened


def test_widened_puts_the_judged_grid_in_the_middle_of_zeros() -> None:
    wide = widened(np.array([[[1, 2], [3, 4]]], np.float32), 6)
    expected = np.zeros((1, 6, 6), np.float32)
    expected[0, 2:4, 2:4] = [[1, 2], [3, 4]]
    np.testing.assert_array_equal(wide, expected)
