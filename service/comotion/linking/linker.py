"""Fills in `linked` of an update.

Links tie hypotheses of calibrated cameras to bodies of a metric space.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from comotion_schemas import HypothesisUpdate

from ..arrays import Floats, ranks
from ..config import LinkingConfig
from ..partition import BodyMotion
from ..saving import NOT_KEPT
from ..space_update import SpaceUpdate
from .reprojection import CameraModel, log_likelihoods, sample_tracks

# Motion must last for seconds before it links anything: more frequent decisions find nothing sooner.
_PERIOD_NS = 500_000_000
# Members per hypothesis that are compared with the bodies.
_REPRESENTATIVES = 12
# Three numbers are fitted to the states of a member, of which each has two.
_LEAST_STATES = 4
# Share of a hypothesis' members that may be outliers.
_OUTLIER_SHARE = 0.2
# nat; four members that fit one body only have as much.
_MARGIN = 6.0


@dataclass
class Linker:
    """Links between spaces, and their memory."""

    config: LinkingConfig = field(metadata=NOT_KEPT)
    """The calibration of each camera by name of its space."""
    links: dict[int, int] = field(default_factory=dict)
    """The body of each linked hypothesis of an image, both by id."""
    _due_ns: int | None = field(default=None, metadata=NOT_KEPT)

    def __post_init__(self) -> None:
        self._cameras = {space: CameraModel(camera) for space, camera in self.config.cameras.items()}

    def linked(
        self, update: HypothesisUpdate, parts: Sequence[SpaceUpdate], *, deciding: bool = True
    ) -> HypothesisUpdate:
        """Return the update with `linked` filled in, where there is something to say.

        Unless `deciding`, the links stay what they are.
        """
        if not self._cameras:
            return update
        space = {h.id: h.space for h in update.hypotheses}
        if deciding and (self._due_ns is None or update.stamp_ns >= self._due_ns):
            self._due_ns = update.stamp_ns + _PERIOD_NS
            self._look(parts)
        # Between listed hypotheses alone; what a snapshot brings may be of another calibration.
        linkable = {(name, camera.frame) for name, camera in self._cameras.items()}
        self.links = {
            image: body
            for image, body in self.links.items()
            if (space.get(image), space.get(body)) in linkable
        }
        # The hypotheses of several cameras may have one body.
        same: dict[int, list[int]] = {}
        for image, body in self.links.items():
            same[image] = same.setdefault(body, [body])
            same[image].append(image)
        linked = {
            one: sorted(other for other in group if space[other] != space[one]) for one, group in same.items()
        }
        hypotheses = [replace(h, linked=linked[h.id]) if h.id in linked else h for h in update.hypotheses]
        return replace(update, hypotheses=hypotheses)

    def _look(self, parts: Sequence[SpaceUpdate]) -> None:
        """Decide anew for every hypothesis of every camera."""
        frames = {camera.frame for camera in self._cameras.values()}
        bodies = {part.spec.name: _bodies(part) for part in parts if part.spec.name in frames}
        for part in parts:
            camera = self._cameras.get(part.spec.name)
            if camera is None or part.spec.unit != "px" or part.spec.dim != 2:
                continue
            if moving := bodies.get(camera.frame):
                self._link(part, moving, camera)

    def _link(self, part: SpaceUpdate, bodies: dict[int, BodyMotion], camera: CameraModel) -> None:
        """Decide anew for every hypothesis of one camera, by its longest observed members."""
        observed, all_labels = part.window.counts(part.slots), part.tracks["label"]
        chosen = (all_labels >= 0) & (ranks(all_labels, -observed) < _REPRESENTATIVES)
        ids, motions, labels = list(bodies), list(bodies.values()), all_labels[chosen]
        tracks = sample_tracks(part.window, part.slots[chosen], motions[0].stamps, camera)
        fittable, likelihoods = tracks.seen.sum(1) >= _LEAST_STATES, log_likelihoods(tracks, motions, camera)
        for image in np.unique(labels).tolist():
            previous = self.links.pop(image, None)
            column = ids.index(previous) if previous in ids else None
            best = _decide(_body_evidence(likelihoods[fittable & (labels == image)]), column)
            if best is not None:
                self.links[image] = ids[best]


def _bodies(part: SpaceUpdate) -> dict[int, BodyMotion]:
    """Motion of the hypotheses that a metric space lists, by id; what does not move rests.

    What a fit to the members of a body at rest says of their motion is noise.
    """
    if part.spec.dim != 3:
        return {}
    moving = {h.id for h in part.bodies if h.state == "moving"}
    motions = part.motions([h.id for h in part.bodies]).items()
    return {number: motion if number in moving else motion.at_rest() for number, motion in motions}


def _body_evidence(log_likelihood: Floats) -> Floats:
    """Evidence of members for each body and, last, for none of them, nats, float64 [K + 1]; of [n, K + 1].

    Each member is on the body, or an outlier: a few must not decide.
    """
    best = log_likelihood.max(1, keepdims=True, initial=-np.inf)
    mixture = (1 - _OUTLIER_SHARE) * np.exp(log_likelihood - best) + _OUTLIER_SHARE
    return np.asarray(np.log(mixture).sum(0))


def _decide(evidence: Floats, previous: int | None) -> int | None:
    """Column of the body that a hypothesis is linked to by evidence float64 [K + 1], or None.

    Motion alone decides: the body must beat every other body, a resting one among them if it moves, and
    "none of them", by the margin. Where nothing moves, all bodies explain the members equally well, and
    there is no new link. A link, to the column `previous`, holds until something beats it by as much.
    """
    if previous is not None and evidence.max() < evidence[previous] + _MARGIN:
        return previous
    best = int(evidence.argmax())
    others = np.delete(evidence, best)
    if best == len(evidence) - 1 or len(evidence) < 3 or evidence[best] < others.max() + _MARGIN:
        return None
    return best
