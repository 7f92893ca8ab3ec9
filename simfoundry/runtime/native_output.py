"""Suppression of messages that native code writes to standard output and standard error."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from threading import RLock

# File descriptors belong to the process. If two threads redirected them at the same time, the second thread would save
# the null device as the original stream, and its restoration would silence the process for good.
_LOCK = RLock()


@contextmanager
def quiet_native_output() -> Iterator[None]:
    """Discard everything that the process prints during the block; only one thread at a time can be in such a block."""
    libc = ctypes.CDLL(None) if sys.platform != "win32" else ctypes.cdll.msvcrt

    def redirect(*descriptors: int) -> None:
        for flush in (sys.stdout.flush, sys.stderr.flush, partial(libc.fflush, None)):
            flush()  # otherwise, buffered output would be written to the new streams
        for stream, descriptor in enumerate(descriptors, 1):
            os.dup2(descriptor, stream)

    with _LOCK:
        nowhere, saved = os.open(os.devnull, os.O_WRONLY), (os.dup(1), os.dup(2))
        try:
            redirect(nowhere, nowhere)
            yield
        finally:
            redirect(*saved)
            for descriptor in (*saved, nowhere):
                os.close(descriptor)
