"""False joints: how long bodies that move freely are said to be connected."""

from collections.abc import Collection, Iterable, Mapping

from comotion import FusionConfig
from comotion_clients.metrics import Score, Truth
from comotion_schemas import HypothesisUpdate, Joint
from comotion_sources import simulator

from ..offline import Message, run_offline
from .features import KINDS, main_objects

SCENES = ("fig4_4", "3d_3", "3d_5", "3d_late", "3d_rotation")
# The bar of fig. 4.4 turns about a point of the ground at rest: that is a hinge.
TRUE_HINGES = {"fig4_4": (frozenset({"R", "P"}),)}


def longest_false_joint(scene: str, seed: int) -> float:
    """Longest time in s for which one pair of hypotheses of different objects had a joint without a break."""
    run = simulator.simulate(simulator.load_scene(scene), seed=seed)
    return longest_joint(simulator.batches(run), TRUE_HINGES.get(scene, ()))


def longest_joint(messages: Iterable[Message], hinges: Collection[frozenset[str]] = ()) -> float:
    """Longest time in s of a joint between hypotheses of different objects.

    Parameters
    ----------
    messages
        Of an offline run.
    hinges
        Names of objects that a joint does connect; they are left out.
    """
    truth = Truth()
    since: dict[tuple[int, int], int] = {}
    longest = 0.0

    def on_update(update: HypothesisUpdate, _: Score) -> None:
        nonlocal since, longest
        main = main_objects(update, truth)
        pairs = [
            (j.parent, j.child)
            for j in update.joints
            if j.kind in KINDS
            and main.get(j.parent, -1) != main.get(j.child, -1)
            and _names(truth, main, j) not in hinges
        ]
        since = {pair: since.get(pair, update.stamp_ns) for pair in pairs}
        longest = max([longest, *((update.stamp_ns - begun) * 1e-9 for begun in since.values())])

    run_offline(messages, FusionConfig(), truth=truth, on_update=on_update)
    return longest


def _names(truth: Truth, main: Mapping[int, int], joint: Joint) -> frozenset[str]:
    """Names of the objects that a joint is between."""
    return frozenset(truth.names.get(main.get(one, -1), "") for one in (joint.parent, joint.child))
