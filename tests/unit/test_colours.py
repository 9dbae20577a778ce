"""Colours of hypotheses: stable, distinct, and so for the colour-blind too."""

from itertools import combinations

import numpy as np
import pytest

from comotion_schemas.colours import BACKGROUND, COLOURS, GREY, Palette, colour

from ..builders import hypothesis

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


def lab(rgb, deficiency):
    value = np.array(rgb) / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.array(DEFICIENCIES[deficiency]) @ linear, 0, 1)
    xyz = TO_XYZ @ linear / (TO_XYZ @ np.ones(3))
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("deficiency", DEFICIENCIES)
def test_colours_are_told_apart(deficiency):
    # A difference of 2.3 is just noticeable; 10 is seen at a glance.
    for one, other in combinations([*COLOURS, GREY, BACKGROUND], 2):
        assert np.linalg.norm(lab(one, deficiency) - lab(other, deficiency)) > 10, (one, other)


def test_a_colour_stays_while_its_hypothesis_is_listed_and_no_two_share_one():
    palette, rng = Palette(), np.random.default_rng(0)
    listed, before = set(), {}
    for step in range(200):
        listed = {i for i in listed if rng.random() > 0.1} | {step * 7 % 50}
        palette.see([hypothesis(i) for i in listed])
        now = {i: palette.colour(i) for i in listed}
        assert len(set(now.values())) == len(listed)
        assert all(now[i] == before[i] for i in listed & before.keys())
        before = now
    many = list(range(100, 100 + len(COLOURS)))
    palette.see([hypothesis(i) for i in many])
    assert len({palette.colour(i) for i in many}) == len(COLOURS)
    alone = Palette()
    alone.see([hypothesis(1), hypothesis(1 + len(COLOURS))])
    assert alone.colour(1) == colour(1)


def test_the_largest_at_rest_is_the_background_of_its_space():
    palette = Palette()
    elsewhere, small = hypothesis(3, state="static", space="b"), hypothesis(2, state="undetermined", size=4)
    palette.see([hypothesis(1, state="undetermined", size=30), small, elsewhere])
    assert palette.colour(1) == palette.colour(3) == BACKGROUND
    assert palette.colour(2) == colour(2)
    first, larger = (hypothesis(one, state="static", size=size) for one, size in ((1, 20), (4, 40)))
    palette.see([first, larger, elsewhere])
    assert palette.colour(4) == colour(4)
    palette.see([hypothesis(1, state="moving", size=20)])
    assert palette.colour(1) == colour(1)
