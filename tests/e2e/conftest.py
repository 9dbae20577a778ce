"""Real processes over real Zenoh on a free loopback port, and events to wait for instead of sleeps."""

import queue
import shlex
import time
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import pytest

from comotion_deploy.demo import free_endpoint
from comotion_schemas import Keys, Message, SourceRef, decode, encode
from comotion_schemas.component import Component
from comotion_schemas.transport import SessionSettings, declare_publisher, declare_subscriber, open_session
from comotion_tools.processes import COMOTION, DEADLINE, Managed
from comotion_tools.soak.load import Kind, Source

from .. import builders
from .etcd_server import EtcdServer
from .waiting import every

KEYS = Keys()
TWO_BODIES = Kind(rate=20, features=6, bodies=2)


def pytest_collection_modifyitems(items):
    """Mark the tests of this folder; they may take long, for each of their waits has its own deadline."""
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            item.add_marker(pytest.mark.e2e)
            item.add_marker(pytest.mark.timeout(900))


class Mailbox:
    """Decoded messages of one key expression, in the order of arrival."""

    def __init__(self, session, key, kind):
        self._queue: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._subscriber = declare_subscriber(session, key, kind, self._put)

    def _put(self, sample):
        self._queue.put(decode(sample.payload.to_bytes()))

    def next(self, deadline=DEADLINE):
        return self._queue.get(timeout=deadline)

    def until(self, predicate, deadline=DEADLINE):
        """The first message from now on that fulfils the predicate; messages before it are dropped."""
        end = time.monotonic() + deadline
        newest = None
        while (left := end - time.monotonic()) > 0:
            try:
                newest = self._queue.get(timeout=left)
            except queue.Empty:
                break
            if predicate(newest):
                return newest
        raise AssertionError(f"nothing of the kind within {deadline} s; the last was {newest}")

    def drain(self):
        """What has arrived so far."""
        messages = []
        while not self._queue.empty():
            messages.append(self._queue.get())
        return messages

    def close(self):
        self._subscriber.undeclare()


@contextmanager
def routing(endpoint):
    """A router in the process of the test, there at once; `comotion router` opens the same session."""
    with open_session(SessionSettings(mode="router", connect=(), listen=(endpoint,))) as router:
        yield router


class Service:
    """A running service, where this test has started it, and a client's session at it."""

    def __init__(self, process, endpoint, session, listen):
        self.process, self.endpoint, self.session = process, endpoint, session
        self.updates = listen(session, KEYS.hypotheses, "hypotheses")
        self.statuses = listen(session, KEYS.stream("status", "fusion"), "status")


class Commands(ExitStack):
    """Runs commands, and stops them in the end, the last one first; `ready=False` to not wait for one."""

    def __call__(self, *words, ready=True, **how):
        process = self.any(*COMOTION, *words, **how)
        if ready:
            process.wait_ready()
        return process

    def any(self, *words, **how):
        """Start any program."""
        command = tuple(map(str, words))
        process = Managed(shlex.join(command), command, **how)
        process.start()
        self.callback(_stop, process)
        return process


def _stop(process):
    # One that does not stop when told to has failed its test, and is not left behind.
    assert process.end(DEADLINE), process.name


def run_commands():
    """Run commands: ``start(*arguments)`` runs ``comotion ARGUMENTS`` and waits until it is ready."""
    with Commands() as commands:
        yield commands


# For one test, and for all tests of a module; so is an endpoint that nobody listens at yet.
start = pytest.fixture(run_commands, name="start")
start_shared = pytest.fixture(run_commands, name="start_shared", scope="module")
free_port_endpoint = pytest.fixture(free_endpoint, name="free_port_endpoint")
shared_endpoint = pytest.fixture(free_endpoint, name="shared_endpoint", scope="module")


@pytest.fixture
def router(start, free_port_endpoint):
    """The router of :func:`endpoint`; it outlives the commands that are started after it."""
    return start.enter_context(routing(free_port_endpoint))


@pytest.fixture
def endpoint(router, free_port_endpoint):
    """Endpoint of a running router."""
    return free_port_endpoint


@pytest.fixture
def connect():
    """Open a client session: ``connect(endpoint)``."""
    with ExitStack() as stack:
        yield lambda endpoint: stack.enter_context(open_session(SessionSettings(connect=(endpoint,))))


@pytest.fixture
def session(endpoint, connect):
    """A client session at the router."""
    return connect(endpoint)


@pytest.fixture
def listen():
    """Subscribe: ``listen(session, key, kind)`` answers with a :class:`Mailbox`."""
    with ExitStack() as stack:
        yield lambda *where: stack.enter_context(closing(Mailbox(*where)))


@pytest.fixture
def track():
    """Publish two bodies: ``track(endpoint, name, scene)``."""
    with ExitStack() as stack:

        def run(endpoint, name="tracker", scene="default"):
            settings = SessionSettings(connect=(endpoint,))
            component = Component(role="source", name=name, scene=scene, settings=settings)
            source = Source(stack.enter_context(component), TWO_BODIES)
            stack.enter_context(every(1 / TWO_BODIES.rate, lambda _: source.send()))

        yield run


@pytest.fixture
def live_scene(session):
    """A source that sees feature 7 and a service that groups it as hypothesis 42, at 20 Hz."""
    observations = declare_publisher(session, KEYS.stream("obs", "camera"), "obs")
    hypotheses = declare_publisher(session, KEYS.hypotheses, "hypotheses")

    def publish(seq):
        now = time.time_ns()
        observations.put(encode(builders.batch("camera", seq, now, ids=[7])))
        fields = {
            "sources": [SourceRef(name="camera", session=builders.SESSION)],
            "track_id": [7],
            "hypotheses": [builders.hypothesis(42, born_ns=now)],
        }
        hypotheses.put(encode(builders.update([42], scene="default", seq=seq, stamp_ns=now, **fields)))

    with every(0.05, publish):
        yield


@pytest.fixture
def etcd(start, tmp_path):
    """One server of etcd."""
    return EtcdServer(start, tmp_path)


@pytest.fixture
def serve(start, free_port_endpoint, connect, listen):
    """Run a service that is its own router: ``serve(*arguments)``."""

    def run(*arguments):
        process = start("serve", "--listen", free_port_endpoint, *arguments)
        return Service(process, free_port_endpoint, connect(free_port_endpoint), listen)

    return run
