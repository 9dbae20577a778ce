"""Image families: by name, and how well the pixel method groups their features with K unknown."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from comotion.config import PixelsConfig

from ..pixels.benchmark import score
from ..pixels.methods import engine, one_object, spectral_interaction
from ..pixels.sequences import Sequence
from ..tables import means
from .images import ImageParameters, image_sequences

IMAGES = "images"
"""The group of all image families."""
_STRONG = {"camera_speed": (0.4, 0.8), "camera_spin": (5.0, 15.0), "depth": (1.2, 6.0)}
_LOW_NOISE = {"sigma": 0.05, "drift": 0.04}
_TELE = {"zoom": (2.0, 6.0), "depth": (1.5, 3.0), "speed": (0.05, 0.2), "spin": (2.0, 20.0), **_LOW_NOISE}
_STILL = {"camera_speed": (0.0, 0.0), "camera_spin": (0.0, 0.0)}


@dataclass(frozen=True)
class ImageFamily:
    """A kind of image sequences; `parameters` are those of :class:`~.images.ImageParameters`.

    The other attributes are as those of :class:`~.catalogue.Family`.
    """

    name: str
    title: str
    parameters: Mapping[str, Any]
    group: str = IMAGES
    slow: bool = False

    def sequences(self, seed: int, **overrides: Any) -> list[Sequence]:
        """Make the sequences of a seed; the same for the same seed and parameters."""
        return image_sequences(seed, self.name, ImageParameters(**{**self.parameters, **overrides}))


@dataclass(frozen=True)
class ImageFigures:
    """Means over sequences.

    Attributes
    ----------
    error
        Misclassified features, per cent; undetermined ones are wrong.
    nmi
        Against the truth.
    exact, over, under
        Share of sequences with the right number of objects, with more, with fewer.
    found, true
        Mean numbers of objects.
    given, one
        Error of spectral clustering of shape interaction, with K given, and of one object for all.
    ms
        Median time of the update.
    """

    error: float
    nmi: float
    exact: float
    over: float
    under: float
    found: float
    true: float
    given: float
    one: float
    ms: float


@dataclass(frozen=True)
class ImageOutcome:
    """One seed of an image family: means, and the error of each sequence in per cent."""

    family: str
    seed: int
    figures: ImageFigures
    errors: list[float]


_ROWS: dict[str, tuple[str, dict[str, Any]]] = {
    "image_plain": ("two bodies, camera moves", {}),
    "image_strong": ("strong camera motion, background in depth", _STRONG),
    "image_single": ("likewise without bodies", {**_STRONG, "bodies": (0, 0)}),
    "image_static_camera": ("the camera rests", _STILL),
    "image_still": ("all rests, noise only", {**_STILL, "bodies": (0, 0)}),
    "image_few": (
        "39 to 94 features, little relative motion",
        {
            "features": (10, 24),
            "background": (25, 46),
            "bodies": (1, 2),
            "speed": (0.05, 0.15),
            "spin": (2.0, 15.0),
            "camera_speed": (0.1, 0.3),
        },
    ),
    "image_rotation": (
        "bodies turn by 50 to 120°/s, features end",
        {"spin": (50.0, 120.0), "complete": False, "frames": 40},
    ),
    "image_axial": (
        "the camera drives ahead, others drive too",
        {
            "axial": True,
            "camera_speed": (4.0, 10.0),
            "depth": (10.0, 40.0),
            "speed": (0.3, 1.0),
            "spin": (0.0, 10.0),
            "complete": False,
        },
    ),
    "image_planar": ("bodies and background are planes", {"flat": True}),
    "image_translation": ("nothing turns", {"spin": (0.0, 0.0), "camera_spin": (0.0, 0.0)}),
    "image_gaps": (
        "features end, begin late, are hidden",
        {"complete": False, "returns": True, "dropout": 0.4, "frames": 45},
    ),
    "image_tele": (
        "weak perspective, low noise, features drift",
        {**_TELE, "camera_speed": (0.2, 1.5)},
    ),
    "image_tele_static": ("likewise, the camera rests", {**_TELE, **_STILL, "speed": (0.05, 0.3)}),
    "image_tele_translation": (
        "likewise, nothing turns",
        {**_TELE, "spin": (0.0, 0.0), "camera_spin": (0.0, 0.0), "camera_speed": (0.2, 1.5)},
    ),
    "image_dense": (
        "many features on nearer bodies, strong camera motion, features drift",
        {
            **_STRONG,
            "features": (40, 150),
            "background": (150, 300),
            "bodies": (1, 3),
            "spin": (2.0, 20.0),
            "depth": (1.2, 3.0),
            **_LOW_NOISE,
        },
    ),
    "image_many": ("four or five bodies", {"bodies": (4, 5), "features": (20, 40)}),
}

IMAGE_FAMILIES = {name: ImageFamily(name, title, parameters) for name, (title, parameters) in _ROWS.items()}


def run_image_family(
    name: str, seed: int, parameters: PixelsConfig | None = None, **overrides: Any
) -> ImageOutcome:
    """Group every sequence of a family's seed with one update at its end.

    Parameters
    ----------
    name, seed
        Of the family.
    parameters
        Of the pixel method.
    overrides
        Parameters of the family.
    """
    sequences = IMAGE_FAMILIES[name].sequences(seed, **overrides)
    rows = [_scored(sequence, parameters or PixelsConfig()) for sequence in sequences]
    figures = ImageFigures(**means(rows) | {"ms": float(np.median([row.ms for row in rows]))})
    return ImageOutcome(name, seed, figures, [row.error for row in rows])


def _scored(sequence: Sequence, parameters: PixelsConfig) -> ImageFigures:
    labels, seconds = engine(sequence, parameters)
    true, found = sequence.objects(), len(np.unique(labels[labels >= 0]))
    ours = score(sequence, labels, seconds)
    return ImageFigures(
        error=ours.error,
        nmi=ours.nmi,
        exact=float(found == true),
        over=float(found > true),
        under=float(found < true),
        found=float(found),
        true=float(true),
        given=score(sequence, spectral_interaction(sequence)).error,
        one=score(sequence, one_object(sequence)).error,
        ms=1e3 * seconds,
    )
