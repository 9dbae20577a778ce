"""What sources and clients receive: which service is followed, none is kept waiting, none runs on."""

import asyncio
import threading
from dataclasses import replace
from types import SimpleNamespace

import pytest

from comotion import Fusion
from comotion_clients.subscription import ActiveSession
from comotion_schemas.inbox import Inbox
from comotion_sources.source import Received


class _Session:
    """Stands for a session of Zenoh: gives the handler of a subscriber what is sent."""

    def declare_subscriber(self, key, handler):
        def send(number):
            payload = SimpleNamespace(to_bytes=lambda: bytes([number]))
            handler(SimpleNamespace(key_expr=key, payload=payload))

        self.send = send
        return SimpleNamespace(undeclare=lambda: None)


def test_of_more_than_can_wait_the_newest_are_kept_and_the_others_counted():
    session = _Session()
    inbox = Received(session, "a", capacity=2)
    for number in range(5):
        session.send(number)
    assert [payload[0] for _, payload, _ in inbox.drain()] == [3, 4]
    assert inbox.dropped == 3


def test_a_source_that_is_to_stop_takes_no_more_of_what_waits():
    session, stop = _Session(), threading.Event()
    inbox = Received(session, "a")
    for number in range(5):
        session.send(number)
    taken = []
    for arrival in inbox.until(stop):
        taken.append(arrival)
        stop.set()
    assert [payload[0] for _, payload, _ in taken] == [0]


UPDATE = Fusion().update(0)


# Sessions, epochs and times in s of updates, and which of them are accepted.
UPDATES = {
    "a new session is followed, and the one before is not followed beside it": (
        [("a", 0, 0.0), ("b", 0, 0.1), ("a", 0, 0.2), ("b", 0, 0.3), ("a", 0, 1.2)],
        [True, True, False, True, False],
    ),
    "an older session is followed again when the newer is silent": (
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
    # Updates that are not accepted keep nothing alive.
    "after ten seconds without an update any epoch is followed": (
        [("e", 2**64 - 1, 0.0), ("a", 7, 9.9), ("e", 2, 9.9), ("a", 7, 10.1), ("a", 8, 10.2)],
        [True, False, False, True, True],
    ),
}


@pytest.mark.parametrize(("stamped", "accepted"), UPDATES.values(), ids=UPDATES)
def test_one_service_is_followed(stamped, accepted):
    active = ActiveSession()
    updates = [(replace(UPDATE, session=name * 16, epoch=epoch), now) for name, epoch, now in stamped]
    assert [active.accepts(update, now) for update, now in updates] == accepted


def test_cancelling_a_reader_loses_no_item():
    inbox: Inbox[int] = Inbox(4)

    async def read():
        task = asyncio.create_task(inbox.aget(30))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        inbox.put(7)
        return await inbox.aget(30)

    assert asyncio.run(read()) == 7
