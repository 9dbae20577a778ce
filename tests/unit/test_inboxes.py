"""What sources and clients receive: none is kept waiting, and none runs on when it is to stop."""

import threading
import time
from types import SimpleNamespace

from comotion_clients.inbox import Inbox as ClientInbox
from comotion_sources.received import Inbox


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
    inbox = Inbox(session, "a", capacity=2)
    for number in range(5):
        session.send(number)
    assert [payload[0] for _, payload, _ in inbox.take()] == [3, 4]
    assert inbox.lost == 3


def test_a_source_that_is_to_stop_takes_no_more_of_what_waits():
    session, stop = _Session(), threading.Event()
    inbox = Inbox(session, "a")
    for number in range(5):
        session.send(number)
    taken = []
    for arrival in inbox.until(stop):
        taken.append(arrival)
        stop.set()
    assert [payload[0] for _, payload, _ in taken] == [0]


def test_none_says_that_nothing_has_arrived_for_the_whole_time():
    session, stop = _Session(), threading.Event()
    inbox = Inbox(session, "a")
    session.send(0)
    arrivals, begun = inbox.until(stop, 0.1), time.monotonic()
    assert next(arrivals) is not None
    session.send(1)  # while the first one is processed
    assert next(arrivals) is not None
    # It has set the event again, but has been taken already.
    assert [next(arrivals)] == [None]
    assert time.monotonic() - begun >= 0.1


def test_a_client_waits_for_an_item_or_the_end():
    inbox: ClientInbox[int] = ClientInbox(1)
    assert not inbox.wait(0.01)
    threading.Timer(0.05, inbox.put, [1]).start()
    assert inbox.wait(10)
    assert inbox.get(0) == 1
    inbox.close()
    assert inbox.wait(10)
