"""Follows one session of the services of a scene at a time.

A service that was stopped and goes on may publish some updates beside its successor. Who has heard the
successor does not go back, unless the successor has fallen silent.
"""

from collections import deque

from comotion_schemas import HypothesisUpdate
from comotion_schemas.epochs import Epochs

_SILENT_S = 1.0
_SILENT_PERIODS = 3
_REMEMBERED = 64


class ActiveSession:
    """Follows one session of the services of a scene."""

    def __init__(self) -> None:
        self._epochs = Epochs()
        self._session = ""
        self._heard_s = 0.0
        self._left: deque[str] = deque(maxlen=_REMEMBERED)

    def accepts(self, update: HypothesisUpdate, now_s: float) -> bool:
        """Whether an update is of the service to hear.

        Parameters
        ----------
        update
            The next one that has arrived.
        now_s
            When, on a monotonic clock.
        """
        if not self._epochs.allows(update.epoch, now_s):
            return False
        if update.session != self._session:
            silent_s = max(_SILENT_S, _SILENT_PERIODS * update.period_ns * 1e-9)
            replaced = update.session in self._left and now_s - self._heard_s <= silent_s
            if replaced and update.epoch == self._epochs.newest:
                return False
            self._left.append(self._session)
            self._session = update.session
        self._epochs.follow(update.epoch, now_s)
        self._heard_s = now_s
        return True
