"""Links between processes of this machine that a test can cut: nothing passes and neither side is told."""

import asyncio
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


class Wire:
    """Carries TCP in a thread while it is whole; what was sent before or during a cut arrives after it.

    Parameters
    ----------
    target
        ``tcp/127.0.0.1:PORT`` or ``http://127.0.0.1:PORT``; :attr:`endpoint` has the same form.
    """

    def __init__(self, target):
        self._loop = asyncio.new_event_loop()
        self._whole = asyncio.Event()
        self._whole.set()
        self._tasks: set[asyncio.Task[Any]] = set()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._port = urlsplit(target.replace("tcp/", "tcp://")).port
        self._server = self._do(asyncio.start_server(self._carry, _HERE, 0))
        self.endpoint = target.replace(str(self._port), str(self._server.sockets[0].getsockname()[1]))

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
        self._server.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

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
