"""Which of several services a client hears, and the queue to its reader (tests/e2e/test_subscribe.py)."""

import asyncio
from dataclasses import replace

import pytest

from comotion import Fusion
from comotion_clients.inbox import Inbox
from comotion_clients.subscription import ActiveSession

UPDATE = Fusion().update(0)


# Sessions, epochs and times in s of updates, and which of them are accepted.
HEARD = {
    "a new session is followed, and the one before is not heard beside it": (
        [("a", 0, 0.0), ("b", 0, 0.1), ("a", 0, 0.2), ("b", 0, 0.3), ("a", 0, 1.2)],
        [True, True, False, True, False],
    ),
    "an older session is heard again when the newer is silent": (
        [("a", 0, 0.0), ("b", 0, 0.1), ("a", 0, 1.2), ("b", 0, 1.3)],
        [True, True, True, False],
    ),
    "a higher epoch is followed and a lower one never": (
        [("a", 1, 0.0), ("b", 2, 0.1), ("a", 1, 9.0), ("a", 3, 9.1)],
        [True, True, False, True],
    ),
    "a leap of the epoch is not followed": (
        [("a", 7, 0.0), ("e", 2**64 - 1, 0.1), ("e", 1008, 0.2), ("a", 7, 0.3), ("b", 1007, 0.4)],
        [True, False, False, True, True],
    ),
    # Updates that are not heard keep nothing alive.
    "after ten seconds without an update any epoch is followed": (
        [("e", 2**64 - 1, 0.0), ("a", 7, 9.9), ("e", 2, 9.9), ("a", 7, 10.1), ("a", 8, 10.2)],
        [True, False, False, True, True],
    ),
}


@pytest.mark.parametrize(("heard", "accepted"), HEARD.values(), ids=HEARD)
def test_one_service_is_heard(heard: list[tuple[str, int, float]], accepted: list[bool]) -> None:
    active = ActiveSession()
    updates = [(replace(UPDATE, session=name * 16, epoch=epoch), now) for name, epoch, now in heard]
    assert [active.accepts(update, now) for update, now in updates] == accepted


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
