"""Every family by name: how its scenes or image sequences are made, and with which parameters."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

from comotion_schemas.errors import KnownError

from . import bodies, events, features
from .images import image_sequences

IMAGES, TEN_MINUTES = "images", "ten minutes"
_STATIC = {"bodies": 0, "background_features": 40}
# What an RGB-D camera sees: its noise along the ray is a multiple of that across it.
_RGBD = {"background_features": 40, "features": 12, "sigma": 0.0015, "duration": 12.0}
_AT_REST = {**_RGBD, "bodies": 0}
_STRONG = {"camera_speed": (0.4, 0.8), "camera_spin": (5.0, 15.0), "depth": (1.2, 6.0)}
_LOW_NOISE = {"sigma": 0.05, "drift": 0.04}
_TELE = {"zoom": (2.0, 6.0), "depth": (1.5, 3.0), "speed": (0.05, 0.2), "spin": (2.0, 20.0), **_LOW_NOISE}
_STILL = {"camera_speed": (0.0, 0.0), "camera_spin": (0.0, 0.0)}


Make: TypeAlias = Callable[..., list[Any]]


@dataclass(frozen=True)
class Family:
    """A kind of stress.

    Attributes
    ----------
    name, group, title
        What it is called, where it is listed, and one line on what happens.
    make
        Scenes of a seed, or image sequences; keywords are its parameters.
    parameters
        Those that differ from the defaults of `make`.
    """

    name: str
    group: str
    title: str
    make: Make
    parameters: Mapping[str, Any]

    @property
    def slow(self) -> bool:
        """Whether a quick run leaves it out."""
        return self.group == TEN_MINUTES

    @property
    def of_images(self) -> bool:
        """Whether it makes image sequences, which the pixel method groups at once."""
        return self.group == IMAGES

    def scenes(self, seed: int, **overrides: Any) -> list[Any]:
        """Make the scenes or sequences of a seed; the same for the same seed and parameters."""
        return self.make(seed=seed, **{**self.parameters, **overrides})


_IMAGES: dict[str, tuple[str, dict[str, Any]]] = {
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

_ROWS: dict[str, dict[Make, list[tuple[str, str, dict[str, Any]]]]] = {
    "events": {
        events.lost: [
            ("restart", "tracker restarts, new session", {"seconds": 0.3, "restarts": True}),
            ("cover_1s", "all features lost for 1 s", {"seconds": 1.0, "duration": 16.0}),
            ("cover_3s", "all features lost for 3 s", {"seconds": 3.0, "duration": 16.0}),
            ("rebirth_50", "half of the features reborn at once", {"share": 0.5}),
            ("rebirth_80", "four fifths reborn at once", {"share": 0.8}),
            ("rebirth_100", "all reborn at once", {}),
        ],
        events.loop: [("loop", "a replay jumps back, new session", {})],
        events.late_start: [
            ("late_start", "joins 15, 30 and 100 Hz late", {}),
            ("late_start_rough", "likewise, 5 mm, 1°, 10 ms wrong", {"mm": 5.0, "degrees": 1.0, "ms": 10.0}),
        ],
        events.two_sources: [
            ("source_joins", "a second source joins", {"joins": True, "duration": 14.0}),
            ("source_leaves", "one of two sources is away for 4 s", {"away": 4.0}),
            ("clock_step_ahead", "a clock is set 0.2 s ahead", {"step": 0.2}),
            ("clock_step_back", "a clock is set 0.2 s back", {"step": -0.2}),
        ],
    },
    "features": {
        features.short_lives: [
            ("short_lives_15", "lives of 0.3 to 1 s, 15 Hz", {"rate": 15.0}),
            ("short_lives_30", "lives of 0.3 to 1 s, 30 Hz", {"rate": 30.0}),
        ],
        features.renewal: [
            ("renewal_15", "30 % replaced a second, 15 Hz", {"rate": 15.0}),
            ("renewal_30", "30 % replaced a second, 30 Hz", {"rate": 30.0}),
        ],
        features.drift: [
            ("drift_static", "static, features walk 2 mm/√s", {}),
            ("drift_slow", "static, features creep 1 mm/s", {"walk": 0.0, "speed": 0.001}),
            ("drift_fast", "static, features creep 2 mm/s", {"walk": 0.0, "speed": 0.002}),
            ("drift_moving", "three bodies, features walk 2 mm/√s", {"bodies": 3}),
        ],
        features.sliding: [("sliding", "three in ten slide along edges", {})],
        features.noisy: [
            ("correlated_static", "static, noise correlated over 0.2 s", {**_STATIC, "correlation": 0.2}),
            ("correlated_long", "static, noise correlated over 0.5 s", {**_STATIC, "correlation": 0.5}),
            (
                "correlated_moving",
                "three bodies, noise correlated",
                {"features": 8, "background_features": 40, "correlation": 0.5},
            ),
            ("noise_15mm", "noise of 15 mm", {"sigma": 0.015}),
            ("outliers", "5 % of the samples wild", {"outliers": 0.05}),
            ("depth_noise", "10 mm along the ray at 2 m", {"depth": 0.0025, "sigma": 0.002}),
            ("rgbd_rest_1", "RGB-D at rest, noise along the ray x 1", {**_AT_REST, "ray": 1.0}),
            ("rgbd_rest_3", "RGB-D at rest, noise along the ray x 3", {**_AT_REST, "ray": 3.0}),
            ("rgbd_rest_5", "RGB-D at rest, noise along the ray x 5", {**_AT_REST, "ray": 5.0}),
            ("rgbd_rest_10", "RGB-D at rest, noise along the ray x 10", {**_AT_REST, "ray": 10.0}),
            ("rgbd_rest_flying", "likewise x 5, 1 % flying pixels", {**_AT_REST, "ray": 5.0, "flying": 0.01}),
            ("rgbd_bodies_1", "RGB-D, three bodies, x 1", {**_RGBD, "ray": 1.0}),
            ("rgbd_bodies_3", "RGB-D, three bodies, x 3", {**_RGBD, "ray": 3.0}),
            ("rgbd_bodies_5", "RGB-D, three bodies, x 5", {**_RGBD, "ray": 5.0}),
            ("rgbd_bodies_10", "RGB-D, three bodies, x 10", {**_RGBD, "ray": 10.0}),
            ("rgbd_bodies_flying", "likewise x 5, 1 % flying pixels", {**_RGBD, "ray": 5.0, "flying": 0.01}),
            (
                "rgbd_bodies_told",
                "likewise x 10, covariance published",
                {**_RGBD, "ray": 10.0, "published": True},
            ),
        ],
        features.gaps: [("gaps", "every feature hidden now and then", {})],
    },
    "bodies": {
        bodies.rest: [("rest", "all rest for 14 s", {})],
        bodies.late_movers: [("late_movers", "start one after the other", {})],
        bodies.stop_and_go: [("stop_and_go_2min", "two minutes of stop and go", {})],
        bodies.slow: [("slow", "ten times slower", {})],
        bodies.slowed_figure: [("slowed_4_4", "figure 4.4, five times slower", {})],
        bodies.soft: [("soft", "soft by 10 mm", {})],
        bodies.hinge: [
            ("hinge", "a door opens by 10°", {}),
            ("hinge_5mm", "likewise, noise of 5 mm", {"sigma": 0.005}),
        ],
        bodies.arm: [("arm", "two links in a chain", {})],
        bodies.coupled_pair: [("coupled", "two move as one, then apart", {})],
        bodies.object_cover: [("object_cover", "each object hidden for 3 s", {})],
    },
    TEN_MINUTES: {
        bodies.stop_and_go: [
            (
                "stop_and_go_10min",
                "ten minutes of stop and go",
                {"duration": 600.0, "rate": 10.0, "period": 0.5},
            ),
        ],
        bodies.ten_minutes: [("ten_minutes", "moving, objects hidden for 2 s", {})],
    },
    IMAGES: {partial(image_sequences, name): [(name, *row)] for name, row in _IMAGES.items()},
}

FAMILIES = {
    name: Family(name, group, title, make, parameters)
    for group, makes in _ROWS.items()
    for make, rows in makes.items()
    for name, title, parameters in rows
}


def find_families(names: Sequence[str] = (), *, quick: bool = False) -> list[Family]:
    """Look up families; a name also stands for all that begin with it and an underscore.

    Raises
    ------
    ValueError
        If a name fits none.
    """
    if not names:
        return [family for family in FAMILIES.values() if not (quick and family.slow)]
    chosen: dict[str, Family] = {}
    for name in names:
        fitting = {k: f for k, f in FAMILIES.items() if k == name or k.startswith(f"{name}_")}
        if not fitting:
            raise KnownError(f"no family {name!r}; there are {', '.join(FAMILIES)}")
        chosen.update(fitting)
    return list(chosen.values())
