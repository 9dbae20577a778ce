"""An etcd cluster: keys, leases and transactions; where one member does not answer, the next one does."""

import base64
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from comotion_schemas.errors import KnownError
from comotion_schemas.tls import TlsFiles

if TYPE_CHECKING:  # the extra `cluster` need not be installed
    from etcd3gw.client import Etcd3Client

# s; an answer within a site takes milliseconds. A member without a quorum does not answer in time.
_TIMEOUT_S = 1.0
_DEFAULT_PORT = 2379


class EtcdUnavailableError(OSError):
    """No member of the cluster answers."""


@dataclass(frozen=True)
class Entry:
    """A key's value, the revisions that created and last changed it, and its lease (0: none)."""

    value: bytes
    created: int
    changed: int
    lease: int


class Etcd:
    """A client of a cluster, for one thread.

    `urls` are ``http://host:port`` or ``https://host:port`` of the members, at least one; `tls` certificates
    for https, None: the authorities that the system trusts. `revision` is that of the store as of the last
    answer: it grows with every change of any key, and not with renewals. Raises ValueError if a url is not
    valid, or the extra ``cluster`` is not installed.
    """

    def __init__(self, urls: Sequence[str], tls: TlsFiles | None = None) -> None:
        if not urls:
            raise KnownError("an etcd cluster needs at least one url")
        self.urls = tuple(urls)
        self.revision = 0
        self._members = [_member(url, tls) for url in urls]

    def grant(self, ttl: int) -> int:
        """Get a lease that ends `ttl` seconds after its last renewal; its number."""
        return int(self._post("/lease/grant", {"TTL": ttl, "ID": 0})["ID"])

    def renew(self, lease: int) -> bool:
        """Renew a lease; False if it has ended."""
        answer = self._post("/lease/keepalive", {"ID": lease})
        return int(answer.get("result", {}).get("TTL", 0)) > 0

    def revoke(self, lease: int) -> None:
        """End a lease; its keys are deleted."""
        from etcd3gw.exceptions import Etcd3Exception  # noqa: PLC0415

        with suppress(Etcd3Exception):  # it has ended already
            self._post("/lease/revoke", {"ID": lease}, refusable=True)

    def create(self, key: str, value: bytes, lease: int = 0) -> int | None:
        """Make a key that does not exist; the revision of it, None if it does exist."""
        return self.replace(key, 0, value, lease)

    def replace(self, key: str, created: int, value: bytes, lease: int = 0) -> int | None:
        """Change a key if it is still the one that `created` made; the revision, None if it is not."""
        compare = {"key": _b64(key), "result": "EQUAL", "target": "CREATE", "create_revision": created}
        return self._transact([compare], key, value, lease)

    def put_while(self, other: str, changed: int, key: str, value: bytes, lease: int = 0) -> bool:
        """Write a key if another one has not changed since the revision `changed`; whether it was written."""
        compare = {"key": _b64(other), "result": "EQUAL", "target": "MOD", "mod_revision": changed}
        return self._transact([compare], key, value, lease) is not None

    def put(self, key: str, value: bytes, lease: int = 0) -> None:
        """Write a key."""
        self._transact([], key, value, lease)

    def delete(self, key: str) -> bool:
        """Delete a key; whether it was there."""
        return int(self._post("/kv/deleterange", {"key": _b64(key)}).get("deleted", 0)) > 0

    def read(self, key: str) -> Entry | None:
        """Read a key; None if there is none."""
        return self._range({"key": _b64(key)}).get(key)

    def read_all(self, prefix: str) -> dict[str, Entry]:
        """All keys that begin with a prefix, ascending."""
        last = prefix[:-1] + chr(ord(prefix[-1]) + 1)
        return self._range({"key": _b64(prefix), "range_end": _b64(last)})

    def _range(self, request: dict[str, Any]) -> dict[str, Entry]:
        pairs = self._post("/kv/range", request).get("kvs", [])
        return {
            base64.b64decode(kv["key"]).decode(): Entry(
                base64.b64decode(kv.get("value", "")),
                int(kv["create_revision"]),
                int(kv["mod_revision"]),
                int(kv.get("lease", 0)),
            )
            for kv in pairs
        }

    def _transact(self, compare: list[dict[str, Any]], key: str, value: bytes, lease: int) -> int | None:
        put = {"key": _b64(key), "value": base64.b64encode(value).decode(), "lease": lease}
        request = {"compare": compare, "success": [{"request_put": put}], "failure": []}
        answer = self._post("/kv/txn", request)
        return int(answer["header"]["revision"]) if answer.get("succeeded") else None

    def _post(self, path: str, request: dict[str, Any], *, refusable: bool = False) -> dict[str, Any]:
        """Ask the member that answered last, then the others; where it may refuse, that is its answer."""
        from etcd3gw import exceptions  # noqa: PLC0415

        lost, broken = exceptions.ConnectionFailedError, exceptions.InternalServerError
        reason, no_answer = "", (lost, exceptions.ConnectionTimeoutError, broken)
        for _ in range(len(self._members)):
            try:
                answer: dict[str, Any] = self._members[0].post(self._members[0].get_url(path), json=request)
            except exceptions.Etcd3Exception as error:
                if refusable and not isinstance(error, no_answer):
                    raise
                reason = str(error).split("\n")[0][:200]
                self._members.append(self._members.pop(0))
            else:
                header = answer.get("result", answer).get("header", {})
                self.revision = int(header.get("revision", self.revision))
                return answer
        raise EtcdUnavailableError(f"etcd does not answer at {', '.join(self.urls)}: {reason}")


def _member(url: str, tls: TlsFiles | None) -> "Etcd3Client":
    try:
        from etcd3gw import client  # noqa: PLC0415
    except ImportError:
        raise KnownError("etcd needs the extra 'cluster': pip install 'comotion[cluster]'") from None
    try:
        parts = urlsplit(url)
        port = parts.port or _DEFAULT_PORT
    except ValueError as error:
        raise KnownError(f"{url!r} is no url of etcd: {error}") from None
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise KnownError(f"{url!r} is no url of etcd; one is http://127.0.0.1:2379")
    files: dict[str, Any] = {}
    if tls is not None and parts.scheme == "https":
        files = {"ca_cert": str(tls.root_ca), "cert_cert": str(tls.certificate), "cert_key": str(tls.key)}
    return client(host=parts.hostname, port=port, protocol=parts.scheme, timeout=_TIMEOUT_S, **files)


def _b64(text: str) -> str:
    return base64.b64encode(text.encode()).decode()
