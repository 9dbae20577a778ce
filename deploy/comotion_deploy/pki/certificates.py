"""X.509 certificates, from files and to files, and the grants that they spell. Needs the extra `secure`."""

import ipaddress
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal, cast, get_args

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

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

    Raises
    ------
    ValueError
        If a name is malformed, or a field does not fit the role.
    """

    # Role and name of the component.
    role: CertificateRole
    name: str
    common_name: str  # common name of the certificate, by which the router identifies the component
    scene: str = "default"  # its scene; ``*``: every scene
    sources: tuple[str, ...] = ()  # names under which a source publishes
    joints: tuple[str, ...] = ()  # names of the joint states that a source follows
    rate: float = DEFAULT_RATE  # most messages per second of each stream of a source; 0: no limit

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


# Clocks of hosts may differ a little when a certificate is new.
_SKEW = timedelta(minutes=5)
# Keys sign certificates or only messages.
_OTHER_USES = ("content_commitment", "key_encipherment", "data_encipherment", "key_agreement")
_NO_OTHER_USE = dict.fromkeys((*_OTHER_USES, "encipher_only", "decipher_only"), False)


def grant_of(certificate: x509.Certificate) -> Grant:
    """Return what a certificate allows; ValueError if it does not say so."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    try:
        extension = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName)
    except x509.ExtensionNotFound:
        raise KnownError("it does not say what it allows") from None
    uris = extension.value.get_values_for_type(x509.UniformResourceIdentifier)
    return grant_from_uris(uris, str(names[0].value) if len(names) == 1 else "")


def make_certificate(
    common_name: str,
    key: ec.EllipticCurvePrivateKey,
    not_after: datetime,
    issuer: tuple[x509.Name, ec.EllipticCurvePrivateKey] | None = None,
    hosts: Sequence[str] = (),
    grant: Grant | None = None,
) -> bytes:
    """Make a certificate that is valid from now.

    `common_name` and `key` are its owner's, `issuer` is name and key of the authority, None: it is that of an
    authority itself; `hosts` are names and addresses of a router, `grant` is what a component may do.

    Returns
    -------
    PEM.
    """
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])
    issuer_name, issuer_key = issuer or (name, key)
    usage = x509.KeyUsage(
        digital_signature=True, key_cert_sign=issuer is None, crl_sign=issuer is None, **_NO_OTHER_USE
    )
    builder = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(issuer_name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(min(datetime.now(UTC), not_after) - _SKEW)
        .not_valid_after(not_after)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(x509.BasicConstraints(issuer is None, 0 if issuer is None else None), critical=True)
        .add_extension(usage, critical=True)
    )
    if grant is not None:
        names: list[x509.GeneralName] = [_general_name(host) for host in hosts]
        names += [x509.UniformResourceIdentifier(uri) for uri in grant.uris()]
        servers = [ExtendedKeyUsageOID.SERVER_AUTH] if grant.role == "router" else []
        usages = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH, *servers])
        signer = x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_key.public_key())
        for extension in (usages, x509.SubjectAlternativeName(names), signer):
            builder = builder.add_extension(extension, critical=False)
    return pem_of(builder.sign(issuer_key, hashes.SHA256()))


def _general_name(host: str) -> x509.GeneralName:
    """Name of a host in a certificate: an address or a DNS name."""
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def pem_of(certificate: x509.Certificate) -> bytes:
    """PEM of a certificate."""
    return certificate.public_bytes(serialization.Encoding.PEM)


def pem_of_key(key: ec.EllipticCurvePrivateKey) -> bytes:
    """PEM of a private key, without a pass phrase: services start without a person."""
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def read_certificate(path: Path) -> x509.Certificate:
    """Read a PEM certificate; ValueError if it is missing or malformed."""
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except FileNotFoundError:
        raise KnownError(f"there is no {path}; 'comotion pki init' makes an authority") from None
    except (OSError, ValueError) as error:
        raise KnownError(f"{path} is not a certificate ({type(error).__name__})") from None


def read_key(path: Path) -> ec.EllipticCurvePrivateKey:
    """Read a PEM key; ValueError if it is missing or malformed."""
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), password=None)
    except FileNotFoundError:
        raise KnownError(f"there is no {path}: certificates are issued where the authority is") from None
    except (OSError, ValueError, TypeError) as error:
        raise KnownError(f"{path} is not a private key ({type(error).__name__})") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise KnownError(f"{path} is a key of another kind")
    return key
