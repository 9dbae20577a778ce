"""Real processes over real Zenoh on a free loopback port, and events to wait for instead of sleeps.

Fixtures
--------
``start(*arguments)`` runs ``comotion ARGUMENTS`` and waits until it is ready; ``endpoint`` is that
of a running router; ``session`` is a Zenoh client session there; ``listen(key, kind)`` subscribes
and answers with a mailbox whose ``until(predicate)`` awaits a message; ``heard(publisher)`` waits until
somebody subscribes to what it publishes; ``etcd`` is a cluster of one.
"""

import itertools
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from comotion_schemas import Keys, Message, ObservationBatch, decode, encode
from comotion_schemas.component import Component
from comotion_schemas.keys import Kind
from comotion_schemas.transport import SessionSettings, declare_subscriber, open_session, stream_publisher

from ..builders import batch
from .etcd_cluster import EtcdCluster

DEADLINE = 120.0
"""s after which what is awaited counts as missing; long, for a loaded machine takes its time."""


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class Process:
    """One command under test; its lines are read as they come."""

    def __init__(
        self,
        arguments: tuple[str, ...],
        env: Mapping[str, str] | None = None,
        cwd: Path | None = None,
        program: tuple[str, ...] = (sys.executable, "-m", "comotion_deploy"),
    ) -> None:
        self.arguments = arguments
        self.popen = subprocess.Popen(
            [*program, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=cwd,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **(env or {})},
            # A group of its own: Ctrl-C is sent to all of it, as a terminal would.
            start_new_session=True,
        )
        self.lines: list[str] = []
        self._news = threading.Condition()
        self._ended = False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.popen.stdout is not None
        for line in self.popen.stdout:
            with self._news:
                self.lines.append(line.rstrip("\n"))
                self._news.notify_all()
        with self._news:
            self._ended = True
            self._news.notify_all()

    @property
    def pid(self) -> int:
        return self.popen.pid

    @property
    def output(self) -> str:
        return "\n".join(self.lines)

    def wait_line(self, wanted: Callable[[str], bool], deadline: float = DEADLINE, start: int = 0) -> str:
        """The first line from number `start` on that is wanted."""

        def found() -> str | None:
            return next((line for line in self.lines[start:] if wanted(line)), None)

        with self._news:
            self._news.wait_for(lambda: self._ended or found() is not None, deadline)
            line = found()
        assert line is not None, f"comotion {' '.join(self.arguments)} did not say so:\n{self.output}"
        return line

    def wait_ready(self, deadline: float = DEADLINE) -> None:
        self.wait_line(lambda line: line == "ready", deadline)

    def wait(self, deadline: float = DEADLINE) -> int:
        """The exit status, with all output read."""
        status = self.popen.wait(deadline)
        self._reader.join(deadline)
        return status

    def signal(self, number: signal.Signals) -> None:
        self.popen.send_signal(number)

    def interrupt(self) -> None:
        """Ctrl-C at the terminal: the signal goes to the whole foreground group."""
        os.killpg(self.popen.pid, signal.SIGINT)

    def kill(self) -> None:
        self.popen.kill()
        self.popen.wait(DEADLINE)

    def close(self) -> None:
        if self.popen.poll() is None:
            self.popen.terminate()
            try:
                self.popen.wait(DEADLINE)
            finally:
                # One that does not stop when told to has failed its test, and is not left behind.
                self.popen.kill()
                self.popen.wait(DEADLINE)
        self._reader.join(DEADLINE)
        if self.popen.stdout is not None:
            self.popen.stdout.close()


class Mailbox:
    """Decoded messages of one key expression, in the order of arrival."""

    def __init__(self, session: zenoh.Session, key: str, kind: Kind) -> None:
        self._queue: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._subscriber = declare_subscriber(session, key, kind, self._put)

    def _put(self, sample: zenoh.Sample) -> None:
        self._queue.put(decode(sample.payload.to_bytes()))

    def next(self, deadline: float = DEADLINE) -> Any:
        return self._queue.get(timeout=deadline)

    def until(self, predicate: Callable[[Any], bool], deadline: float = DEADLINE) -> Any:
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

    def drain(self) -> list[Any]:
        """What has arrived so far."""
        messages = []
        while not self._queue.empty():
            messages.append(self._queue.get())
        return messages

    def close(self) -> None:
        self._subscriber.undeclare()


def two_bodies(stamp_ns: int) -> np.ndarray:
    """Twelve features in metres: the first six move along x, the others along y."""
    rng = np.random.default_rng(7)
    positions = rng.random((12, 3)) * 0.4
    swing = 0.3 * np.sin(2 * np.pi * 0.5 * (stamp_ns % 10**12) / 1e9)
    positions[:6, 0] += swing
    positions[6:, 1] += 1.0 + swing
    return positions.astype(np.float32)


def observe(name: str, session: str, seq: int, stamp_ns: int) -> ObservationBatch:
    """What a tracker of :func:`two_bodies` publishes."""
    return batch(name, seq, stamp_ns, two_bodies(stamp_ns), session=session)


@contextmanager
def every(seconds: float, step: Callable[[int], object]) -> Iterator[None]:
    """Call ``step(0)``, ``step(1)`` and so on, in a thread, for as long as the context lasts."""
    over = threading.Event()

    def run() -> None:
        for seq in itertools.count():
            if over.wait(seconds):
                return
            step(seq)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    yield
    over.set()
    thread.join(DEADLINE)


