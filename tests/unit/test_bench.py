"""The scene of the benchmark is what it says, and a timing counts what it should."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from comotion import FusionConfig
from comotion_tools.bench.live import latencies
from comotion_tools.bench.report import write_page
from comotion_tools.bench.scene import Scene, SceneSpec
from comotion_tools.bench.timing import time_scene


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


def test_plain_cameras_see_the_same_bodies_each_in_a_space_of_its_own() -> None:
    scene = Scene(SceneSpec(features=60, bodies=2, sources=2, churn=0.0, pixels=True))
    first, *_, last = islice(scene.frames(1), 90)
    assert (first.space, first.unit, first.dim) == ("s1/pixels", "px", 2)
    moved = np.linalg.norm(last.positions - first.positions, axis=1)
    rests = np.array(scene.truth["s1"]) == 0
    assert moved[rests].max() < 5 * 0.3 * np.sqrt(2)
    assert np.median(moved[~rests]) > 10
    assert abs(first.positions - [320, 240]).max() < 640


def test_a_timing_covers_every_update_after_the_window_has_filled() -> None:
    spec = SceneSpec(features=20, bodies=1, rate=10)
    timing = time_scene(spec, FusionConfig(method="thesis", window=1.0), updates=6)
    assert timing.features == [20] * 6
    assert len(timing.total_ms) == len(timing.cpu_ms) == 6
    assert (timing.total_ms > timing.update_ms).all()
    assert 0 < np.mean(timing.nmi) <= 1


def test_latency_counts_from_the_last_put_that_an_update_holds() -> None:
    ms = 1_000_000
    puts = np.array([[0, 1], [30, 32], [60, 61], [90, 95]]) * ms
    updates = np.array([[0, 50], [60, 100], [60, 200], [100, 300]]) * ms
    last, every = latencies(updates, puts)
    assert last.tolist() == [49, 39, 139, 205]
    assert every.tolist() == [68, 39, 205]


def test_a_page_is_written_between_its_marks_alone(tmp_path: Path) -> None:
    page = tmp_path / "performance.md"
    write_page(page, "first\n")
    page.write_text("before\n" + page.read_text() + "after\n")
    write_page(page, "second\n")
    text = page.read_text()
    assert "second" in text
    assert "first" not in text
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    (tmp_path / "other.md").write_text("no marks")
    with pytest.raises(ValueError, match="no marks"):
        write_page(tmp_path / "other.md", "x")
