"""The private authority in a folder: issues certificates and checks them. Needs the extra `secure`.

::

    DIR/ca.crt, DIR/ca.key    the authority; its key stays here
    DIR/NAME/                 a component's folder, see comotion_schemas.tls

A router trusts a certificate that this authority has signed and whose folder is here: to withdraw one, remove
its folder and restart the routers.
"""

import os
import secrets
import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec

from comotion_schemas.errors import KnownError
from comotion_schemas.tls import (
    CA_FILE,
    CERTIFICATE_FILE,
    IDENTITY_FILE,
    KEY_FILE,
    Identity,
    identity_as_json,
)

from .certificates import Grant, grant_of, make_certificate, pem_of, pem_of_key, read_certificate, read_key

CA_KEY_FILE = "ca.key"
CA_DAYS = 3650
DAYS = 365
_OWN_ONLY = 0o600


@dataclass(frozen=True, kw_only=True)
class Issued:
    """One component's folder: its grant and validity, and why its certificate is not valid, if so."""

    folder: Path
    grant: Grant | None = None
    not_after: datetime | None = None
    problem: str = ""


class Authority:
    """The authority of a folder.

    Raises
    ------
    ValueError
        If the folder has none, or its files are malformed.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.certificate = read_certificate(folder / CA_FILE)

    @classmethod
    def create(cls, folder: Path, days: int = CA_DAYS) -> "Authority":
        """Create an authority in a folder, which is made if need be.

        Raises
        ------
        ValueError
            If the folder has one.
        """
        if (folder / CA_KEY_FILE).exists() or (folder / CA_FILE).exists():
            raise KnownError(f"{folder} has an authority already")
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        key = ec.generate_private_key(ec.SECP256R1())
        not_after = datetime.now(UTC) + timedelta(days=days)
        certificate = make_certificate(f"comotion {secrets.token_hex(4)}", key, not_after)
        _write(folder / CA_KEY_FILE, pem_of_key(key))
        _write(folder / CA_FILE, certificate, 0o644)
        return cls(folder)

    def issue(
        self, grant: Grant, *, hosts: Sequence[str] = (), days: float = DAYS, renew: bool = False
    ) -> Path:
        """Issue a certificate and write the folder of the component.

        The common name of the `grant` is replaced by a new one, or with `renew` by that of the certificate
        that it replaces; `hosts` are names and addresses of a router, `days` is the time of validity.

        Returns
        -------
        The folder.

        Raises
        ------
        ValueError
            If there is such a component already, or with `renew` none; or the authority's key is missing.
        """
        folder = self.folder / grant.name
        if folder.exists() != renew:
            raise KnownError(
                f"{folder} exists; see --renew" if not renew else f"there is no {folder} to renew"
            )
        grant = replace(grant, common_name=self._common_name(folder, grant, renew=renew))
        days_end = datetime.now(UTC) + timedelta(days=days)
        not_after = min(days_end, self.certificate.not_valid_after_utc).replace(microsecond=0)
        key = ec.generate_private_key(ec.SECP256R1())
        issuer = self.certificate.subject, read_key(self.folder / CA_KEY_FILE)
        certificate = make_certificate(grant.common_name, key, not_after, issuer, hosts, grant)
        identity = Identity(
            role=grant.role,
            name=grant.name,
            scene=grant.scene,
            sources=grant.sources,
            expires_s=int(not_after.timestamp()),
        )
        partial = self.folder / f".{grant.name}.{secrets.token_hex(4)}"
        partial.mkdir(mode=0o700)
        _write(partial / KEY_FILE, pem_of_key(key))
        _write(partial / CERTIFICATE_FILE, certificate, 0o644)
        _write(partial / CA_FILE, pem_of(self.certificate), 0o644)
        _write(partial / IDENTITY_FILE, identity_as_json(identity).encode(), 0o644)
        if renew:
            shutil.rmtree(folder)
        partial.rename(folder)
        return folder

    def issued(self) -> list[Issued]:
        """Read and check the certificates of all components, by name."""
        folders = sorted(p.parent for p in self.folder.glob(f"[!.]*/{CERTIFICATE_FILE}"))
        entries = [self._check(folder) for folder in folders]
        names = Counter(entry.grant.common_name for entry in entries if entry.grant and not entry.problem)
        # Of several components with one common name none is trusted: their rules would add up.
        return [
            replace(entry, problem="another component has its common name")
            if entry.grant and not entry.problem and names[entry.grant.common_name] > 1
            else entry
            for entry in entries
        ]

    def _common_name(self, folder: Path, grant: Grant, *, renew: bool) -> str:
        if not renew:
            # A name that was used before must not revive an old certificate, so part of it is random.
            return f"{grant.name[:47]}.{secrets.token_hex(8)}"
        previous = self._check(folder).grant
        if previous is None:
            raise KnownError(f"{folder}: its certificate cannot be read; remove the folder and issue anew")
        return previous.common_name

    def _check(self, folder: Path) -> Issued:
        try:
            certificate = read_certificate(folder / CERTIFICATE_FILE)
            certificate.verify_directly_issued_by(self.certificate)
            grant = grant_of(certificate)
        except KnownError as error:
            return Issued(folder=folder, problem=str(error))
        except (ValueError, TypeError, InvalidSignature):
            return Issued(folder=folder, problem="it was signed by another authority")
        problem = ""
        if grant.name != folder.name:
            problem = f"it is the certificate of {grant.name!r}"
        elif certificate.not_valid_after_utc <= datetime.now(UTC):
            problem = "it has expired"
        return Issued(folder=folder, grant=grant, not_after=certificate.not_valid_after_utc, problem=problem)


def export(folder: Path, name: str, out: Path) -> list[Path]:
    """Copy what the host of one component needs, without the keys of others.

    A component needs its own folder; a router also the certificates of all components.

    Returns
    -------
    The folders written.

    Raises
    ------
    ValueError
        If there is no such component, or the destination has one.
    """
    issued = {entry.folder.name: entry for entry in Authority(folder).issued()}
    if name not in issued:
        raise KnownError(f"{folder} has no component {name!r}; see 'comotion pki list {folder}'")
    if (out / name).exists():
        raise KnownError(f"{out / name} exists")
    out.mkdir(mode=0o700, parents=True, exist_ok=True)
    shutil.copytree(folder / name, out / name)
    grant = issued[name].grant
    if grant is None or grant.role != "router":
        return [out / name]
    shutil.copy2(folder / CA_FILE, out / CA_FILE)
    others = [entry for entry in issued if entry != name]
    for other in others:
        (out / other).mkdir(mode=0o700, exist_ok=True)
        shutil.copy2(folder / other / CERTIFICATE_FILE, out / other / CERTIFICATE_FILE)
    return [out / entry for entry in (name, *others)]


def _write(path: Path, content: bytes, mode: int = _OWN_ONLY) -> None:
    """Write a new file that is never readable by others, not even for a moment."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        file.write(content)
