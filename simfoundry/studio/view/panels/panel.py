"""The contract of panels, and small parts that several of them use."""

from __future__ import annotations

import html
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from simfoundry.studio.view.nodes import Nodes

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow


class Panel:
    """A part of the user interface. It builds its controls when it is created, and follows the session afterwards."""

    # Whether the panel changes documents. Such panels are absent where a document is only shown.
    edits = True

    def __init__(self, window: StudioWindow) -> None:
        self.window = window
        self.session = window.session

    def refresh(self) -> None:
        """Show the present state of the session and the selection. Called with the session's lock held."""

    def nodes(self) -> Nodes:
        """Return what the panel shows in the scene, such as regions. Called with the session's lock held."""
        return {}


def set_value(handle: Any, value: Any) -> None:
    """Set the value or content of a control if it differs, which spares a message."""
    if type(handle).__name__ == "GuiMarkdownHandle":
        value = plain_markdown(value)
    attribute = "value" if hasattr(handle, "value") else "content"
    if getattr(handle, attribute) != value:
        setattr(handle, attribute, value)


def plain_markdown(text: str) -> str:
    """Return Markdown without HTML and images, which browsers would run and fetch.

    Texts of documents, which may come from others, are part of messages.
    """
    return text.replace("<", "‹").replace("![", "! [")


def by_person(callback: Callable[[Any], object]) -> Callable[[Any], None]:
    """Return a callback that ignores changes that the program itself makes to a control."""

    def only_of_people(event: Any) -> None:
        if event.client_id is not None:
            callback(event)

    return only_of_people


def preformatted(text: str) -> str:
    """Return HTML that shows a text as it is."""
    return f'<pre style="white-space:pre-wrap;font-size:0.72em;margin:0.4em">{html.escape(text)}</pre>'
