"""Colours of hypotheses: stable, distinct, and so for the colour-blind too."""

from itertools import combinations

import numpy as np
import pytest

from comotion_clients.colours import GREY, HUES, colour, colours, hex_colour, marker
from comotion_schemas import UNDETERMINED

# Machado, Oliveira and Fernandes (2009), severity 1.0, on linear RGB.
DEFICIENCIES = {
    "none": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def lab(rgb: tuple[int, int, int], deficiency: str) -> np.ndarray:
    value = np.array(rgb) / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.array(DEFICIENCIES[deficiency]) @ linear, 0, 1)
    xyz = TO_XYZ @ linear / (TO_XYZ @ np.ones(3))
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("deficiency", DEFICIENCIES)
def test_hues_are_told_apart(deficiency: str) -> None:
    # A difference of 2.3 is just noticeable; 10 is seen at a glance.
    for one, other in combinations([*HUES, GREY], 2):
        assert np.linalg.norm(lab(one, deficiency) - lab(other, deficiency)) > 10, (one, other)


def test_a_colour_stays_with_its_id_and_neighbours_differ() -> None:
    assert colour(3) == colour(3)
    assert len({(colour(i), marker(i)) for i in range(105)}) == 105
    assert len({colour(i) for i in range(21)}) == 21


def test_undetermined_is_grey_and_nothing_else_is() -> None:
    assert colour(UNDETERMINED) == GREY
    assert all(len(set(colour(i))) > 1 for i in range(21))
    assert marker(UNDETERMINED) not in {marker(i) for i in range(105)}


def test_arrays_and_hex_agree_with_the_scalar() -> None:
    ids = np.array([0, 5, UNDETERMINED, 4_000_000_000, 5], np.uint32)
    table = colours(ids)
    assert table.dtype == np.uint8
    assert [tuple(row) for row in table.tolist()] == [colour(int(i)) for i in ids]
    assert hex_colour(0) == "#0072b2"
    assert colours(np.zeros(0, np.uint32)).shape == (0, 3)


@pytest.mark.parametrize("deficiency", DEFICIENCIES)
def test_shades_of_later_ids_differ_noticeably(deficiency: str) -> None:
    for one, other in combinations([colour(i) for i in (*range(21), UNDETERMINED)], 2):
        assert np.linalg.norm(lab(one, deficiency) - lab(other, deficiency)) > 2.3, (one, other)
