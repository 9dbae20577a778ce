"""Reads a component's folder of certificate and key, and what the certificate allows.

``comotion pki issue`` writes such a folder::

    ca.crt           certificate of the private authority
    component.crt    certificate of the component
    component.key    its private key, for the owner alone
    component.json   role, names, scene and expiry, as in the certificate

The router trusts only the certificate. `component.json` lets a process report a wrong name or role at once,
because Zenoh drops what the router denies without an error.
"""

import logging
import os
import stat
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter

from .errors import KnownError
from .types import Name

CA_FILE = "ca.crt"
CERTIFICATE_FILE = "component.crt"
KEY_FILE = "component.key"
IDENTITY_FILE = "component.json"
ANY_SCENE = "*"
ENVIRONMENT = "COMOTION_TLS"
"""Variable that names the folder of a process's component."""
ENCRYPTED = ("tls", "quic")
"""Protocols of links with certificates."""
WARN_BEFORE_S = 30 * 86_400
"""A certificate that expires sooner is worth a warning."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Identity:
    """What a certificate allows."""

    # Role and name of the component; the role is ``source``, ``service``, ``viewer``, ``recorder`` or
    # ``router``.
    role: str
    name: Name
    scene: str  # its scene; ``*``: every scene
    sources: tuple[str, ...]  # names under which a source may publish
    expires_s: int  # end of validity, seconds since the Unix epoch

    def check(self, role: str, name: str, scene: str) -> None:
        """Check that a component may run under this certificate.

        Raises
        ------
        ValueError
            If the certificate is for another role, name or scene; one line that says which.
        """
        certificate = f"the certificate of {self.role} {self.name!r}"
        # A robot that publishes joint states has a viewer's token: it publishes no observations.
        if role != self.role and not (self.role == "source" and role == "viewer"):
            raise KnownError(f"{certificate} is not for a {role}")
        names = self.sources if self.role == "source" else (self.name,)
        # An agent numbers the services that it starts.
        derived = self.role == "service" and name.startswith(f"{self.name}-")
        if name not in names and not derived:
            raise KnownError(f"{certificate} is for the name {' or '.join(names)}, not {name!r}")
        if self.scene not in (ANY_SCENE, scene):
            raise KnownError(f"{certificate} is for the scene {self.scene!r}, not {scene!r}")


_IDENTITY = TypeAdapter(Identity)


@dataclass(frozen=True, kw_only=True)
class TlsFiles:
    """PEM files for mutual TLS; `identity` is None if it is not known what the certificate allows."""

    root_ca: Path
    certificate: Path
    key: Path
    identity: Identity | None = None


def load_tls(folder: Path) -> TlsFiles:
    """Read the folder of a component.

    Raises
    ------
    ValueError
        If a file is missing or malformed, or the certificate has expired; one line that names it.
    """
    files = [folder / name for name in (CA_FILE, CERTIFICATE_FILE, KEY_FILE, IDENTITY_FILE)]
    for file in files:
        if not file.is_file():
            raise KnownError(f"{folder} is not the folder of a component: there is no {file.name}")
    try:
        identity = _IDENTITY.validate_json(files[3].read_bytes())
    except (OSError, ValueError) as error:
        raise KnownError(f"{files[3]}: malformed ({type(error).__name__})") from None
    tls = TlsFiles(root_ca=files[0], certificate=files[1], key=files[2], identity=identity)
    if identity.expires_s <= time.time():
        day = time.strftime("%Y-%m-%d", time.gmtime(identity.expires_s))
        raise KnownError(
            f"{folder}: the certificate expired on {day}; 'comotion pki issue --renew' makes one"
        )
    return tls


def find_tls(given: TlsFiles | Path | str | None) -> TlsFiles | None:
    """Return the given files, those of the given folder, or of the folder that ``COMOTION_TLS`` names.

    Raises
    ------
    ValueError
        As :func:`load_tls`.
    """
    if isinstance(given, TlsFiles):
        return given
    folder = given or os.environ.get(ENVIRONMENT)
    return load_tls(Path(folder)) if folder else None


def require_encryption(endpoints: Sequence[str], *, wanted: bool) -> None:
    """Check that endpoints fit to whether there is a certificate.

    Raises
    ------
    ValueError
        One line that names the endpoint.
    """
    for endpoint in endpoints:
        if not isinstance(endpoint, str):
            raise KnownError(f"the endpoint is {endpoint!r}, not a text as tcp/127.0.0.1:7447")
        protocol, _, address = endpoint.partition("/")
        if wanted and protocol not in ENCRYPTED:
            raise KnownError(f"{endpoint} is not encrypted: with a certificate use tls/{address}")
        if not wanted and protocol in ENCRYPTED:
            raise KnownError(f"{endpoint} needs a certificate: --tls DIR/NAME, or {ENVIRONMENT}")


def warn_of_expiry(tls: TlsFiles) -> None:
    """Log a warning if the certificate expires soon, or others can read its key."""
    left = float("inf") if tls.identity is None else tls.identity.expires_s - time.time()
    if left < WARN_BEFORE_S:
        _log.warning("%s expires in %.0f days; renew it", tls.certificate, max(0.0, left) / 86_400)
    if tls.key.stat().st_mode & stat.S_IRWXO:
        _log.warning("%s can be read by everyone on this machine: chmod 600", tls.key)


def identity_as_json(identity: Identity) -> str:
    """Content of `component.json`."""
    return _IDENTITY.dump_json(identity, indent=2).decode() + "\n"
