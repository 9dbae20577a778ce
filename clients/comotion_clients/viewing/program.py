"""The program of Rerun, as a process: its window, or the server of its page."""

import contextlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import rerun_cli

_STOP_S = 2.0


class Program:
    """Runs the program of the package with arguments until :meth:`close`."""

    def __init__(self, *arguments: str) -> None:
        program = Path(rerun_cli.__file__).with_name("rerun.exe" if sys.platform == "win32" else "rerun")
        # As rerun.spawn does: no dialogue at the first start.
        environment = {"RUST_LOG": "error", **os.environ, "RERUN_APP_ONLY": "true"}
        self._output = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115
        self._process = subprocess.Popen(  # noqa: S603 - the viewer of the package
            [str(program), *arguments],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=self._output,
        )

    @property
    def ended(self) -> bool:
        """Whether it has ended.

        Raises
        ------
        OSError
            If it has failed; one line that says why.
        """
        status = self._process.poll()
        if status:
            self._output.seek(0)
            lines = [line.strip() for line in self._output if line.strip()]
            message = next((line for line in lines if "panicked" in line or "rror" in line), "")
            raise OSError(f"the viewer has failed (status {status}): {message or ' '.join(lines)[-200:]}")
        return status is not None

    def close(self) -> None:
        """Stop it."""
        if self._process.poll() is None:
            self._process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_STOP_S)
            self._process.kill()
            self._process.wait()
        self._output.close()
