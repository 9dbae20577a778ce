"""A clock on which waiting takes no time."""

from comotion_sources.player import Clock

NOW = 1_000_000.0


class SimulatedClock(Clock):
    """Waiting takes no time; the wall clock may be stepped."""

    def __init__(self, wall=NOW):
        self.passed, self.offset = 0.0, wall

    def wall(self):
        return self.offset + self.passed

    def monotonic(self):
        return 5.0 + self.passed

    def wait(self, stop, seconds):
        self.passed += 0.0 if stop.is_set() else seconds
        return stop.is_set()
