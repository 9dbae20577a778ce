"""The chain from a real video to hypotheses, judged by labels drawn by hand."""

import os
from pathlib import Path

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion_clients.metrics import misclassification, nmi
from comotion_schemas.types import UNDETERMINED
from comotion_sources.cameras import Frame, open_frames
from comotion_sources.frames import MessageBuilder
from comotion_sources.klt import Tracker
from comotion_sources.klt.observer import Observer, choose_space

NEAR = 8.0  # px


def nearest_labels(pixels: np.ndarray, labelled: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Label of the nearest labelled feature, -1 where none is near."""
    distance = np.linalg.norm(pixels[:, None] - labelled[None], axis=2)
    nearest = distance.argmin(axis=1)
    return np.where(distance.min(axis=1) < NEAR, labels[nearest], -1)


@pytest.mark.data
@pytest.mark.skipif("COMOTION_DATA" not in os.environ, reason="COMOTION_DATA names no recordings")
def test_the_drawers_of_a_real_video_are_separated() -> None:
    folder = Path(os.environ["COMOTION_DATA"]) / "video"
    with np.load(folder / "ikeasmall01.npz") as file:
        times, positions, labels = file["times"], file["positions"], file["labels"]
    space = choose_space("klt", has_depth=False, intrinsics=None, extrinsics=None)
    builder = MessageBuilder(source="klt", session="0" * 16, space=space.name, unit="px", dim=2)
    tracker, observer = Tracker(), Observer(space, builder)
    fusion = Fusion(FusionConfig(), scene="default", session="1" * 16)
    scores, errors = [], []
    for k, frame in enumerate(open_frames(str(folder / "ikeasmall01.avi"))):
        tracks = tracker.step(Frame(frame.stamp_ns + 1, frame.image))
        for message in observer.messages(tracks, frame):
            fusion.ingest(message)
        # Both drawers have moved by 6.5 s; the updates before keep the engine going.
        if k % 5 or k < 30:
            continue
        update = fusion.update(tracks.stamp_ns)
        if frame.stamp_ns < 6.6e9:
            continue
        row = positions[np.argmin(np.abs(times - frame.stamp_ns / 1e9))]
        seen = np.isfinite(row).all(axis=1)
        place = dict(zip(tracks.ids.tolist(), tracks.pixels, strict=True))
        pixels = np.array([place[i] for i in update.track_id.tolist()])
        true = nearest_labels(pixels, row[seen], labels[seen])
        found = update.track_hypothesis.astype(np.int64)
        found = np.where(found == UNDETERMINED, 2**32 + np.arange(len(found)), found)
        assert (true >= 0).sum() > 150
        scores.append(nmi(found[true >= 0], true[true >= 0]))
        errors.append(misclassification(found[true >= 0], true[true >= 0]))
    assert len(scores) >= 7
    assert np.median(scores) > 0.8
    assert np.median(errors) < 0.06
