"""Grant: what one certificate allows, and its spelling as URIs in the certificate. Pure."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, cast, get_args

from comotion_schemas.errors import KnownError
from comotion_schemas.tls import ANY_SCENE
from comotion_schemas.types import is_name

CertificateRole = Literal["source", "service", "viewer", "recorder", "router"]
ROLES: tuple[CertificateRole, ...] = get_args(CertificateRole)
DEFAULT_RATE = 250.0
"""Hz; a source that publishes faster packs several instants in one batch."""
_URN = "urn:comotion:"
_COMMON_NAME = re.compile(r"[a-z0-9_.-]{1,64}")


@dataclass(frozen=True, kw_only=True)
class Grant:
    """What the holder of a certificate may do.

    Attributes
    ----------
    role, name
        Role and name of the component.
    scene
        Its scene; ``*``: every scene.
    sources
        Names under which a source publishes.
    joints
        Names of the joint states that a source follows.
    rate
        Most messages per second of each stream of a source; 0: no limit.
    common_name
        Common name of the certificate, by which the router knows the component.

    Raises
    ------
    ValueError
        If a name is malformed, or a field does not fit the role.
    """

    role: CertificateRole
    name: str
    common_name: str
    scene: str = "default"
    sources: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    rate: float = DEFAULT_RATE

    def __post_init__(self) -> None:
        if self.role not in ROLES:
            raise KnownError(f"role {self.role!r} is none of {', '.join(ROLES)}")
        for name in (self.name, *self.sources, *self.joints):
            if not is_name(name):
                raise KnownError(f"name {name!r} is not 1 to 64 characters of a-z, 0-9, _ and -")
        if self.scene != ANY_SCENE and not is_name(self.scene):
            raise KnownError(f"scene {self.scene!r} is neither a name nor {ANY_SCENE!r}")
        if (self.role == "source") != bool(self.sources):
            raise KnownError("a source publishes under one name or more, other roles under none")
        if self.joints and self.role != "source":
            raise KnownError(f"a {self.role} does not follow joint states")
        if not 0 <= self.rate < 1e6:
            raise KnownError(f"rate {self.rate} is not within 0..1000000 Hz")
        if not _COMMON_NAME.fullmatch(self.common_name):
            raise KnownError(f"common name {self.common_name!r} is malformed")

    def uris(self) -> list[str]:
        """Return the URIs in the certificate's subject alternative name."""
        pairs = [("role", self.role), ("name", self.name), ("scene", self.scene)]
        pairs += [("source", name) for name in self.sources]
        pairs += [("joints", name) for name in self.joints]
        pairs.append(("rate", f"{self.rate:g}"))
        return [f"{_URN}{key}:{value}" for key, value in pairs]


def grant_from_uris(uris: Iterable[str], common_name: str) -> Grant:
    """Build the grant of a certificate from its URIs.

    Raises
    ------
    ValueError
        If they are not those of a grant.
    """
    uris = list(uris)
    pairs = [(key, value) for key, _, value in (uri.removeprefix(_URN).partition(":") for uri in uris)]
    last = dict(pairs)
    try:
        grant = Grant(
            role=cast("CertificateRole", last["role"]),
            name=last["name"],
            common_name=common_name,
            scene=last["scene"],
            sources=tuple(value for key, value in pairs if key == "source"),
            joints=tuple(value for key, value in pairs if key == "joints"),
            rate=float(last["rate"]),
        )
    except KeyError:
        raise KnownError("it does not say role, name, scene and rate") from None
    if sorted(grant.uris()) != sorted(uris):
        raise KnownError("it says something twice, or something unknown")
    return grant
