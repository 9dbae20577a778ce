"""State of a fusion as bytes, so that a restart keeps hypotheses and their ids."""

from typing import TYPE_CHECKING, Any, TypeVar

from comotion_schemas import Event

from .archive import pack, unpack
from .config import FusionConfig
from .partition import SpaceSpec

if TYPE_CHECKING:
    from .fusion import Fusion

    F = TypeVar("F", bound=Fusion)

FORMAT = "comotion.Snapshot/2"
# A crash may come after ids were handed out that no snapshot has seen; ids are never reused.
_ID_GAP = 1000


def dump(fusion: "Fusion", *, clean: bool) -> bytes:
    """Serialise what must survive; batches still waiting behind the watermark are not kept."""
    return pack(
        {
            "format": FORMAT,
            "method": fusion.config.method,
            "scene": fusion.scene,
            "session": fusion.session,
            "next_id": fusion.ids.following + (0 if clean else _ID_GAP),
            "next_session": fusion.next_session,
            "sessions": [[name, session, index] for (name, session), index in fusion.sessions.items()],
            "timeline": fusion.timeline.state(),
            "events": [
                {"stamp_ns": e.stamp_ns, "kind": e.kind, "hypothesis": e.hypothesis, "others": e.others}
                for e in fusion.events
            ],
            "links": fusion.linker.state(),
            "spaces": [space.state() for space in fusion.spaces.values()],
        }
    )


def load(kind: "type[F]", config: FusionConfig, data: bytes, session: str | None) -> "F":
    """Build a fusion from :func:`dump`.

    Raises
    ------
    ValueError
        If `data` is no snapshot of this version, or damaged.
    """
    state = unpack(data)
    if state.get("format") != FORMAT:
        raise ValueError(f"not a snapshot: format {str(state.get('format'))[:40]!r}, expected {FORMAT!r}")
    try:
        return _build(kind, config, state, session)
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"damaged snapshot: {type(error).__name__} {error}") from None


def _build(kind: "type[F]", config: FusionConfig, state: dict[str, Any], session: str | None) -> "F":
    fusion = kind(config, scene=state["scene"], session=session or state["session"])
    fusion.ids.following = int(state["next_id"])
    fusion.next_session = int(state["next_session"])
    fusion.sessions = {(name, owner): index for name, owner, index in state["sessions"]}
    fusion.timeline.load(state["timeline"])
    fusion.events.extend(Event(**event) for event in state["events"])
    # Snapshots of before there were links have none.
    fusion.linker.load(state.get("links", []))
    for part in state["spaces"]:
        space = fusion.open_space(SpaceSpec(part["name"], part["unit"], int(part["dim"])))
        # The trajectories serve every method; what a method knows is its own.
        space.load(part, keep_method=state["method"] == config.method)
    return fusion
