"""Sets up a router that trusts the certificates of a folder alone. Needs the extra `secure`."""

import logging
from collections.abc import Sequence
from pathlib import Path

from comotion_schemas.text import counted
from comotion_schemas.tls import CERTIFICATE_FILE, KEY_FILE, load_tls, require_encryption, warn_of_expiry
from comotion_schemas.transport import SessionSettings

from ..errors import UserError
from ..router import RouterSetup
from .access import router_settings
from .authority import Authority, Issued

DEFAULT_LISTEN = ("tls/0.0.0.0:7447", "quic/0.0.0.0:7447")
_log = logging.getLogger(__name__)


def secure_setup(
    folder: Path,
    own: Path | None,
    *,
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    max_batch_bytes: int | None = None,
) -> RouterSetup:
    """Set up a router from a folder of certificates.

    Parameters
    ----------
    folder
        The authority's folder, or what ``comotion pki export`` has made of it for this router.
    own
        The router's own folder; None: the one in `folder`, if there is only one with a key.
    connect
        Endpoints of other routers.
    listen
        Endpoints; default ``tls`` and ``quic`` at port 7447 of every interface.
    max_batch_bytes
        Largest batch of observations; None: the default.

    Raises
    ------
    UserError, ValueError
        If the folder is not valid, or there is no certificate for this router.
    """
    endpoints = listen or DEFAULT_LISTEN
    require_encryption([*connect, *endpoints], wanted=True)
    issued = Authority(folder).issued()
    for entry in issued:
        if entry.problem:
            _log.warning("%s is not trusted: %s", entry.folder / CERTIFICATE_FILE, entry.problem)
    grants = [entry.grant for entry in issued if entry.grant is not None and not entry.problem]
    own_folder = own or _own_folder(folder, issued)
    tls = load_tls(own_folder)
    if tls.identity is None or tls.identity.role != "router":
        raise UserError(f"{own_folder} is not the folder of a router")
    if not any(grant.role == "router" and grant.name == tls.identity.name for grant in grants):
        raise UserError(f"{own_folder}: {folder} does not know this router")
    warn_of_expiry(tls)
    for endpoint in connect:
        if not endpoint.startswith("quic/"):
            _log.warning(
                "%s: link routers by quic/, or the rate limits drop bursts of delayed data", endpoint
            )
    routers = sum(grant.role == "router" for grant in grants)
    components = counted(len(grants) - routers, "component")
    _log.info("access for %s, %s", components, counted(routers, "router"))
    settings = SessionSettings(mode="router", connect=tuple(connect), listen=tuple(endpoints), tls=tls)
    return RouterSetup(settings, router_settings(grants, max_batch_bytes=max_batch_bytes))


def _own_folder(folder: Path, issued: Sequence[Issued]) -> Path:
    candidates = [
        entry.folder
        for entry in issued
        if entry.grant is not None and entry.grant.role == "router" and (entry.folder / KEY_FILE).exists()
    ]
    if not candidates:
        raise UserError(f"{folder} has no router: comotion pki issue {folder} --role router --name NAME")
    if len(candidates) > 1:
        names = ", ".join(str(candidate) for candidate in candidates)
        raise UserError(f"{folder} has several routers; choose one with --tls: {names}")
    return candidates[0]
