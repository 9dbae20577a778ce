"""A router with certificates: what each role may do works, and every forbidden act is without effect."""

import json
import signal
import time
from contextlib import ExitStack
from dataclasses import replace

import pytest
import zenoh
from zenoh.handlers import RingChannel

from comotion_deploy.demo import free_endpoint
from comotion_deploy.pki.authority import Authority
from comotion_deploy.pki.certificates import Grant
from comotion_schemas import Keys, Status
from comotion_schemas.component import Component
from comotion_schemas.tls import TlsFiles, load_tls
from comotion_schemas.transport import SessionSettings, connect, zenoh_config
from comotion_tools.soak.load import Source

from .conftest import TWO_BODIES
from .waiting import DEADLINE, every, until, until_heard

KEYS, OTHER_SCENE = Keys(), Keys("elsewhere")
RATE = 30.0
ROLES = {"cam": "source", "laptop": "viewer", "disk": "recorder", "fusion": "service"}


def issue(authority, role, name, days=90.0, **grant):
    """Issue a certificate of a component of this machine."""
    fields = {"common_name": "new", "sources": (name,) if role == "source" else (), "rate": RATE} | grant
    hosts = ("localhost", "127.0.0.1") if role == "router" else ()
    authority.issue(Grant(role=role, name=name, **fields), days=days, hosts=hosts)


class Site:
    """A folder of certificates and a router that trusts them."""

    def __init__(self, folder, start):
        self.authority = Authority.create(folder)
        for name, role in ({"hall": "router", "mocap": "source"} | ROLES).items():
            issue(self.authority, role, name)
        self.port = free_endpoint().rpartition(":")[2]
        self.endpoint = f"tls/localhost:{self.port}"
        self._start = start
        self.router = self.start_router()

    def start_router(self):
        folder = self.authority.folder
        return self._start("router", "--secure", folder, "--listen", f"tls/127.0.0.1:{self.port}")

    def settings(self, name, **changes):
        tls = load_tls(self.authority.folder / name)
        return SessionSettings(connect=(self.endpoint,), tls=replace(tls, **changes))


@pytest.fixture(scope="module")
def site(tmp_path_factory, start_shared):
    return Site(tmp_path_factory.mktemp("site") / "pki", start_shared)


@pytest.fixture
def log_in(site):
    """Open a session with the certificate of a component."""
    with ExitStack() as stack:
        yield lambda name: stack.enter_context(connect(site.settings(name), timeout=DEADLINE))


@pytest.fixture
def all_seeing(log_in):
    """A session with the certificate of a router, which may see everything."""
    return log_in("hall")


def samples(channel):
    keys = []
    while (sample := channel.try_recv()) is not None:
        keys.append(str(sample.key_expr))
    return keys


def say(session, name):
    """Publish something allowed that everyone with the right to can tell: a Status."""
    publisher = session.declare_publisher(KEYS.stream("status", name))
    until_heard(publisher)
    publisher.put(b"allowed")


# What each role must not write: (component, key).
FORBIDDEN_PUTS = [
    ("cam", KEYS.stream("obs", "mocap")),
    ("cam", KEYS.stream("truth", "mocap")),
    ("cam", KEYS.stream("joints", "mocap")),
    ("cam", KEYS.stream("preview", "mocap")),
    ("cam", KEYS.stream("status", "mocap")),
    ("cam", KEYS.stream("status", "fusion")),
    ("cam", KEYS.stream("obs", "cam") + "/more"),
    ("cam", OTHER_SCENE.stream("obs", "cam")),
    ("cam", KEYS.hypotheses),
    ("cam", "anything/else"),
    ("laptop", KEYS.hypotheses),
    ("laptop", KEYS.stream("obs", "cam")),
    ("laptop", KEYS.stream("status", "fusion")),
    ("laptop", KEYS.stream("truth", "laptop")),
    ("disk", KEYS.hypotheses),
    ("disk", KEYS.stream("obs", "disk")),
    ("fusion", KEYS.stream("obs", "cam")),
    ("fusion", KEYS.stream("status", "cam")),
    ("fusion", OTHER_SCENE.hypotheses),
]


