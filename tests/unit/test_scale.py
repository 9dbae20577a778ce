"""One source must not set the scale of the others."""

import numpy as np
import pytest

from comotion import Fusion, FusionConfig

from ..builders import T0, S, batch

FAR = np.random.default_rng(2).uniform(-1, 1, (50, 3))
INTRUDERS = {
    "outliers": lambda k, seen: FAR + (0.9e9 if k > 20 else 0.0),
    "millimetres": lambda k, seen: 1000 * seen,
    "far away": lambda k, seen: FAR + 1e6,
}


@pytest.mark.parametrize("kind", INTRUDERS)
def test_bodies_of_a_source_stay_apart_whatever_another_source_says(kind):
    rng = np.random.default_rng(1)
    floor, first, second = (rng.uniform(-w, w, (n, 3)) for w, n in ((1, 20), (0.1, 10), (0.1, 10)))
    fusion = Fusion()
    for k in range(48):
        t, now = k / 16, T0 + k * S // 16
        places = np.array([[0.3 * np.sin(t), 0.2, 0.5], [-0.4, 0.3 * np.sin(1.3 * t), 0.4]])
        seen = np.concatenate([floor, first + places[0], second + places[1]]) + rng.normal(0, 0.001, (40, 3))
        for source, points in (("good", seen), ("odd", INTRUDERS[kind](k, seen))):
            fusion.ingest(batch(source, k, now, points))
        if k % 6 == 5:
            update = fusion.update(now)
    good = [s.name for s in update.sources].index("good")
    labels = update.track_hypothesis[update.track_source == good]
    groups = labels[:20], labels[20:30], labels[30:]
    assert [len(set(group.tolist())) for group in groups] == [1, 1, 1]
    assert len(set(labels.tolist())) == 3


@pytest.mark.parametrize(("extent", "taken"), [(200.0, 40), (0.0, 90)])
def test_a_limit_of_0_takes_rows_however_far_they_are(extent, taken):
    fusion = Fusion(FusionConfig(limits={"extent": extent}))
    near = np.random.default_rng(1).uniform(-1, 1, (40, 3))
    for k in range(20):
        for source, points in (("good", near), ("odd", FAR + 1e6)):
            fusion.ingest(batch(source, k, T0 + k * S // 16, points))
        update = fusion.update(T0 + k * S // 16)
    assert len(update.track_id) == taken
