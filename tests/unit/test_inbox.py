"""The bounded queue between a receiving thread and its reader; tests/e2e/test_subscribe.py reads from it."""

import asyncio
import threading

import pytest

from comotion_clients.inbox import Closed, Inbox


def test_the_oldest_makes_room_and_is_counted() -> None:
    inbox: Inbox[int] = Inbox(2)
    for item in range(5):
        inbox.put(item)
    assert inbox.dropped == 3
    assert [inbox.get(0), inbox.get(0)] == [3, 4]


def test_an_inbox_without_room_is_refused() -> None:
    with pytest.raises(ValueError, match="capacity"):
        Inbox(0)


def test_a_closed_inbox_is_drained_and_then_ends() -> None:
    inbox: Inbox[int] = Inbox(1)
    inbox.put(1)
    inbox.close()
    assert inbox.get() == 1
    with pytest.raises(Closed):
        inbox.get()


def test_asyncio_ends_with_the_inbox_and_with_the_timeout() -> None:
    inbox: Inbox[int] = Inbox(1)

    async def read() -> None:
        with pytest.raises(TimeoutError):
            await inbox.aget(0.01)
        closer = threading.Thread(target=inbox.close)
        closer.start()
        with pytest.raises(Closed):
            await inbox.aget(30)
        closer.join()

    asyncio.run(read())


def test_cancelling_a_reader_loses_no_item() -> None:
    inbox: Inbox[int] = Inbox(4)

    async def read() -> int:
        task = asyncio.create_task(inbox.aget(30))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        inbox.put(7)
        return await inbox.aget(30)

    assert asyncio.run(read()) == 7
