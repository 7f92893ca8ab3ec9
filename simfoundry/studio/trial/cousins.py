"""Step through the cousins of a run, and decide about each of them."""

from __future__ import annotations

from pathlib import Path

from simfoundry.cousins.run.review import CousinEntry, CousinReview, read_cousins, read_reviews, write_review
from simfoundry.errors import SimfoundryError
from simfoundry.spec.open_documents import OpenDocuments
from simfoundry.studio.reading import StudioScene, read_session


class CousinsTour:
    """The cousins of a run, of which one is looked at.

    Attributes:
        folder: The output folder of the run.
        cousins: All of its cousins, of which there is at least one.
        position: The place of the present one in ``cousins``.
    """

    def __init__(self, folder: Path) -> None:
        """Open a run.

        Raises:
            SimfoundryError: If the folder has no manifest or no cousins, or if its review is damaged.
        """
        self.folder = folder
        self.cousins = read_cousins(folder)
        self.position = 0
        if not self.cousins:
            raise SimfoundryError(f"{folder} contains no cousins: the run has accepted no candidate")
        self._reviews = read_reviews(folder)

    @property
    def present(self) -> CousinEntry:
        """The cousin that is looked at."""
        return self.cousins[self.position]

    @property
    def review(self) -> CousinReview | None:
        """The decision about the current cousin, or None."""
        return self._reviews.get(self.present.index)

    @property
    def counts(self) -> tuple[int, int, int]:
        """The number of cousins that were accepted, that were rejected, and that are open."""
        found = [self._reviews[each.index].accepted for each in self.cousins if each.index in self._reviews]
        return sum(found), len(found) - sum(found), len(self.cousins) - len(found)

    def move(self, by: int) -> None:
        """Go to another cousin; after the last one comes the first."""
        self.position = (self.position + by) % len(self.cousins)

    def decide(self, review: CousinReview | None) -> None:
        """Keep a decision about the present cousin, or remove it.

        Raises:
            SimfoundryError: If it cannot be written, or if a rejection has no reason.
        """
        write_review(self.folder, self.present.index, review)
        self._reviews = read_reviews(self.folder)  # with what others have decided meanwhile

    def scene(self) -> StudioScene:
        """Return the scene of the present cousin, as its own task starts it if it has one.

        Raises:
            SimfoundryError: If its document is missing or has errors.
        """
        files = self.present.files
        path = files.get("task") or files.get("scene")
        if path is None or not path.is_file():
            missing = path.name if path is not None else "its document"
            raise SimfoundryError(f"cousin {self.present.index} cannot be shown: {missing} is missing in {self.folder}")
        reading = read_session(path, OpenDocuments(), {})
        if reading.scene is None:
            raise SimfoundryError(f"cousin {self.present.index} cannot be shown: {reading.first_error}")
        return reading.scene
