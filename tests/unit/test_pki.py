"""Certificates and access rules: what is issued, what is trusted, what a grant allows."""

import json
import os
import stat
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from comotion_deploy.cli import run
from comotion_deploy.network import is_loopback
from comotion_deploy.pki.authority import Authority, export
from comotion_deploy.pki.certificates import ROLES, Grant, grant_from_uris
from comotion_schemas.tls import load_tls
from comotion_schemas.transport import SessionSettings, client_settings

NAMES = st.from_regex(r"[a-z0-9_-]{1,64}", fullmatch=True)


def grant(role, name, **changes):
    sources = (name,) if role == "source" else ()
    return Grant(**({"role": role, "name": name, "common_name": "c", "sources": sources} | changes))


@pytest.fixture
def folder(tmp_path):
    authority = Authority.create(tmp_path / "pki")
    authority.issue(grant("router", "hall"), hosts=("localhost", "127.0.0.1"))
    authority.issue(grant("source", "cam"))
    return authority.folder


@given(role=st.sampled_from(ROLES), names=st.lists(NAMES, min_size=1, max_size=4), scene=NAMES | st.just("*"))
def test_a_certificate_carries_its_whole_grant(role, names, scene):
    sources = tuple(names) if role == "source" else ()
    original = Grant(role=role, name=names[0], common_name="a.1", scene=scene, sources=sources, rate=30.0)
    assert grant_from_uris(original.uris(), "a.1") == original


@pytest.mark.parametrize(
    "uris",
    [
        [],
        ["urn:comotion:role:source"],
        [*grant("viewer", "v").uris(), "urn:comotion:role:router"],
        [*grant("viewer", "v").uris(), "urn:comotion:source:cam"],
        [*grant("viewer", "v").uris(), "urn:comotion:admin:yes"],
        ["http://x/", *grant("viewer", "v").uris()],
        [uri.replace(":viewer", ":king") for uri in grant("viewer", "v").uris()],
        [uri.replace("name:v", "name:**") for uri in grant("viewer", "v").uris()],
        [uri.replace("scene:default", "scene:a/b") for uri in grant("viewer", "v").uris()],
    ],
)
def test_a_certificate_that_says_something_else_grants_nothing(uris):
    with pytest.raises(ValueError, match=r".+"):
        grant_from_uris(uris, "a.1")


def test_keys_are_for_their_owner_alone_from_the_first_moment(folder):
    previous = os.umask(0)
    try:
        Authority(folder).issue(grant("viewer", "laptop"))
    finally:
        os.umask(previous)
    keys = [*folder.glob("*.key"), *folder.glob("*/*.key")]
    assert len(keys) == 4
    assert {stat.S_IMODE(key.stat().st_mode) for key in keys} == {0o600}
    assert stat.S_IMODE((folder / "laptop").stat().st_mode) == 0o700


def test_nothing_is_overwritten_unless_told(folder):
    with pytest.raises(ValueError, match="exists"):
        Authority(folder).issue(grant("source", "cam"))
    with pytest.raises(ValueError, match="has an authority"):
        Authority.create(folder)
    with pytest.raises(ValueError, match="to renew"):
        Authority(folder).issue(grant("source", "new"), renew=True)


def test_a_renewed_certificate_is_known_to_routers_by_the_same_name_and_a_new_issue_is_not(folder):
    authority = Authority(folder)

    def common_name():
        return next(e.grant.common_name for e in authority.issued() if e.folder.name == "cam")

    first, key = common_name(), (folder / "cam" / "component.key").read_bytes()
    authority.issue(grant("source", "cam"), renew=True)
    assert common_name() == first
    assert (folder / "cam" / "component.key").read_bytes() != key
    for file in (folder / "cam").iterdir():
        file.unlink()
    (folder / "cam").rmdir()
    authority.issue(grant("source", "cam"))
    assert common_name() != first


