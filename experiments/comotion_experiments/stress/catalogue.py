"""Every family by name: how its scenes are made, and with which parameters."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from comotion_schemas.errors import KnownError

from . import bodies, events, features
from .image_experiment import IMAGE_FAMILIES, ImageFamily
from .scene import Scene


@dataclass(frozen=True)
class Family:
    """A kind of stress.

    Attributes
    ----------
    name, group, title
        What it is called, where it is listed, and one line on what happens.
    make
        Scenes of a seed; keywords are its parameters.
    parameters
        Those that differ from the defaults of `make`.
    slow
        Left out of a quick run.
    """

    name: str
    group: str
    title: str
    make: Callable[..., list[Scene]]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    slow: bool = False

    def scenes(self, seed: int, **overrides: Any) -> list[Scene]:
        """Make the scenes of a seed; the same for the same seed and parameters."""
        return self.make(seed, **{**self.parameters, **overrides})


_ROWS: dict[str, list[tuple[str, str, Callable[..., list[Scene]], dict[str, Any]]]] = {
    "events": [
        ("restart", "tracker restarts, new session", events.restart, {}),
        ("cover_1s", "all features lost for 1 s", events.cover, {"seconds": 1.0}),
        ("cover_3s", "all features lost for 3 s", events.cover, {"seconds": 3.0}),
        ("rebirth_50", "half of the features reborn at once", events.rebirth, {"share": 0.5}),
        ("rebirth_80", "four fifths reborn at once", events.rebirth, {"share": 0.8}),
        ("rebirth_100", "all reborn at once", events.rebirth, {"share": 1.0}),
        ("loop", "a replay jumps back, new session", events.loop, {}),
        ("late_start", "joins 15, 30 and 100 Hz late", events.late_start, {}),
        (
            "late_start_rough",
            "likewise, 5 mm, 1°, 10 ms wrong",
            events.late_start,
            {"mm": 5.0, "degrees": 1.0, "ms": 10.0},
        ),
        ("source_joins", "a second source joins", events.source_joins, {}),
        ("source_leaves", "one of two sources is away for 4 s", events.source_leaves, {}),
        ("clock_step_ahead", "a clock is set 0.2 s ahead", events.clock_step, {"step": 0.2}),
        ("clock_step_back", "a clock is set 0.2 s back", events.clock_step, {"step": -0.2}),
    ],
    "features": [
        ("short_lives_15", "lives of 0.3 to 1 s, 15 Hz", features.short_lives, {"rate": 15.0}),
        ("short_lives_30", "lives of 0.3 to 1 s, 30 Hz", features.short_lives, {"rate": 30.0}),
        ("renewal_15", "30 % replaced a second, 15 Hz", features.renewal, {"rate": 15.0}),
        ("renewal_30", "30 % replaced a second, 30 Hz", features.renewal, {"rate": 30.0}),
        ("drift_static", "static, features walk 2 mm/√s", features.drift, {}),
        ("drift_slow", "static, features creep 1 mm/s", features.drift, {"walk": 0.0, "speed": 0.001}),
        ("drift_fast", "static, features creep 2 mm/s", features.drift, {"walk": 0.0, "speed": 0.002}),
        ("drift_moving", "three bodies, features walk 2 mm/√s", features.drift, {"bodies": 3}),
        ("sliding", "three in ten slide along edges", features.sliding, {}),
        ("correlated_static", "static, noise correlated over 0.2 s", features.correlated, {"seconds": 0.2}),
        ("correlated_long", "static, noise correlated over 0.5 s", features.correlated, {}),
        ("correlated_moving", "three bodies, noise correlated", features.correlated, {"bodies": 3}),
        ("noise_15mm", "noise of 15 mm", features.heavy, {"sigma": 0.015}),
        ("outliers", "5 % of the samples wild", features.heavy, {"outliers": 0.05}),
        ("depth_noise", "10 mm along the ray at 2 m", features.heavy, {"depth": 0.0025, "sigma": 0.002}),
        ("rgbd_rest_1", "RGB-D at rest, noise along the ray x 1", features.depth_camera, {"ratio": 1.0}),
        ("rgbd_rest_3", "RGB-D at rest, noise along the ray x 3", features.depth_camera, {"ratio": 3.0}),
        ("rgbd_rest_5", "RGB-D at rest, noise along the ray x 5", features.depth_camera, {"ratio": 5.0}),
        ("rgbd_rest_10", "RGB-D at rest, noise along the ray x 10", features.depth_camera, {"ratio": 10.0}),
        (
            "rgbd_rest_flying",
            "likewise x 5, 1 % flying pixels",
            features.depth_camera,
            {"ratio": 5.0, "flying": 0.01},
        ),
        ("rgbd_bodies_1", "RGB-D, three bodies, x 1", features.depth_camera, {"bodies": 3, "ratio": 1.0}),
        ("rgbd_bodies_3", "RGB-D, three bodies, x 3", features.depth_camera, {"bodies": 3, "ratio": 3.0}),
        ("rgbd_bodies_5", "RGB-D, three bodies, x 5", features.depth_camera, {"bodies": 3, "ratio": 5.0}),
        ("rgbd_bodies_10", "RGB-D, three bodies, x 10", features.depth_camera, {"bodies": 3, "ratio": 10.0}),
        (
            "rgbd_bodies_flying",
            "likewise x 5, 1 % flying pixels",
            features.depth_camera,
            {"bodies": 3, "ratio": 5.0, "flying": 0.01},
        ),
        (
            "rgbd_bodies_told",
            "likewise x 10, covariance published",
            features.depth_camera,
            {"bodies": 3, "ratio": 10.0, "published": True},
        ),
        ("gaps", "every feature hidden now and then", features.gaps, {}),
    ],
    "bodies": [
        ("rest", "all rest for 14 s", bodies.rest, {}),
        ("late_movers", "start one after the other", bodies.late_movers, {}),
        ("stop_and_go_2min", "two minutes of stop and go", bodies.stop_and_go, {}),
        ("slow", "ten times slower", bodies.slow, {}),
        ("slowed_4_4", "figure 4.4, five times slower", bodies.slowed_figure, {}),
        ("soft", "soft by 10 mm", bodies.soft, {}),
        ("hinge", "a door opens by 10°", bodies.hinge, {}),
        ("hinge_5mm", "likewise, noise of 5 mm", bodies.hinge, {"sigma": 0.005}),
        ("arm", "two links in a chain", bodies.arm, {}),
        ("coupled", "two move as one, then apart", bodies.coupled_pair, {}),
        ("object_cover", "each object hidden for 3 s", bodies.object_cover, {}),
    ],
    "ten minutes": [
        (
            "stop_and_go_10min",
            "ten minutes of stop and go",
            bodies.stop_and_go,
            {"duration": 600.0, "rate": 10.0, "period": 0.5},
        ),
        ("ten_minutes", "moving, objects hidden for 2 s", bodies.ten_minutes, {}),
    ],
}

FAMILIES: dict[str, Family] = {
    name: Family(name, group, title, make, parameters, slow=group == "ten minutes")
    for group, rows in _ROWS.items()
    for name, title, make, parameters in rows
}


AnyFamily: TypeAlias = Family | ImageFamily
ALL: dict[str, AnyFamily] = {**FAMILIES, **IMAGE_FAMILIES}


def find_families(names: Sequence[str] = (), *, quick: bool = False) -> list[AnyFamily]:
    """Look up families; a name also stands for all that begin with it and an underscore.

    Raises
    ------
    ValueError
        If a name fits none.
    """
    if not names:
        return [family for family in ALL.values() if not (quick and family.slow)]
    chosen: dict[str, AnyFamily] = {}
    for name in names:
        fitting = {k: f for k, f in ALL.items() if k == name or k.startswith(f"{name}_")}
        if not fitting:
            raise KnownError(f"no family {name!r}; there are {', '.join(ALL)}")
        chosen.update(fitting)
    return list(chosen.values())
