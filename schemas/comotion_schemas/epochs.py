"""Decides by fencing numbers which service of a scene a reader follows. Pure."""

MOST_STEP = 1000
"""A larger step upwards is not followed: one wrong number would shut out every service to come."""
FORGET_S = 10.0
"""After this time without an update the number is forgotten."""


class Epochs:
    """Follows the epoch of a scene upwards; `newest` is that of the last update heard."""

    def __init__(self) -> None:
        self.newest = 0
        self._heard_s = -float("inf")

    def allows(self, epoch: int, now_s: float) -> bool:
        """Whether an update of this epoch is to be heard; `now_s` is on a monotonic clock."""
        return now_s - self._heard_s > FORGET_S or 0 <= epoch - self.newest <= MOST_STEP

    def follow(self, epoch: int, now_s: float) -> None:
        """Take note of an update that is heard."""
        self.newest, self._heard_s = epoch, now_s
