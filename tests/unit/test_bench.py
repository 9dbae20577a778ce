"""The scene of the benchmark is what it says, and a timing counts what it should."""

from itertools import islice

import numpy as np
import pytest

from comotion import FusionConfig
from comotion_experiments.bench import Scene, SceneSpec, time_scene


def test_a_source_keeps_its_number_of_features_and_gives_up_those_it_replaces() -> None:
    scene = Scene(SceneSpec(features=91, sources=3, churn=0.5))
    known: set[int] = set()
    for batch in islice(scene.frames(0), 60):
        ids = set(batch.ids.tolist())
        ended = set() if batch.ended is None else set(batch.ended.tolist())
        assert len(ids) == len(batch.ids) == 31
        assert ended == known - ids
        known = ids
    assert len(scene.truth["s0"]) == pytest.approx(31 * 2, abs=12)


def test_bodies_are_rigid_and_move_while_the_background_rests() -> None:
    scene = Scene(SceneSpec(features=60, bodies=2, sources=1, churn=0.0, noise=0.0))
    first, *_, last = islice(scene.frames(0), 90)
    of = np.array(scene.truth["s0"])
    np.testing.assert_allclose(last.positions[of == 0], first.positions[of == 0], atol=1e-6)
    for body in (1, 2):
        before, after = first.positions[of == body], last.positions[of == body]
        spans = [np.linalg.norm(x[:, None] - x, axis=2) for x in (before, after)]
        np.testing.assert_allclose(*spans, atol=1e-5)
        assert np.linalg.norm(after - before, axis=1).min() > 0.01


def test_a_timing_covers_every_update_after_the_window_has_filled() -> None:
    spec = SceneSpec(features=20, bodies=1, rate=10)
    timing = time_scene(spec, FusionConfig(method="thesis", window=1.0), updates=6)
    assert timing.features == [20] * 6
    assert len(timing.total_ms) == len(timing.cpu_ms) == 6
    assert (timing.total_ms > timing.update_ms).all()
    assert 0 < np.mean(timing.nmi) <= 1
