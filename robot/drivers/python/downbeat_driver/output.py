"""Standard output is reserved for the edge: all other output goes to standard error."""

from __future__ import annotations

import os
import sys
import threading
from typing import TextIO


class Lines:
    """Writes whole lines. Can be used from any thread."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._lock = threading.Lock()

    def write(self, line: str) -> None:
        # A line break inside would be read as a second answer.
        whole = " ".join(line.split("\n")).replace("\r", " ")
        with self._lock:
            self._stream.write(whole + "\n")
            self._stream.flush()


def protected_stdout() -> Lines:
    """Reserves standard output for the edge. Prints of libraries, in Python or C, go to standard error after this call."""
    sys.stdout.flush()
    own = os.dup(1)
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return Lines(os.fdopen(own, "w", encoding="utf-8"))
