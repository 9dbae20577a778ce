"""Recordings of people with labelled segments: what is said of their elbows and knees."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from comotion import FusionConfig
from comotion_clients.metrics import Score, Truth
from comotion_schemas import HypothesisUpdate
from comotion_sources.recordings import read_recording, recording_batches

from ..offline import run_offline
from ..tables import Table
from .features import main_objects

# Names of the two segments that meet at a joint, as recordings call them.
ANATOMY = {
    "elbow": (("LAR", "LFA"), ("RAR", "RFA"), ("Lupperarm", "Lforearm"), ("Rupperarm", "Rforearm")),
    "knee": (("LTH", "LSK"), ("RTH", "RSK"), ("Lthigh", "Lshank"), ("Rthigh", "Rshank")),
}
_SECONDS = 60.0


@dataclass
class Person:
    """One recording.

    `kinds`: updates with each kind, by joint of the body; `others`: the same for all other pairs of segments;
    `apart`: updates in which the two segments had a hypothesis each, by joint; `updates`: all of them.
    """

    name: str
    updates: int = 0
    apart: Counter[str] = field(default_factory=Counter)
    kinds: dict[str, Counter[str]] = field(default_factory=dict)
    others: Counter[str] = field(default_factory=Counter)


def run_person(path: Path) -> Person:
    """Run the first minute of a recording with the default method."""
    found, truth = Person(path.stem), Truth()

    def on_update(update: HypothesisUpdate, _: Score) -> None:
        found.updates += 1
        segments = {one: truth.names.get(number, "") for one, number in main_objects(update, truth).items()}
        _note(found, update, segments)

    recording = recording_batches(read_recording(str(path)))
    run_offline(recording, FusionConfig(), truth=truth, duration=_SECONDS, on_update=on_update)
    return found


def _note(found: Person, update: HypothesisUpdate, segments: Mapping[int, str]) -> None:
    present = set(segments.values())
    for name, pairs in ANATOMY.items():
        found.apart[name] += sum(present.issuperset(pair) for pair in pairs)
    for joint in update.joints:
        pair = {segments.get(joint.parent, ""), segments.get(joint.child, "")}
        if len(pair) < 2 or "" in pair:
            continue
        known = next((n for n, pairs in ANATOMY.items() if any(pair == set(two) for two in pairs)), None)
        counter = found.others if known is None else found.kinds.setdefault(known, Counter())
        counter[joint.kind] += 1


def table(people: list[Person]) -> str:
    """Markdown table: share of the updates with an entry in which it is of each kind, percent."""
    kinds = ("revolute", "undetermined", "free", "fixed", "prismatic")
    seen = ("pairs with two hypotheses, per update", "entries per update")
    drawn = Table(("recording", "joint", *seen, *(f"{kind}, %" for kind in kinds)), words=2)
    for one in people:
        rows = [(name, one.kinds.get(name, Counter()), one.apart[name]) for name in ANATOMY]
        for name, counter, apart in [*rows, ("other pairs", one.others, -1)]:
            total = sum(counter.values())
            if not total:
                continue
            pairs = "-" if apart < 0 else f"{apart / one.updates:.2f}"
            shares = (f"{100 * counter[kind] / total:.0f}" for kind in kinds)
            drawn.add(one.name, name, pairs, f"{total / one.updates:.2f}", *shares)
    return drawn.markdown()
