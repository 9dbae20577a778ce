"""Writes complete chunks to a file: after any failure the file ends with a complete chunk."""

import contextlib
import os
from pathlib import Path


class ChunkStream:
    """The output stream of an MCAP writer; :meth:`commit` writes pending bytes to the file.

    Parameters
    ----------
    path
        The file; it must not exist.

    Raises
    ------
    OSError
        If the file exists or cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor = create(path)
        self._pending = bytearray()
        self.committed = 0

    @property
    def pending(self) -> int:
        """Number of bytes that :meth:`commit` would write."""
        return len(self._pending)

    def write(self, data: bytes) -> int:
        """Append bytes to the pending ones."""
        self._pending += data
        return len(data)

    def tell(self) -> int:
        """Size of the file after the next commit."""
        return self.committed + len(self._pending)

    def flush(self) -> None:
        """Do nothing: the owner commits when a chunk is complete."""

    def commit(self) -> None:
        """Write all pending bytes and synchronise the file, or write nothing.

        Raises
        ------
        OSError
            If writing fails; pending bytes are then discarded and the file is unchanged.
        """
        if not self._pending:
            return
        try:
            view = memoryview(bytes(self._pending))
            while view:
                view = view[os.write(self._descriptor, view) :]
            # Some file systems report a full disk only here.
            os.fdatasync(self._descriptor)
        except OSError:
            self._pending.clear()
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self.committed)
                os.lseek(self._descriptor, self.committed, os.SEEK_SET)
            raise
        self.committed += len(self._pending)
        self._pending.clear()

    def close(self) -> None:
        """Close the file; pending bytes are discarded."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def create(path: Path) -> int:
    """Create a file for writing and return its descriptor.

    Raises
    ------
    OSError
        If the file exists or cannot be created; one line that names it.
    """
    try:
        return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
    except FileExistsError:
        raise FileExistsError(
            f"{path} exists, and is not replaced: remove it, or give another name"
        ) from None
