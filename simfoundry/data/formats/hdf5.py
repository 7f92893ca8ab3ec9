"""HDF5 files that are written without times, and with a plain error if the disk is full."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.runtime.files import naming

if TYPE_CHECKING:
    import h5py

# The version of the file format: robomimic's environments have HDF5 1.10, and could not open later ones.
_VERSIONS = ("earliest", "v110")


class _Stream(io.FileIO):
    """A file that keeps the first error and then ignores what is written.

    HDF5 prints a traceback for each object that it cannot write, and often ends with a segmentation fault.
    """

    error: OSError | None = None

    def write(self, data: object) -> int:
        """Write all bytes, unless a previous write failed."""
        rest = memoryview(data).cast("B")  # type: ignore[arg-type]
        length = len(rest)
        try:
            while self.error is None and len(rest):
                rest = rest[super().write(rest) :]
        except OSError as error:
            self.error = error
        return length

    def truncate(self, size: int | None = None) -> int:
        """Set the length of the file, unless a previous write failed."""
        try:
            if self.error is None:
                return super().truncate(size)
        except OSError as error:
            self.error = error
        return size or 0

    def flush(self) -> None:
        """Do nothing, because nothing is buffered."""


@contextmanager
def new_hdf5_file(path: Path) -> Iterator[h5py.File]:
    """Yield a new HDF5 file. Equal content gives equal bytes.

    Raises:
        OSError: If it cannot be written.
    """
    import h5py

    with naming(path), _Stream(str(path), "w+") as stream:
        try:
            with h5py.File(stream, "w", libver=_VERSIONS, track_order=False) as file:
                yield file
        except (OSError, RuntimeError, ValueError):
            with suppress(OSError):
                stream.close()
            if stream.error is None:
                raise
        if stream.error is not None:
            raise stream.error
