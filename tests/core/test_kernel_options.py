"""Kernels are compiled the same whichever other kernel calls them first."""

import sys

import numpy as np

from coopmap_env.core.kernels import borrowing_kernel, kernel


@kernel
def mean_of_copy(values):
    return np.append(values, 0.0).sum() / len(values)


@borrowing_kernel
def borrow(values):
    return mean_of_copy(values)


@kernel
def call_borrowing(values):
    return borrow(values)


def test_a_kernel_that_makes_arrays_may_first_be_called_by_one_that_does_not():
    values = np.arange(4.0)
    assert call_borrowing(values) == mean_of_copy(values) == 1.5
    before = sys.getrefcount(values)
    for _ in range(3):
        mean_of_copy(values)
    assert sys.getrefcount(values) == before
