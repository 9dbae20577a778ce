"""The bounded queue between a receiving thread and its reader; tests/e2e/test_subscribe.py reads from it."""

import asyncio

import pytest

from comotion_clients.inbox import Inbox


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
