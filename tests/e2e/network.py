"""Links between processes of this machine that a test can cut: nothing passes and neither side is told."""

import asyncio
import random
import socket
import threading
from contextlib import ExitStack
from typing import Any
from urllib.parse import urlsplit

_CHUNK = 65536
_HERE = "127.0.0.1"


def free_endpoints(count):
    """Endpoints that nobody listens at, each another one."""
    with ExitStack() as stack:
        probes = [stack.enter_context(socket.socket()) for _ in range(count)]
        for probe in probes:
            probe.bind((_HERE, 0))
        return [f"tcp/{_HERE}:{probe.getsockname()[1]}" for probe in probes]


class Link:
    """Carries what is sent while it is open, in a thread; a context manager."""

    def __init__(self):
        self._loop = asyncio.new_event_loop()
        self._whole = asyncio.Event()
        self._whole.set()
        self._tasks: set[asyncio.Task[Any]] = set()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self._do(self._close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def cut(self):
        """Let nothing pass until :meth:`mend`."""
        self._loop.call_soon_threadsafe(self._whole.clear)

    def mend(self):
        """Let everything pass again."""
        self._loop.call_soon_threadsafe(self._whole.set)

    def _do(self, work):
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    async def _close(self):
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


class Wire(Link):
    """A link over TCP: what one side has sent before or during a cut arrives when it is there again.

    Parameters
    ----------
    target
        ``tcp/127.0.0.1:PORT`` or ``http://127.0.0.1:PORT``; :attr:`endpoint` has the same form.
    """

    def __init__(self, target):
        super().__init__()
        self._port = urlsplit(target.replace("tcp/", "tcp://")).port
        self._server = self._do(asyncio.start_server(self._carry, _HERE, 0))
        self.endpoint = target.replace(str(self._port), str(self._server.sockets[0].getsockname()[1]))

    async def _close(self):
        self._server.close()
        await super()._close()

    async def _carry(self, reader, writer):
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        await self._whole.wait()
        try:
            there, back = await asyncio.open_connection(_HERE, self._port)
        except OSError:
            writer.close()
            return
        try:
            await asyncio.gather(self._pass(reader, back), self._pass(there, writer))
        finally:
            writer.close()
            back.close()

    async def _pass(self, reader, writer):
        try:
            while data := await reader.read(_CHUNK):
                await self._whole.wait()
                writer.write(data)
                await writer.drain()
        except ConnectionError:
            pass
        writer.close()


class Side(asyncio.DatagramProtocol):
    """One side of a link of datagrams; where the other is not there, the sender will try again."""

    def __init__(self, take):
        self.datagram_received = take  # type: ignore[method-assign]


class BadLink(Link):
    """A link of datagrams to a port that delays, jitters and loses, in both directions.

    :attr:`port` is where clients send to.
    """

    def __init__(self, target, delay_s=0.05, jitter_s=0.01, loss=0.01):
        super().__init__()
        self._target, self._delay_s, self._jitter_s, self._loss = target, delay_s, jitter_s, loss
        self._rng = random.Random(7)
        self._ways: dict[Any, asyncio.Task[Any]] = {}
        self._front = self._do(self._open(self._forth, local_addr=(_HERE, 0)))
        self.port: int = self._front.get_extra_info("sockname")[1]

    async def _close(self):
        for way in (self._front, *await asyncio.gather(*self._ways.values())):
            way.close()
        await super()._close()

    async def _open(self, take, **where):
        return (await self._loop.create_datagram_endpoint(lambda: Side(take), **where))[0]

    def _forth(self, data, client):
        if client not in self._ways:

            def back(data, _):
                self._carry(self._front, data, client)

            way = self._open(back, remote_addr=(_HERE, self._target))
            self._ways[client] = self._loop.create_task(way)
        self._ways[client].add_done_callback(lambda way: self._carry(way.result(), data))

    def _carry(self, way, *what):
        if self._whole.is_set() and self._rng.random() >= self._loss:
            delay_s = self._delay_s + self._rng.uniform(-self._jitter_s, self._jitter_s)
            self._loop.call_later(delay_s, way.sendto, *what)