def test_puts_outside_ones_own_keys_arrive_nowhere(log_in, all_seeing):
    everything = all_seeing.declare_subscriber("comotion/@v1/**", RingChannel(1000))
    beyond = all_seeing.declare_subscriber("anything/**", RingChannel(1000))
    sessions = {name: log_in(name) for name, _ in FORBIDDEN_PUTS}
    for name, key in FORBIDDEN_PUTS:
        sessions[name].put(key, b"forged", priority=zenoh.Priority.REAL_TIME)
    for name, session in sessions.items():
        say(session, name)
    allowed, arrived = {KEYS.stream("status", name) for name in sessions}, set()
    until(lambda: allowed <= arrived, lambda: arrived.update(samples(everything)))
    assert arrived == allowed
    assert samples(beyond) == []


@pytest.mark.parametrize("name", ROLES)
def test_nobody_can_claim_the_presence_of_another(name, log_in, all_seeing):
    presence = all_seeing.liveliness().declare_subscriber("comotion/@v1/**", RingChannel(100), history=True)
    session = log_in(name)
    tokens = [
        session.liveliness().declare_token(KEYS.live(role, other))
        for role in ROLES.values()
        for other in ROLES
        if other != name
    ]
    mine = session.liveliness().declare_token(KEYS.live(ROLES[name], name))
    assert str(presence.recv().key_expr) == KEYS.live(ROLES[name], name)
    assert samples(presence) == []
    for token in (*tokens, mine):
        token.undeclare()


def test_a_source_reads_nothing_of_others(log_in, all_seeing):
    spy = log_in("cam")
    wanted = [KEYS.streams("obs"), KEYS.stream("obs", "mocap"), KEYS.hypotheses, KEYS.streams("status")]
    wanted += [KEYS.stream("joints", "mocap"), "comotion/@v1/**", "**", KEYS.stream("preview", "mocap")]
    rings = [spy.declare_subscriber(key, RingChannel(10)) for key in wanted]
    tokens = spy.liveliness().declare_subscriber("**", RingChannel(10), history=True)
    witness = all_seeing.declare_subscriber("comotion/@v1/**", RingChannel(10))
    mocap = log_in("mocap")
    token = mocap.liveliness().declare_token(KEYS.live("source", "mocap"))
    for kind in ("obs", "joints", "preview", "status"):
        publisher = mocap.declare_publisher(KEYS.stream(kind, "mocap"))
        until_heard(publisher)
        publisher.put(b"secret")
    seen: list[str] = []
    while len(seen) < 4:
        seen += samples(witness)
    # One round trip later nothing is under way any more.
    assert list(spy.get(KEYS.query("status"), timeout=0.5)) == []
    token.undeclare()
    assert [samples(ring) for ring in (*rings, tokens)] == [[]] * (len(rings) + 1)


def test_queries_are_answered_by_the_service_alone_and_viewers_cannot_forget(log_in):
    def answer(query):
        with query:
            query.reply(query.key_expr, b"yes")

    service, viewer, source = log_in("fusion"), log_in("laptop"), log_in("cam")
    real = [service.declare_queryable(KEYS.query(name), answer) for name in ("status", "forget")]
    false = [s.declare_queryable(KEYS.query("config"), answer) for s in (viewer, source)]

    def replies(session, name):
        return sum(reply.ok is not None for reply in session.get(KEYS.query(name), timeout=1.0))

    until(lambda: replies(viewer, "status") == 1)  # the router knows of it
    assert replies(log_in("disk"), "config") == 0
    assert replies(viewer, "forget") == 0
    assert replies(source, "status") == 0
    assert replies(source, "forget") == 0
    assert replies(service, "forget") == 1
    assert [reply.ok for reply in viewer.get(OTHER_SCENE.query("status"), timeout=1.0)] == []
    for queryable in (*real, *false):
        queryable.undeclare()


