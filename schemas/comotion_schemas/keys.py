"""Builds and parses the Zenoh keys of a scene, and lists the quality of service of each kind.

All streams drop messages under congestion: with BLOCK one stuck subscriber would stall the others.
"""

import re
from dataclasses import dataclass
from typing import Literal, get_args

from .errors import KnownError
from .messages import Role
from .types import is_name

ROOT = "comotion/@v1"
DEFAULT_SCENE = "default"
TOKEN_NAME_CHARACTERS = 30
"""So much of the name of a service that stands alone is in its token, before claim and session."""

StreamKind = Literal["obs", "truth", "joints", "preview", "status"]
Kind = Literal[StreamKind, "hypotheses"]
QueryName = Literal["snapshot", "status", "config", "affinity", "schema", "forget", "accounts"]
PriorityName = Literal[
    "REAL_TIME", "INTERACTIVE_HIGH", "INTERACTIVE_LOW", "DATA_HIGH", "DATA", "DATA_LOW", "BACKGROUND"
]

_STREAMS = get_args(StreamKind)
TOKEN = re.compile(r"(.+)-([0-9a-f]{16})-([0-9a-f]{16})")
"""Last chunk of the token of a service that stands alone: name, claim in ns and session."""


def _chunk(what: str, name: str) -> str:
    if not is_name(name):
        raise KnownError(f"{what} {name!r} is not 1 to 64 characters of a-z, 0-9, _ and -")
    return name


@dataclass(frozen=True)
class Keys:
    """The keys of one scene.

    Raises
    ------
    ValueError
        If a name of a scene, source or component is not of the form ``[a-z0-9_-]{1,64}``.
    """

    scene: str = DEFAULT_SCENE

    def __post_init__(self) -> None:
        _chunk("scene", self.scene)

    @property
    def prefix(self) -> str:
        """Common prefix of all keys of the scene."""
        return f"{ROOT}/{self.scene}"

    def stream(self, kind: StreamKind, name: str) -> str:
        """Key of one publisher's stream, e.g. ``obs/klt-left``."""
        return f"{self.prefix}/{kind}/{_chunk('name', name)}"

    def streams(self, kind: StreamKind) -> str:
        """Key expression of the streams of all publishers of a kind."""
        return f"{self.prefix}/{kind}/*"

    @property
    def hypotheses(self) -> str:
        """Key of the updates of the service."""
        return f"{self.prefix}/hypotheses"

    def messages(self, kind: Kind) -> str:
        """Key or key expression of all messages of a kind."""
        return self.hypotheses if kind == "hypotheses" else self.streams(kind)

    def live(self, role: Role, name: str) -> str:
        """Key of a liveliness token."""
        return f"{self.prefix}/live/{role}/{_chunk('name', name)}"

    def all_live(self, role: Role | Literal["*"] = "*") -> str:
        """Key expression of the liveliness tokens of a role, or of all roles."""
        return f"{self.prefix}/live/{role}/*"

    def query(self, name: QueryName) -> str:
        """Key of a queryable of the service."""
        return f"{self.prefix}/query/{name}"


def token_name(token: str) -> str:
    """Return the name in a token of a service, cut to 30 characters where a claim follows it."""
    claim = TOKEN.fullmatch(token)
    return claim[1] if claim else token


def kind_of(key: str) -> Kind | None:
    """Return the kind of a key of messages; None for other keys."""
    chunks = key.split("/")
    if not key.startswith(ROOT + "/"):
        return None
    if len(chunks) == 4 and chunks[3] == "hypotheses":
        return "hypotheses"
    kind = chunks[3] if len(chunks) == 5 else ""
    return kind if kind in _STREAMS else None  # type: ignore[return-value]


def publisher_of(key: str) -> str:
    """Return the name in a key of messages or liveliness; the scene for updates of the service."""
    chunks = key.split("/")
    return chunks[2] if len(chunks) == 4 else chunks[-1]


@dataclass(frozen=True, slots=True)
class QoS:
    """Quality of service of one kind of key."""

    message: str  # name of the message type
    priority: PriorityName  # Zenoh priority; lower priorities wait on a full link
    express: bool  # send at once, without batching small messages
    reliable: bool  # request reliable links
    cache: int  # samples that the publisher keeps for late joiners; 0: none
    # Field of the message with the name of its publisher, which must equal that in its key.
    publisher: str = "source"

    @property
    def encoding(self) -> str:
        """Zenoh encoding of the payload."""
        return f"application/msgpack;comotion.{self.message}/1"


QOS: dict[Kind, QoS] = {
    "obs": QoS("ObservationBatch", "INTERACTIVE_HIGH", express=True, reliable=True, cache=0),
    "joints": QoS("JointStates", "INTERACTIVE_HIGH", express=True, reliable=True, cache=0),
    "hypotheses": QoS(
        "HypothesisUpdate", "DATA_HIGH", express=True, reliable=True, cache=1, publisher="scene"
    ),
    "truth": QoS("TruthBatch", "DATA", express=False, reliable=True, cache=4096),
    "status": QoS("Status", "DATA_LOW", express=False, reliable=True, cache=1, publisher="component"),
    "preview": QoS("Preview", "BACKGROUND", express=False, reliable=False, cache=0),
}

HEARTBEAT_S = 0.5
"""Heartbeat of cached publishers; without it several publishers in one session lose their last samples."""
