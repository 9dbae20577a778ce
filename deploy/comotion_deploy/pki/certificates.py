"""X.509 certificates: their parts, from files and to files. Needs the extra `secure`."""

import ipaddress
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

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


def begin_certificate(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, not_after: datetime
) -> x509.CertificateBuilder:
    """Begin a certificate that is valid from now."""
    begin = min(datetime.now(UTC), not_after) - _SKEW
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(not_after)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def key_usage(*, signs: bool) -> x509.KeyUsage:
    """Extension for a key that signs certificates, or only messages."""
    return x509.KeyUsage(
        digital_signature=True,
        key_cert_sign=signs,
        crl_sign=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def general_name(host: str) -> x509.GeneralName:
    """Name of a host in a certificate: an address or a DNS name."""
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


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