def raw_client(site, tls, protocol="tls"):
    """Whether a client gets a session, whatever we would say of its certificate."""
    settings = SessionSettings(connect=(site.endpoint,), tls=tls or load_tls(site.authority.folder / "cam"))
    config = zenoh_config(settings)
    link = config["transport"]["link"]
    link["protocols"] = ["tls", "tcp"]
    if tls is None or tls.certificate is None:
        for word in ("connect_certificate", "connect_private_key", "enable_mtls"):
            del link["tls"][word]
    endpoints = [f"{protocol}/localhost:{site.port}"]
    config["connect"] = {"endpoints": endpoints, "timeout_ms": 1000, "exit_on_failure": True}
    try:
        zenoh.open(zenoh.Config.from_json5(json.dumps(config))).close()
    except zenoh.ZError:
        return False
    return True


def test_only_a_valid_certificate_of_the_authority_connects(site, tmp_path):
    own = load_tls(site.authority.folder / "cam")
    assert raw_client(site, own)
    stranger = Authority.create(tmp_path / "strange")
    issue(stranger, "source", "cam")
    strange = load_tls(stranger.folder / "cam")
    assert not raw_client(site, replace(strange, root_ca=own.root_ca)), "signed by another authority"
    assert not raw_client(site, strange), "and it would not trust our router either"
    issue(site.authority, "source", "old", days=-1)
    old = site.authority.folder / "old"
    expired = TlsFiles(root_ca=old / "ca.crt", certificate=old / "component.crt", key=old / "component.key")
    assert not raw_client(site, expired), "expired"
    assert not raw_client(site, replace(own, certificate=None)), "no certificate"
    assert not raw_client(site, None, protocol="tcp"), "no encryption"


def test_a_link_ends_with_its_certificate(site):
    issue(site.authority, "source", "brief", days=3.0 / 86_400)
    with connect(site.settings("brief"), timeout=DEADLINE) as session:
        until(lambda: not list(session.info.routers_zid()))


def test_a_batch_over_the_limit_is_dropped_and_the_next_one_arrives(site, log_in, all_seeing):
    arrived = all_seeing.declare_subscriber(KEYS.stream("obs", "cam"), RingChannel(10))
    publisher = log_in("cam").declare_publisher(KEYS.stream("obs", "cam"))
    until_heard(publisher)
    publisher.put(bytes(5 * 1024 * 1024))
    # Again and again, for the limit of the rate may meet it where the router is late.
    with every(1.5 / RATE, lambda _: publisher.put(b"small")):
        assert arrived.recv().payload.to_bytes() == b"small"


def test_a_flood_is_cut_to_its_rate_and_others_lose_nothing(log_in, all_seeing):
    drop = zenoh.CongestionControl.DROP
    flood, other = (
        log_in(name).declare_publisher(KEYS.stream("obs", name), congestion_control=drop)
        for name in ("cam", "mocap")
    )
    flooded = all_seeing.declare_subscriber(KEYS.stream("obs", "cam"), RingChannel(10_000))
    arrived = all_seeing.declare_subscriber(KEYS.stream("obs", "mocap"), RingChannel(1000))
    until_heard(flood)
    until_heard(other)

    def send(count):
        """100 times the rate of the other, which keeps below its own limit."""
        for _ in range(count):
            flood.put(b"x" * 500)
            time.sleep(2 / RATE / 200)

    began = time.monotonic()
    for seq in range(20):
        send(50)
        other.put(seq.to_bytes(4, "little"))
        send(50)
        # Once it has arrived, the next one is late enough for the limit, however long this one took.
        assert int.from_bytes(arrived.recv().payload.to_bytes(), "little") == seq
        send(100)
    passed, lasted = len(samples(flooded)), time.monotonic() - began
    assert 0 < passed <= RATE * lasted + 1


