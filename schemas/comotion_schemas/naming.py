"""Names that people give to hypotheses, and joints in words."""

import math
from collections.abc import Iterable, Mapping

from .errors import KnownError
from .hypotheses import Event, EventKind, Joint, JointKind

Names = Mapping[int, str]
"""Name by id of a hypothesis."""

_WORDS: dict[JointKind, str] = {
    "fixed": "is fixed to",
    "prismatic": "slides on",
    "revolute": "turns on",
    "free": "moves freely against",
}
_BETWEEN: dict[EventKind, str] = {"split": "from", "released": "from", "merged": "with", "joined": "with"}
_MOST_CHARACTERS = 40


def read_names(pairs: Iterable[str]) -> dict[int, str]:
    """Names as they are given on a command line, ``2=truck``.

    Raises
    ------
    ValueError
        If one is not an id and a name of at most 40 printable characters.
    """
    names = {}
    for pair in pairs:
        number, _, name = pair.partition("=")
        if not (number.isdecimal() and name and name.isprintable() and len(name) <= _MOST_CHARACTERS):
            raise KnownError(f"{pair[:60]!r} is not an id and a name, like 2=truck")
        names[int(number)] = name
    return names


def named(number: int, names: Names) -> str:
    """Name of a hypothesis; its id where it has none."""
    return names.get(number, str(number))


def event_words(event: Event, names: Names) -> str:
    """An event in words: "drawer split from shelf", "hypothesis 2 born"."""
    who, words = names.get(event.hypothesis, f"hypothesis {event.hypothesis}"), _BETWEEN.get(event.kind)
    if words is None or not event.others:
        return f"{who} {event.kind}"
    return f"{who} {event.kind} {words} {', '.join(named(other, names) for other in event.others)}"


def joint_words(joint: Joint, names: Names | None = None) -> str:
    """A joint in words: "door turns on shelf, 0 to 65°"; with the range seen, in degrees or the unit m."""
    names = names or {}
    words = _WORDS.get(joint.kind)
    if words is None:
        return f"{named(joint.child, names)} and {named(joint.parent, names)}: not known yet"
    words_of_kind = f"{named(joint.child, names)} {words} {named(joint.parent, names)}"
    if joint.lower is None or joint.upper is None or joint.kind not in {"prismatic", "revolute"}:
        return words_of_kind
    if joint.kind == "revolute":
        return f"{words_of_kind}, {math.degrees(joint.lower):.0f} to {math.degrees(joint.upper):.0f}°"
    return f"{words_of_kind}, {joint.lower:.2f} to {joint.upper:.2f} m"
