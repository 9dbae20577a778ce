"""A bounded queue between receiving threads and a reading thread or event loop."""

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from .errors import KnownError

T = TypeVar("T")


class Closed(Exception):  # noqa: N818 - the end of a stream, not an error
    """The inbox is closed and empty."""


class Inbox(Generic[T]):
    """Keeps the newest items; `put` never blocks, `get` waits.

    Parameters
    ----------
    capacity
        Most items kept, at least 1; then the oldest are dropped and counted in :attr:`dropped`.
    size
        How much of the capacity an item takes.
    on_drop
        Called with each item that is dropped, by one thread at a time.

    Raises
    ------
    ValueError
        If the capacity is below 1.
    """

    def __init__(
        self,
        capacity: int,
        size: Callable[[T], int] = lambda _: 1,
        on_drop: Callable[[T], object] = lambda _: None,
    ) -> None:
        if capacity < 1:
            raise KnownError("the capacity of an inbox is at least 1")
        self.dropped = 0
        self._items: deque[T] = deque()
        self._free = capacity
        self._size, self._on_drop = size, on_drop
        self._closed = False
        self._changed = threading.Condition()
        self._waiters: set[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = set()

    def put(self, item: T) -> None:
        """Add an item from any thread."""
        with self._changed:
            self._items.append(item)
            self._free -= self._size(item)
            while self._free < 0:
                self._on_drop(self._take())
                self.dropped += 1
            self._notify()

    def close(self) -> None:
        """Close the inbox; readers get the remaining items first."""
        with self._changed:
            self._closed = True
            self._notify()

    def wait(self, timeout: float) -> bool:
        """Wait until there is an item or the inbox is closed; False after `timeout` seconds."""
        with self._changed:
            return bool(self._changed.wait_for(lambda: self._items or self._closed, timeout))

    def get(self, timeout: float | None = None) -> T:
        """Take the oldest item.

        Raises
        ------
        TimeoutError
            If no item arrives within `timeout` seconds (None: no limit).
        Closed
            If the inbox is closed and empty.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: self._items or self._closed, timeout):
                raise TimeoutError
            return self._take()

    def drain(self) -> list[T]:
        """Take all items at once."""
        with self._changed:
            return [self._take() for _ in range(len(self._items))]

    async def aget(self, timeout: float | None = None) -> T:
        """:meth:`get` for asyncio; cancelling it loses no item."""
        waiter = asyncio.get_running_loop(), asyncio.Event()
        async with asyncio.timeout(timeout):
            while True:
                with self._changed:
                    if self._items or self._closed:
                        return self._take()
                    waiter[1].clear()
                    self._waiters.add(waiter)
                try:
                    await waiter[1].wait()
                finally:
                    with self._changed:
                        self._waiters.discard(waiter)

    def _take(self) -> T:
        if not self._items:
            raise Closed
        item = self._items.popleft()
        self._free += self._size(item)
        return item

    def _notify(self) -> None:
        self._changed.notify_all()
        for loop, woken in self._waiters:
            # The loop may have been closed while somebody waited in it.
            if not loop.is_closed():
                loop.call_soon_threadsafe(woken.set)
        self._waiters.clear()
