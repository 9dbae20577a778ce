"""The equations of the thesis, against numbers worked out by hand."""

import math

import numpy as np
import pytest

from comotion.thesis import equations

from ..reference import thesis as literal

MS = 1_000_000


def test_weight_is_0_9_at_the_target_velocity_and_small_but_not_zero_at_rest():
    w = equations.weight(np.array([0.0, 0.1, 1.0]), 0.1)
    assert w[0] == pytest.approx(0.0023, rel=0.01)
    assert w[1] == pytest.approx(0.9, abs=1e-3)
    assert w[2] == pytest.approx(1.0)
    assert equations.weight(np.array([0.0, 3.0]), None).tolist() == [1.0, 1.0]


def test_the_reference_interpolates_and_weighs_as_the_thesis_says():
    """The reference itself, against numbers worked out by hand."""
    i = literal.Trajectory({0: (0.0, 0.0), 1000 * MS: (1.0, 0.0)})
    j = literal.Trajectory({0: (0.0, 2.0), 250 * MS: (0.0, 2.0), 1000 * MS: (0.0, 2.0)})
    found = literal.samples(i, j, 2000 * MS)
    assert [d for d, _ in found] == pytest.approx([2.0, math.hypot(0.25, 2.0), math.hypot(1.0, 2.0)])
    assert [v for _, v in found] == pytest.approx([1.0, 1.0, 1.0])
    assert len(literal.samples(i, j, 500 * MS)) == 2
    assert literal.weight(0.01, 0.1) == pytest.approx(1 - 0.1 * math.exp(math.log(0.1) * 1e-3))