@contextmanager
def tracking(endpoint: str, name: str, rate: float, scene: str) -> Iterator[None]:
    """A well-behaved source of :func:`two_bodies`."""
    settings = SessionSettings(connect=(endpoint,))
    with Component(role="source", name=name, scene=scene, settings=settings) as component:
        publisher = stream_publisher(component.session, component.keys, "obs", name)

        def step(seq: int) -> None:
            publisher.put(encode(observe(name, component.session_id, seq, time.time_ns())))

        with every(1 / rate, step):
            yield


@contextmanager
def routing(endpoint: str) -> Iterator[zenoh.Session]:
    """A router in the process of the test, there at once; `comotion router` opens the same session."""
    with open_session(SessionSettings(mode="router", connect=(), listen=(endpoint,))) as router:
        yield router


Start = Callable[..., Process]
Listen = Callable[..., Mailbox]
Track = Callable[..., None]
Connect = Callable[[str], zenoh.Session]
KEYS = Keys()


class Service:
    """A running service and a client's session at it."""

    def __init__(self, process: Process, endpoint: str, session: zenoh.Session, listen: Listen) -> None:
        self.process, self.endpoint, self.session = process, endpoint, session
        self.updates = listen(session, KEYS.hypotheses, "hypotheses")
        self.statuses = listen(session, KEYS.stream("status", "fusion"), "status")


class Commands(ExitStack):
    """Runs commands, and stops them in the end, the last one first; `ready=False` to not wait for one."""

    def __call__(
        self,
        *arguments: object,
        ready: bool = True,
        env: Mapping[str, str] | None = None,
        cwd: Path | None = None,
    ) -> Process:
        process = Process(tuple(map(str, arguments)), env, cwd)
        self.callback(process.close)
        if ready:
            process.wait_ready()
        return process


@pytest.fixture
def start() -> Iterator[Commands]:
    """Run a command for one test."""
    with Commands() as commands:
        yield commands


@pytest.fixture(scope="module")
def start_shared() -> Iterator[Commands]:
    """Run a command for all tests of a module."""
    with Commands() as commands:
        yield commands


@pytest.fixture
def spawn() -> Callable[..., Process]:
    """Start any program; the caller closes it."""
    return lambda *command: Process(tuple(map(str, command)), program=())


@pytest.fixture
def free_port_endpoint() -> str:
    """An endpoint that nobody listens at yet."""
    return free_endpoint()


@pytest.fixture(scope="module")
def shared_endpoint() -> str:
    """An endpoint for what the tests of a module share."""
    return free_endpoint()


@pytest.fixture
def router(start: Commands, free_port_endpoint: str) -> zenoh.Session:
    """The router of :func:`endpoint`; it outlives the commands that are started after it."""
    return start.enter_context(routing(free_port_endpoint))


@pytest.fixture
def endpoint(router: zenoh.Session, free_port_endpoint: str) -> str:
    """Endpoint of a running router."""
    return free_port_endpoint


@pytest.fixture
def connect() -> Iterator[Connect]:
    """Open a client session: ``connect(endpoint)``."""
    with ExitStack() as stack:
        yield lambda endpoint: stack.enter_context(open_session(SessionSettings(connect=(endpoint,))))


@pytest.fixture
def session(endpoint: str, connect: Connect) -> zenoh.Session:
    """A client session at the router."""
    return connect(endpoint)


@pytest.fixture
def listen() -> Iterator[Listen]:
    """Subscribe: ``listen(session, key, kind)``."""
    with ExitStack() as stack:

        def subscribe(session: zenoh.Session, key: str, kind: Kind) -> Mailbox:
            mailbox = Mailbox(session, key, kind)
            stack.callback(mailbox.close)
            return mailbox

        yield subscribe


@pytest.fixture
def track() -> Iterator[Track]:
    """Publish two bodies: ``track(endpoint, name, rate, scene)``."""
    with ExitStack() as stack:

        def run(endpoint: str, name: str = "tracker", rate: float = 20.0, scene: str = "default") -> None:
            stack.enter_context(tracking(endpoint, name, rate, scene))

        yield run


@pytest.fixture
def etcd(tmp_path: Path) -> Iterator[EtcdCluster]:
    """One server of etcd."""
    with EtcdCluster(tmp_path) as cluster:
        yield cluster


@pytest.fixture
def serve(start: Start, free_port_endpoint: str, connect: Connect, listen: Listen) -> Callable[..., Service]:
    """Run a service that is its own router: ``serve(*arguments)``."""

    def run(*arguments: object) -> Service:
        process = start("serve", "--listen", free_port_endpoint, *arguments)
        return Service(process, free_port_endpoint, connect(free_port_endpoint), listen)

    return run


def until_heard(publisher: zenoh.Publisher) -> zenoh.Publisher:
    """Wait until the session knows of a subscriber; until then Zenoh drops what is put."""
    matched = threading.Event()
    listener = publisher.declare_matching_listener(lambda status: status.matching and matched.set())
    if publisher.matching_status.matching:
        matched.set()
    assert matched.wait(DEADLINE)
    listener.undeclare()
    return publisher


@pytest.fixture
def heard() -> Callable[[zenoh.Publisher], zenoh.Publisher]:
    """Wait until somebody subscribes to what a publisher publishes."""
    return until_heard
