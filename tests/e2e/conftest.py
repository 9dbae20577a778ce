"""Real processes over real Zenoh on a free loopback port, and events to wait for instead of sleeps.

Fixtures
--------
``start(*arguments)`` runs ``comotion ARGUMENTS`` and waits until it is ready; ``endpoint`` is that
of a running router; ``session`` is a Zenoh client session there; ``listen(key, kind)`` subscribes
and answers with a mailbox whose ``until(predicate)`` awaits a message.
"""

import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh

from comotion_schemas import Message, decode
from comotion_schemas.qos import Kind
from comotion_schemas.transport import SessionSettings, declare_subscriber, open_session

DEADLINE = 30.0


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class Process:
    """One command under test; its lines are read as they come."""

    def __init__(self, arguments: tuple[str, ...], env: Mapping[str, str] | None, cwd: Path | None) -> None:
        self.arguments = arguments
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "comotion_deploy", *arguments],
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
                self.popen.wait(10)
            except subprocess.TimeoutExpired:
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


Start = Callable[..., Process]
Listen = Callable[..., Mailbox]


@pytest.fixture
def start() -> Iterator[Start]:
    """Run a command; `ready=False` to not wait for it."""
    with ExitStack() as stack:

        def run(
            *arguments: object,
            ready: bool = True,
            env: Mapping[str, str] | None = None,
            cwd: Path | None = None,
        ) -> Process:
            process = Process(tuple(map(str, arguments)), env, cwd)
            stack.callback(process.close)
            if ready:
                process.wait_ready()
            return process

        yield run


@pytest.fixture
def free_port_endpoint() -> str:
    """An endpoint that nobody listens at yet."""
    return free_endpoint()


@pytest.fixture
def router(start: Start, free_port_endpoint: str) -> Process:
    """The router process of :func:`endpoint`."""
    return start("router", "--listen", free_port_endpoint)


@pytest.fixture
def endpoint(router: Process, free_port_endpoint: str) -> str:
    """Endpoint of a running router."""
    return free_port_endpoint


@pytest.fixture
def session(endpoint: str) -> Iterator[zenoh.Session]:
    """A client session at the router."""
    with open_session(SessionSettings(connect=(endpoint,))) as session:
        yield session


@pytest.fixture
def listen(session: zenoh.Session) -> Iterator[Listen]:
    """Subscribe: ``listen(key, kind)``."""
    with ExitStack() as stack:

        def subscribe(key: str, kind: Kind) -> Mailbox:
            mailbox = Mailbox(session, key, kind)
            stack.callback(mailbox.close)
            return mailbox

        yield subscribe
