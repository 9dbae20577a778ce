"""The link experiment: what it records, how it scores, what it says."""

from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra sim3d (mujoco)")

from comotion import FusionConfig
from comotion.linking.camera import CameraModel
from comotion_experiments.links import Setup, report, run_experiment, save_picture
from comotion_experiments.links.recording import plain_camera, record
from comotion_experiments.links.setup import DEPTH_CAMERA, PLAIN_CAMERA, PLAIN_SPACE
from comotion_experiments.links.study import Count, by_object, count_links, main_objects, rested
from comotion_schemas import Hypothesis, HypothesisUpdate, ObservationBatch
from comotion_sources.workcell import Scene

TINY = Setup(size=(160, 120), rate=10, features=60, duration=2.4)
NONE = np.zeros(0)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def hypothesis(one: int, space: str, linked_to: list[int] | None = None, state: str = "moving") -> Hypothesis:
    return Hypothesis(
        id=one, space=space, size=3, born_ns=0, state=state, centroid=[0.0, 0.0], linked=linked_to
    )


def update(*hypotheses: Hypothesis) -> HypothesisUpdate:
    return HypothesisUpdate(
        scene="lab", session="0" * 16, seq=0, stamp_ns=0, published_ns=0, period_ns=1, sources=[],
        track_source=NONE, track_id=NONE, track_hypothesis=NONE, track_confidence=NONE,
        track_position=np.zeros((0, 3)), hypotheses=list(hypotheses), events=[],
    )  # fmt: skip


def test_the_plain_camera_publishes_pixels_that_its_calibration_explains(cache: Path) -> None:
    sources = record("arm", 0, TINY, cache)
    deep, plain = (
        [m for m in sources[name] if isinstance(m, ObservationBatch)] for name in (DEPTH_CAMERA, PLAIN_CAMERA)
    )
    assert {(b.space, b.unit) for b in deep} == {("world", "m")}
    assert {(b.space, b.unit) for b in plain} == {(PLAIN_SPACE, "px")}
    assert len(deep) == len(plain) == 24
    # The target that the camera looks at is seen in the middle of its image.
    camera, scene = CameraModel(plain_camera("arm", 0, TINY)), Scene.named("arm")
    target = scene.model.body_pos[scene.model.cam_targetbodyid[scene.cameras.index("b")]]
    inside = (target - camera.translation) @ camera.rotation
    assert inside[2] > 0
    np.testing.assert_allclose(
        inside[:2] / inside[2], camera.normalised(np.array([[79.5, 59.5]]))[0], atol=1e-9
    )


def test_links_are_counted_against_the_main_objects() -> None:
    labels = np.array([1, 1, 1, 1, 2, 2, 2, 5, 5, 5, 6, 6, 6, 7, 7])
    objects = np.array([4, 4, 4, 0, 0, 0, 0, 4, 4, 4, 0, 0, -1, 3, 3], np.int32)
    main = main_objects(labels, objects)
    assert main == {1: 4, 2: 0, 5: 4}, "two features, or three of which one is ambiguous, are too few"
    assert main_objects(labels, objects, 0.8) == {2: 0, 5: 4}, "a quarter of 1 is of another object"
    read_as = update(
        hypothesis(1, PLAIN_SPACE, [5]), hypothesis(2, PLAIN_SPACE, [5]), hypothesis(5, "world", [1, 2])
    )
    moving, resting = count_links(read_as, main)
    assert moving == Count(links=1, right=1, linkable=1, found=1)
    assert resting == Count(links=1, right=0, linkable=0, found=0)
    assert (moving + resting).precision == 0.5
    assert np.isnan(Count().precision)


def test_what_rests_and_what_is_of_one_object_can_be_read_as_one() -> None:
    read_as = update(
        hypothesis(8, PLAIN_SPACE, None, "static"),
        hypothesis(9, "world", None, "static"),
        hypothesis(10, "world"),
    )
    assert rested(read_as) == {8: 8, 9: 8}
    assert by_object({1: 4, 5: 4, 8: 0, 7: 4}) == {1: 1, 5: 1, 7: 1, 8: 8}


def test_the_experiment_runs_scores_and_reports(cache: Path) -> None:
    results = run_experiment(["arm"], [0], FusionConfig(), setup=TINY, cache=cache, period=0.4)
    (case,) = results.cases
    for what in ("nmi", "nmi_plain", "error_plain"):
        for reading in ("apart", "rest", "joined", "oracle"):
            assert 0 <= case.scores(what, reading)[0] <= 1
    assert case.count("resting").linkable > 0
    assert len(report.table(results).rows) == 2
    assert report.markdown(results).count("\n") == 4
    assert report.as_json(results)["cases"][0]["scene"] == "arm"
    save_picture(cache / "links.jpg", "arm", 0, FusionConfig(), setup=TINY, cache=cache, seconds=2.0)
    picture = cv2.imread(str(cache / "links.jpg"))
    assert picture is not None
    assert picture.shape == (120, 320, 3)
