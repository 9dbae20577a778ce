"""X.509 certificates: their parts, from files and to files. Needs the extra `secure`."""

import ipaddress
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from comotion_schemas.errors import KnownError

from .grants import Grant, grant_from_uris

# Clocks of hosts may differ a little when a certificate is new.
_SKEW = timedelta(minutes=5)


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

    Parameters
    ----------
    common_name, key
        Of its owner.
    not_after
        End of its validity.
    issuer
        Name and key of the authority; None: it is that of an authority itself.
    hosts, grant
        Names and addresses of a router; what a component may do.

    Returns
    -------
    PEM.
    """
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])
    issuer_name, issuer_key = issuer or (name, key)
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
        .add_extension(_key_usage(signs=issuer is None), critical=True)
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


def _key_usage(*, signs: bool) -> x509.KeyUsage:
    """Extension for a key that signs certificates, or only messages."""
    others = ("content_commitment", "key_encipherment", "data_encipherment", "key_agreement")
    never = dict.fromkeys((*others, "encipher_only", "decipher_only"), False)
    return x509.KeyUsage(digital_signature=True, key_cert_sign=signs, crl_sign=signs, **never)


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
