"""Events to wait for instead of sleeps."""

import itertools
import threading
import time
from contextlib import contextmanager

from comotion_tools.processes import DEADLINE


@contextmanager
def every(seconds, step):
    """Call ``step(0)``, ``step(1)`` and so on, in a thread, for as long as the context lasts."""
    over = threading.Event()

    def run():
        for seq in itertools.count():
            if over.wait(seconds):
                return
            step(seq)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    yield
    over.set()
    thread.join(DEADLINE)


def until(condition, meanwhile=lambda: None):
    """Look again and again until something is so."""
    end = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < end, "what was awaited did not come"
        meanwhile()
        time.sleep(0.005)


def until_heard(publisher):
    """Wait until the session knows of a subscriber; until then Zenoh drops what is put."""
    matched = threading.Event()
    listener = publisher.declare_matching_listener(lambda status: status.matching and matched.set())
    if publisher.matching_status.matching:
        matched.set()
    assert matched.wait(DEADLINE)
    listener.undeclare()
    return publisher