def test_adding_a_component_is_one_command_and_a_restart(site, listen, all_seeing):
    """The router restarts in place by SIGHUP, and for good; a source and its listener go on by themselves."""
    witness = listen(all_seeing, KEYS.stream("status", "mocap"), "status")
    updates = listen(all_seeing, KEYS.stream("obs", "mocap"), "obs")
    with Component(role="source", name="mocap", settings=site.settings("mocap")) as source:
        tracker = Source(source, TWO_BODIES)

        def publish_until(goal):
            def publish():
                tracker.send()
                time.sleep(2 / RATE)

            until(lambda: any(goal(batch) for batch in updates.drain()), publish)

        publish_until(lambda batch: batch.seq > 3)
        issue(site.authority, "viewer", "new")
        site.router.signal(signal.SIGHUP)
        site.router.wait_line(lambda line: "restarted" in line)
        before = tracker.sent
        publish_until(lambda batch: batch.seq >= before)
        with connect(site.settings("new"), timeout=DEADLINE) as added:
            mailbox = listen(added, KEYS.streams("status"), "status")
            assert isinstance(mailbox.until(lambda status: status.component == "mocap"), Status)
        site.router.kill()
        site.router = site.start_router()
        before = tracker.sent
        publish_until(lambda batch: batch.seq >= before)
        witness.until(lambda status: status.component == "mocap")


def test_a_bad_folder_does_not_stop_a_running_router(site, log_in, all_seeing):
    authority = site.authority.folder / "ca.crt"
    content = authority.read_bytes()
    authority.write_bytes(b"damaged")
    try:
        site.router.signal(signal.SIGHUP)
        site.router.wait_line(lambda line: "not restarted" in line)
    finally:
        authority.write_bytes(content)
    everything = all_seeing.declare_subscriber("comotion/@v1/**", RingChannel(10))
    say(log_in("cam"), "cam")
    assert str(everything.recv().key_expr) == KEYS.stream("status", "cam")


def test_the_commands_work_with_certificates(site, start, tmp_path):
    """A whole scene over a secure router, and a second router behind which a viewer sees it all."""
    folder = site.authority.folder
    issue(site.authority, "router", "annex")
    issue(site.authority, "source", "sim", sources=("sim-1", "sim-2"), scene="cell")
    issue(site.authority, "service", "cell-fusion", scene="cell")
    issue(site.authority, "viewer", "tablet", scene="*")
    site.router.kill()
    quic, port = (free_endpoint().rpartition(":")[2] for _ in range(2))
    main = ("--listen", f"tls/127.0.0.1:{site.port}", "--listen", f"quic/127.0.0.1:{quic}")
    site.router = start("router", "--secure", folder, "--tls", folder / "hall", *main)
    annex = ("--listen", f"tls/127.0.0.1:{port}", "--connect", f"quic/127.0.0.1:{quic}")
    start("router", "--secure", folder, "--tls", folder / "annex", *annex)
    at = ("--connect", site.endpoint, "--scene", "cell")
    start("serve", "--tls", folder / "cell-fusion", *at)
    certificate = {"COMOTION_TLS": str(folder / "sim")}
    start("source", "simulator", "fig4_4", "--rate", "25,25", "--loop", *at, env=certificate)
    far = ("--connect", f"tls/localhost:{port}", "--scene", "cell", "--tls", folder / "tablet")
    watch = start("watch", "--once", "--json", "--timeout", 60, *far, ready=False)
    assert watch.wait() == 0
    shown = json.loads(watch.output)
    assert {row["name"] for row in shown["sources"]} == {"sim-1", "sim-2"}
    look = start("status", "--json", *far, ready=False)
    look.wait()
    state = json.loads(look.output)
    assert {row["name"] for row in state["components"]} >= {"cell-fusion", "sim-1", "sim-2"}, state
    assert [(row["name"], row["routers"]) for row in state["routers"]] == [("annex", 1), ("hall", 1)]
    wrong = start("serve", "--tls", folder / "tablet", *at, ready=False)
    assert wrong.wait() == 2
    assert "the certificate of viewer 'tablet' is not for a service" in wrong.output
