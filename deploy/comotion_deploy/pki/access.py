"""A router that trusts the certificates of a folder alone: Zenoh's access control and limits, by grants.

Everything is denied but what is listed here. "Ingress" is what a component sends to the router, "egress" what
the router sends to it. Zenoh allows a message only if one rule includes its whole key expression, and ``**``
does not match the verbatim chunk ``@adv`` of cached publishers, so that is always named.
"""

import logging
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from comotion_schemas.keys import ROOT, TOKEN_NAME_CHARACTERS
from comotion_schemas.text import counted
from comotion_schemas.tls import CERTIFICATE_FILE, KEY_FILE, load_tls, require_encryption, warn_of_expiry
from comotion_schemas.transport import SessionSettings

from ..errors import UserError
from ..router import RouterSetup
from .authority import Authority, Issued
from .certificates import Grant

MIB = 1024 * 1024
SIZE_LIMITS = {
    "obs": 4 * MIB,
    "truth": 4 * MIB,
    "joints": MIB // 16,
    "preview": 4 * MIB,
    "status": MIB,
    "hypotheses": 16 * MIB,
}
"""Largest message, in bytes, on each kind of key."""
STATUS_RATE = 10.0
"""Most Statuses per second of one component; it sends one."""
ROUTERS = "@/*/router"
"""Where routers describe themselves."""
_ALL = [f"{ROOT}/**", f"{ROOT}/**/@adv/**"]
_READABLE_QUERIES = ("snapshot", "status", "config", "affinity", "schema")
_MESSAGES = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
]
_READ = ["declare_subscriber"]
_PRESENCE = ["liveliness_query", "declare_liveliness_subscriber"]

Rule = tuple[str, list[str], list[str]]
"""Flow, messages, key expressions."""


def router_settings(grants: Iterable[Grant], *, max_batch_bytes: int | None = None) -> dict[str, Any]:
    """Build the tables of the router's Zenoh configuration.

    `grants` are those of all valid certificates; `max_batch_bytes` is the size of the largest batch of
    observations, None: 4 MiB.

    Returns
    -------
    dict
        ``access_control``, ``downsampling`` and ``low_pass_filter``.
    """
    ordered = sorted(grants, key=lambda grant: grant.common_name)
    limits = SIZE_LIMITS | ({} if max_batch_bytes is None else {"obs": max_batch_bytes})
    sizes = [
        {
            "id": f"size-{kind}",
            "flows": ["ingress"],
            "messages": ["put", "reply"],
            "key_exprs": [f"{ROOT}/*/hypotheses" if kind == "hypotheses" else f"{ROOT}/*/{kind}/*"],
            "size_limit": limit,
        }
        for kind, limit in limits.items()
    ]
    settings = {"access_control": access_control(ordered), "low_pass_filter": sizes}
    rates = _rate_limits(ordered)
    return settings | ({"downsampling": rates} if rates else {})