def test_only_valid_certificates_of_this_authority_are_trusted(folder, tmp_path):
    stranger = Authority.create(tmp_path / "other")
    stranger.issue(grant("source", "spy"))
    (stranger.folder / "spy").rename(folder / "spy")
    Authority(folder).issue(grant("source", "old"), days=-1)
    Authority(folder).issue(grant("source", "moved"))
    (folder / "moved").rename(folder / "elsewhere")
    (folder / "broken").mkdir()
    (folder / "broken" / "component.crt").write_text("no certificate")
    (folder / "copy").mkdir()
    (folder / "copy" / "component.crt").write_bytes((folder / "cam" / "component.crt").read_bytes())
    problems = {entry.folder.name: entry.problem for entry in Authority(folder).issued()}
    assert {name: bool(problem) for name, problem in problems.items()} == {
        "hall": False, "cam": False, "copy": True, "spy": True, "old": True, "elsewhere": True, "broken": True
    }  # fmt: skip
    assert "expired" in problems["old"]
    assert "another authority" in problems["spy"]


def test_the_host_of_a_router_gets_all_certificates_and_no_key_but_its_own(folder, tmp_path):
    export(folder, "hall", tmp_path / "host")
    assert {p.name for p in (tmp_path / "host").rglob("*.key")} == {"component.key"}
    assert [p.parent.name for p in (tmp_path / "host").rglob("*.key")] == ["hall"]
    problems = {e.folder.name: e.problem for e in Authority(tmp_path / "host").issued()}
    assert problems == {"hall": "", "cam": ""}
    with pytest.raises(ValueError, match="where the authority is"):
        Authority(tmp_path / "host").issue(grant("viewer", "laptop"))
    export(folder, "cam", tmp_path / "robot")
    assert {p.name for p in (tmp_path / "robot").iterdir()} == {"cam"}
    assert load_tls(tmp_path / "robot" / "cam").identity.name == "cam"


def test_a_process_with_the_wrong_certificate_says_so_at_once(folder):
    identity = load_tls(folder / "cam").identity
    identity.check("source", "cam", "default")
    for of in (("service", "cam", "default"), ("source", "x", "default"), ("source", "cam", "x")):
        with pytest.raises(ValueError, match="the certificate of source 'cam' is"):
            identity.check(*of)
    with pytest.raises(ValueError, match="is not encrypted"):
        client_settings(["tcp/127.0.0.1:1"], folder / "cam")
    with pytest.raises(ValueError, match="needs a certificate"):
        SessionSettings(connect=("tls/127.0.0.1:1",))


def test_an_expired_or_incomplete_folder_is_an_error(folder, caplog, monkeypatch):
    Authority(folder).issue(grant("viewer", "old"), days=-1)
    with pytest.raises(ValueError, match="expired on"):
        load_tls(folder / "old")
    (folder / "cam" / "component.key").unlink()
    with pytest.raises(ValueError, match=r"no component\.key"):
        load_tls(folder / "cam")
    (folder / "hall" / "component.json").write_text("[]")
    with pytest.raises(ValueError, match="malformed"):
        load_tls(folder / "hall")


def test_the_list_shows_expiry_and_says_by_its_status_whether_to_look(folder, capsys):
    assert run(["pki", "list", str(folder), "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["components"]}
    assert rows["cam"]["role"] == "source"
    assert 364 < rows["cam"]["days"] < 366
    Authority(folder).issue(grant("viewer", "soon"), days=20)
    assert run(["pki", "list", str(folder)]) == 1
    shown = capsys.readouterr()
    assert "expires soon" in shown.out
    assert "soon" in shown.err
    assert f"{datetime.now(UTC) + timedelta(days=20):%Y-%m-%d}" in shown.out


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("tcp/127.0.0.1:7447", True),
        ("tcp/[::1]:7447", True),
        ("unixsock-stream//tmp/a", True),
        ("tcp/0.0.0.0:7447", False),
        ("tcp/router.local:7447", False),
        ("tcp/127.0.0.1.example.com:7447", False),
        (":9100", False),
    ],
)
def test_loopback_addresses(address, expected):
    assert is_loopback(address) is expected
