"""Colours of hypotheses: stable, distinct, and so for the colour-blind too."""

import numpy as np

from comotion_schemas.colours import BACKGROUND, COLOURS, Palette, colour

from ..builders import hypothesis


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
