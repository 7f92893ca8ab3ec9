"""Open datasets of any format."""

from __future__ import annotations

from pathlib import Path

from simfoundry.data.dataset.formats import FORMATS, DatasetFormat, StoredDataset, dataset_format
from simfoundry.data.dataset.manifest import read_manifest
from simfoundry.errors import OutputError, SimfoundryError


def recognized_format(folder: Path) -> str:
    """Return the name of the format of a dataset.

    Raises:
        SimfoundryError: If the folder does not exist, or does not contain a dataset in a known format.
    """
    if not folder.is_dir():
        raise SimfoundryError(f"{folder} is not a folder of a dataset")
    manifest = read_manifest(folder)
    if manifest is not None and manifest.format in FORMATS:
        return manifest.format
    for name in FORMATS.names():
        if dataset_format(name).recognizes(folder):
            return name
    inner = [path for path in sorted(folder.iterdir()) if path.is_dir() and read_manifest(path) is not None]
    if inner:
        raise OutputError(f"{folder} contains several datasets; choose one of them, such as {inner[0]}")
    known = ", ".join(FORMATS.names()) or "none"
    raise OutputError(f"{folder} does not contain a dataset in a known format; known formats: {known}")


def open_dataset(folder: Path) -> tuple[DatasetFormat, StoredDataset]:
    """Open a dataset, and return its format and its content.

    Raises:
        SimfoundryError: If the folder does not contain a valid dataset.
    """
    found = dataset_format(recognized_format(folder))
    return found, found.read(folder)
