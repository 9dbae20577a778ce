"""Picture of the link experiment: both camera images at one time, features coloured by body."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion import FusionConfig
from comotion.config import LinkingConfig
from comotion_clients.metrics import bodies_of
from comotion_schemas import HypothesisUpdate
from comotion_schemas.colours import Palette
from comotion_sources.workcell import Scene, Viewpoint

from ..fusion.study import in_time_order
from ..offline import run_offline
from .recording import plain_camera, record
from .setup import DEPTH_CAMERA, PLAIN_CAMERA, PLAIN_SPACE, Setup

_RADIUS = 4
_QUALITY = 85


def save_picture(
    path: Path,
    scene: str,
    seed: int,
    config: FusionConfig,
    *,
    setup: Setup | None = None,
    cache: Path | None = None,
    seconds: float = 8.0,
) -> None:
    """Draw the image of the depth camera on the left and that of the other camera on the right.

    Discs are features of linked hypotheses, rings are features of others.

    Parameters
    ----------
    path
        JPEG to write.
    scene, seed, config, setup, cache
        As in :func:`~comotion_experiments.links.run_experiment`.
    seconds
        When.
    """
    setup = setup or Setup()
    sources = record(scene, seed, setup, cache)
    cameras = config.linking.cameras | {PLAIN_SPACE: plain_camera(scene, seed, setup)}
    last: list[HypothesisUpdate] = []
    palette = Palette()
    run_offline(
        in_time_order([sources[DEPTH_CAMERA], sources[PLAIN_CAMERA]]),
        config.model_copy(update={"linking": LinkingConfig(cameras=cameras)}),
        period=0.5,
        duration=seconds,
        on_update=lambda update, _: last.append(update),
    )
    for update in last:
        palette.see(update.hypotheses)
    images = [
        _draw(Viewpoint(Scene.named(scene, seed), camera, setup.size), update, source, palette)
        for camera, source in (("a", DEPTH_CAMERA), ("b", PLAIN_CAMERA))
    ]
    _, encoded = cv2.imencode(".jpg", np.hstack(images), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encoded.tobytes())


def _draw(view: Viewpoint, update: HypothesisUpdate, source: str, palette: Palette) -> NDArray[np.uint8]:
    configuration = view.scene.configuration(update.stamp_ns * 1e-9)
    image = np.array(view.frame(configuration, update.stamp_ns).image)
    bodies = bodies_of(update)
    mine = np.array([one.name == source for one in update.sources])[update.track_source]
    points = update.track_position[mine].astype(np.float64)
    flat = points[:, :2]
    if source == DEPTH_CAMERA:
        flat = view.intrinsics.project(view.extrinsics.inverse().apply(points))
    for place, one in zip(flat, update.track_hypothesis[mine].tolist(), strict=True):
        bgr = palette.colour(bodies.get(one, one))[::-1]
        centre = (round(float(place[0])), round(float(place[1])))
        thickness = cv2.FILLED if one in bodies else 1
        cv2.circle(image, centre, _RADIUS, bgr, thickness, cv2.LINE_AA)
    return np.asarray(image, np.uint8)
