"""Fills in `linked` of an update.

Links tie hypotheses of calibrated cameras to bodies of a metric space.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from comotion_schemas import Hypothesis, HypothesisUpdate

from ..arrays import Labels, Slots
from ..config import LinkingConfig
from ..partition import BodyMotion, SpaceSpec
from ..trajectories.window import Window
from .camera import CameraModel
from .decision import body_evidence, decide, linked_hypotheses, representatives
from .image_tracks import sample_tracks
from .reprojection import log_likelihoods

# Motion must last for seconds before it links anything: more frequent decisions find nothing sooner.
_PERIOD_NS = 500_000_000
# Members per hypothesis that are compared with the bodies.
_REPRESENTATIVES = 12


@dataclass(frozen=True)
class SpaceView:
    """A space as of this update.

    `labels` int64 [n] are the hypotheses of the `current` slots; `motions` gives the motion of some
    hypotheses, in axes that stay the same, as far as it is known.
    """

    spec: SpaceSpec
    window: Window
    current: Slots
    labels: Labels
    hypotheses: list[Hypothesis]
    motions: Callable[[Collection[int]], dict[int, BodyMotion]]


class Linker:
    """Links between spaces, and their memory.

    Parameters
    ----------
    config
        Parameters, and the calibration of each camera by name of its space.

    Attributes
    ----------
    links
        The body of each linked hypothesis of an image, both by id.
    """

    def __init__(self, config: LinkingConfig) -> None:
        self._cameras = {space: CameraModel(camera) for space, camera in config.cameras.items()}
        self.links: dict[int, int] = {}
        self._due_ns: int | None = None

    def linked(
        self, update: HypothesisUpdate, views: Sequence[SpaceView], *, deciding: bool = True
    ) -> HypothesisUpdate:
        """Return the update with `linked` filled in, where there is something to say.

        Unless `deciding`, the links stay what they are.
        """
        if not self._cameras:
            return update
        space = {h.id: h.space for h in update.hypotheses}
        self._prune(space)
        if deciding and (self._due_ns is None or update.stamp_ns >= self._due_ns):
            self._due_ns = update.stamp_ns + _PERIOD_NS
            self._look(views)
            # A body that the update does not list, such as a static one without members, can be found too.
            self._prune(space)
        groups = linked_hypotheses(self.links, space)
        found = [replace(h, linked=groups[h.id]) if h.id in groups else h for h in update.hypotheses]
        return replace(update, hypotheses=found)

    def _prune(self, space: Mapping[int, str]) -> None:
        """Keep the links between listed hypotheses of spaces that can be linked."""
        self.links = {i: k for i, k in self.links.items() if self._possible(space.get(i), space.get(k))}

    def _possible(self, image: str | None, body: str | None) -> bool:
        """Whether two spaces can be linked; what a snapshot brings may be of another calibration."""
        camera = self._cameras.get(image) if image is not None else None
        return camera is not None and camera.frame == body

    def _look(self, views: Sequence[SpaceView]) -> None:
        bodies: dict[str, dict[int, BodyMotion]] = {}
        for space in views:
            camera = self._cameras.get(space.spec.name)
            if camera is None or space.spec.unit != "px" or space.spec.dim != 2:
                continue
            if camera.frame not in bodies:
                bodies[camera.frame] = _bodies(camera.frame, views)
            if bodies[camera.frame]:
                self._link(space, bodies[camera.frame], camera)

    def _link(self, space: SpaceView, bodies: dict[int, BodyMotion], camera: CameraModel) -> None:
        """Decide anew for every hypothesis of one camera."""
        chosen = representatives(space.labels, space.window.counts(space.current), _REPRESENTATIVES)
        ids, motions = list(bodies), list(bodies.values())
        tracks = sample_tracks(space.window, space.current[chosen], motions[0].stamps, camera)
        likelihoods = log_likelihoods(tracks, motions, camera)
        labels = space.labels[chosen]
        fittable = tracks.fittable()
        for image in np.unique(labels).tolist():
            previous = self.links.pop(image, None)
            column = ids.index(previous) if previous in ids else None
            evidence = body_evidence(likelihoods[fittable & (labels == image)])
            best = decide(evidence, column)
            if best is not None:
                self.links[image] = ids[best]


def _bodies(name: str, views: Sequence[SpaceView]) -> dict[int, BodyMotion]:
    """Motion of the hypotheses that a metric space lists, by id; what does not move rests.

    What a fit to the members of a body at rest says of their motion is noise.
    """
    for space in views:
        if space.spec.name == name and space.spec.dim == 3:
            moving = {h.id for h in space.hypotheses if h.state == "moving"}
            motions = space.motions([h.id for h in space.hypotheses])
            return {one: motion if one in moving else motion.at_rest() for one, motion in motions.items()}
    return {}
