"""The rules of the default method in metric spaces, and how each is left out."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np

from comotion import FusionConfig


@dataclass(frozen=True)
class Rule:
    """A rule, term or group of constants.

    Attributes
    ----------
    what
        What is left out, in a line.
    changes
        By "module.attribute", within ``comotion.rigid``: what stands there instead. No constants of kernels,
        which are compiled in.
    parameters
        Parameters of the group `rigid` that switch it off.
    """

    what: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def config(self) -> FusionConfig:
        """The parameters without the rule."""
        return FusionConfig.model_validate({"rigid": dict(self.parameters)})

    @contextmanager
    def left_out(self) -> Iterator[None]:
        """Leave the rule out in this process for as long as the context lasts."""
        places = []
        for path, value in self.changes.items():
            name, attribute = path.rsplit(".", 1)
            module = import_module(f"comotion.rigid.{name}")
            places.append((module, attribute, getattr(module, attribute)))
            setattr(module, attribute, value)
        try:
            yield
        finally:
            for module, attribute, value in places:
                setattr(module, attribute, value)


def _no_costs(scene: Any, owners: list[Any], *_: Any) -> Any:
    return np.zeros((len(scene.before), len(owners)))


def _only_white(_tracks: Any, _y: Any, _w: Any, owner: Any, tolerance: Any, *_: Any) -> Any:
    return tolerance, np.tile([1.0, 0.0, 0.0], (len(owner), 1))


def _no_sliders(_frames: Any, _bodies: Any, body: Any, *_: Any) -> Any:
    return body, np.zeros(body.shape, np.bool_)


def _as_they_are(_scene: Any, labels: Any) -> Any:
    return labels


def _unsettled(_frames: Any, body: Any, _config: Any) -> Any:
    return body


def _free(_middle: Any, _place: Any, _turn: Any, moving: Any, *_: Any) -> float:
    return float(np.count_nonzero(moving))


RULES: dict[str, Rule] = {
    "contact": Rule("slack of what rests and is touched", parameters={"rigidity_contact": 0.0}),
    "past_evidence": Rule("price of leaving a separate hypothesis", {"selection.past_evidence": _no_costs}),
    "clear_members": Rule("price of leaving for clear members", {"method.carried_costs": _no_costs}),
    "stay": Rule("preference to stay", parameters={"stay": 0.0}),
    "membership": Rule("price of memberships", parameters={"membership_price": 0.0}),
    "slow_noise": Rule("slow noise", {"resampling._with_slow_noise": _only_white}),
    "looseness": Rule("tolerance of soft bodies", parameters={"looseness": 0.0}),
    "rest_share": Rule("what rest gains by a body's tolerance", {"costs._REST_SHARE": 0.0}),
    "contradiction": Rule("nats that speak against a body", {"belief._CONTRARY": 0.0}),
    "past_factor": Rule("more for the past than a body costs", {"belief._PAST_FACTOR": 1.0}),
    "uncovered": Rule("more than an outlier where a body has no pose", {"costs._UNCOVERED_SHARE": 0.5}),
    "place": Rule("spatial prior", parameters={"prior_weight": 0.0}),
    "sliding": Rule("features that slide", {"costs.with_sliders": _no_sliders}),
    "arrivals": Rule("newborn amid newborn wait", {"method.undecided": _as_they_are}),
    "settled": Rule("one pose for each rest, smooth paths", {"method.settled": _unsettled}),
    "paths": Rule("smooth paths between rests", {"rest.smooth_poses": _free}),
    "motion_gain": Rule(
        "in large scenes, worth by motion alone",
        {"method.moving_bodies": lambda _f, b, *_: list(range(len(b)))},
    ),
}
"""By name."""
