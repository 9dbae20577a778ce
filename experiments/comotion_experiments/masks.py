"""Writes dense regions as files: an image of hypotheses per frame."""

from pathlib import Path

import cv2
import numpy as np

from comotion_clients.regions import regions
from comotion_schemas.errors import InputError

from .labelled import Labelled

_MOST = np.iinfo(np.uint16).max


class MaskFolder:
    """Writes ``NUMBER.png`` every so many seconds: 16 bits, the hypothesis of each pixel, 0 for none.

    The folder is created if it does not exist.

    Raises
    ------
    InputError
        If the folder cannot be created.
    """

    def __init__(self, folder: Path, every: float) -> None:
        self._folder, self._every_ns = folder, round(every * 1e9)
        self._due_ns: int | None = None
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: {error.strerror}") from None

    def write(self, labelled: Labelled) -> None:
        """Write the regions of one frame if it is due.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        stamp = labelled.frame.stamp_ns
        if self._due_ns is not None and stamp < self._due_ns:
            return
        self._due_ns = stamp + self._every_ns
        hypotheses = regions(labelled.frame.image, labelled.tracks.pixels, labelled.hypotheses)
        path = self._folder / f"{labelled.number:06d}.png"
        image = np.where((hypotheses >= 0) & (hypotheses <= _MOST), hypotheses, 0).astype(np.uint16)
        if not cv2.imwrite(str(path), image):
            raise InputError(f"{path}: cannot be written")