def access_control(grants: Sequence[Grant]) -> dict[str, Any]:
    """Build the table ``access_control``: default deny, and rules, subject and policy of each grant."""
    rules: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for grant in grants:
        ids = []
        for number, (flow, messages, keys) in enumerate(component_rules(grant)):
            ids.append(f"{grant.common_name}:{number}")
            rules.append(
                {
                    "id": ids[-1],
                    "permission": "allow",
                    "flows": ["ingress", "egress"] if flow == "both" else [flow],
                    "messages": messages,
                    "key_exprs": keys,
                }
            )
        subject: dict[str, Any] = {"id": grant.common_name, "cert_common_names": [grant.common_name]}
        if grant.role != "router":
            # Rate limits are on these links only, so no component may use another kind.
            subject["link_protocols"] = ["tls"]
        subjects.append(subject)
        policies.append({"rules": ids, "subjects": [grant.common_name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def component_rules(grant: Grant) -> list[Rule]:
    """Return what the holder of a certificate may send and receive."""
    scene = f"{ROOT}/{grant.scene}"
    if grant.role == "router":
        return [("both", _MESSAGES, [*_ALL, "@/**"])]
    # Whoever publishes must learn who subscribes, or it sends nothing.
    rules: list[Rule] = [("egress", ["declare_subscriber", "query", *_PRESENCE], _ALL)]
    if grant.role == "source":
        return rules + _source(grant, scene)
    if grant.role == "service":
        return rules + _service(grant, scene)
    return rules + _reader(grant, scene)


def _source(grant: Grant, scene: str) -> list[Rule]:
    names = grant.sources
    plain = [f"{scene}/{kind}/{name}" for name in names for kind in ("obs", "joints", "preview")]
    tokens = [f"{scene}/live/{role}/{name}" for name in names for role in ("source", "viewer")]
    followed = [f"{scene}/joints/{name}" for name in grant.joints]
    rules: list[Rule] = [("ingress", ["put"], plain), ("ingress", ["liveliness_token"], tokens)]
    rules += _cached([f"{scene}/{kind}/{name}" for name in names for kind in ("truth", "status")])
    return rules + ([("ingress", _READ, followed), ("egress", ["put"], followed)] if followed else [])


def _service(grant: Grant, scene: str) -> list[Rule]:
    queries, short = [f"{scene}/query/*"], grant.name[:TOKEN_NAME_CHARACTERS]
    cached = ("status/*", "hypotheses")
    read = [f"{scene}/obs/*", *(f"{scene}/{key}{end}" for key in cached for end in ("", "/@adv/**"))]
    presence = [f"{scene}/live/*/*", f"{scene}/*/*/@adv/**", f"{scene}/*/@adv/**"]
    # A service that stands alone adds claim and session to its token; the agent of a host numbers services.
    names = [grant.name, f"{grant.name}-$*"]
    tokens = [*(f"{scene}/live/service/{name}" for name in names), f"{scene}/live/service/{short}-$*"]
    rules: list[Rule] = [
        ("ingress", ["liveliness_token"], tokens),
        ("ingress", ["declare_queryable", "query", "reply"], queries),
        ("egress", ["declare_queryable", "query", "reply"], queries),
        ("ingress", [*_READ, "query"], read),
        ("egress", ["put", "reply"], read),
        ("ingress", _PRESENCE, presence),
        ("egress", ["liveliness_token", "declare_queryable"], presence),
    ]
    return rules + _cached([f"{scene}/hypotheses", *(f"{scene}/status/{name}" for name in names)])


def _reader(grant: Grant, scene: str) -> list[Rule]:
    """A viewer or recorder reads all of its scene; it holds a token and a Status of its own."""
    everything = [f"{scene}/**", f"{scene}/**/@adv/**"]
    # Not `forget`, which changes the scene.
    queries = [f"{scene}/query/{name}" for name in _READABLE_QUERIES]
    cached = [f"{scene}/**/@adv/**"]
    rules: list[Rule] = [
        ("ingress", [*_READ, *_PRESENCE], everything),
        ("egress", ["put", "reply", "liveliness_token", "declare_queryable"], everything),
        ("ingress", ["query"], [*queries, *cached, ROUTERS]),
        ("egress", ["reply", "declare_queryable"], [ROUTERS, "@/**"]),
        ("ingress", ["liveliness_token"], [f"{scene}/live/{grant.role}/{grant.name}"]),
    ]
    return rules + _cached([f"{scene}/status/{grant.name}"])


def _cached(keys: list[str]) -> list[Rule]:
    """Rules of a publisher that keeps its last messages: it answers queries, and is found by a token."""
    caches = [f"{key}/@adv/**" for key in keys]
    return [
        ("ingress", ["put", "reply"], [*keys, *caches]),
        ("ingress", ["declare_queryable", "liveliness_token"], caches),
    ]


def _rate_limits(grants: Sequence[Grant]) -> list[dict[str, Any]]:
    """One limit for each stream of each component: with a shared one, one source would starve another."""
    rates: dict[str, float] = {}
    for grant in grants:
        scene = f"{ROOT}/{grant.scene}"
        if grant.role == "source" and grant.rate:
            kinds = ("obs", "joints", "preview", "truth")
            rates |= {f"{scene}/{kind}/{name}": grant.rate for kind in kinds for name in grant.sources}
        if grant.role != "router":
            rates |= {f"{scene}/status/{name}": STATUS_RATE for name in (*grant.sources, grant.name)}
    if not rates:
        return []
    return [
        {
            "id": "rates",
            "flows": ["ingress"],
            # Between routers (quic) messages may arrive in bursts after a delay; they were limited before.
            "link_protocols": ["tls"],
            "messages": ["put"],
            "rules": [{"key_expr": key, "freq": rate} for key, rate in sorted(rates.items())],
        }
    ]


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

    The `folder` is the authority's, or what ``comotion pki export`` has made of it for this router; `own` is
    the router's own folder, None: the one in `folder`, if there is only one with a key. It connects to other
    routers at `connect`; it listens at `listen`, by default with ``tls`` and ``quic`` at port 7447 of every
    interface. `max_batch_bytes` is as in :func:`router_settings`.

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
