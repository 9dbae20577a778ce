"""Which hypothesis each trajectory belongs to, from one update to the next."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Event

from ..arrays import Slots
from ..partition import NO_HYPOTHESIS
from ..trajectories.window import Window
from .events import Membership, changes
from .propagation import follow

Labels = NDArray[np.int64]


class LabelMemory:
    """Labels of all slots of a window, and since when there are the hypotheses.

    Attributes
    ----------
    label
        int64 [capacity]: hypothesis of each slot, or :data:`NO_HYPOTHESIS`.
    born_ns
        Event time at which each hypothesis that lives was first noted.
    """

    def __init__(self) -> None:
        self.label: Labels = np.zeros(0, np.int64)
        self.born_ns: dict[int, int] = {}
        self._before = Membership.empty()

    def fit(self, window: Window) -> None:
        """Make room for every slot of the window."""
        extra = window.capacity - len(self.label)
        if extra:
            self.label = np.pad(self.label, (0, extra), constant_values=NO_HYPOTHESIS)

    def forget(self, window: Window, slots: Slots) -> None:
        """Slots are about to be freed."""
        self.fit(window)
        self.label[slots] = NO_HYPOTHESIS

    def lead(self, window: Window, named: Slots, before: Labels, now: Labels) -> None:
        """Have the dormant, all but those `named` anew, follow the current from `before` to `now`."""
        waiting = window.used & ~window.ended
        waiting[named] = False
        dormant = np.flatnonzero(waiting)
        self.label[dormant] = follow(before, now, self.label[dormant])

    def note(self, window: Window, stamp_ns: int) -> list[Event]:
        """Take down who belongs where; the events since the last time."""
        after = self._membership(window)
        events = changes(stamp_ns, self._before, after)
        self._before = after
        self.born_ns = {h: self.born_ns.get(h, stamp_ns) for h in after.hypotheses}
        return events

    def _membership(self, window: Window) -> Membership:
        """Of everyone who is here or may come back."""
        slots = np.flatnonzero(window.used & ~window.ended & (self.label != NO_HYPOTHESIS))
        return Membership(window.key[slots], self.label[slots])

    def state(self, window: Window) -> dict[str, Any]:
        """As plain arrays: labels by trajectory, births by hypothesis."""
        self.fit(window)
        slots = window.slots()
        return {
            "tracks": window.key[slots],
            "labels": self.label[slots],
            "hypotheses": np.array(list(self.born_ns), np.int64),
            "born_ns": np.array(list(self.born_ns.values()), np.int64),
        }

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up :meth:`state`; an empty one says nothing."""
        self.fit(window)
        if not state:
            return
        slots = window.slots()
        label_of = dict(zip(state["tracks"].tolist(), state["labels"].tolist(), strict=True))
        self.label[slots] = [label_of.get(key, NO_HYPOTHESIS) for key in window.key[slots].tolist()]
        self.born_ns = dict(zip(state["hypotheses"].tolist(), state["born_ns"].tolist(), strict=True))
        self._before = self._membership(window)
