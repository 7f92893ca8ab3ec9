"""The features of the server that show something: hover, symbols, hints, colors, links and pictures."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakKeyDictionary

from lsprotocol import types

from simfoundry.language_server.analysis import Analysis
from simfoundry.language_server.cursor.cursor import cursor_at
from simfoundry.language_server.display.colors import color_presentations, document_colors
from simfoundry.language_server.display.formatting import format_edits
from simfoundry.language_server.display.hints import inlay_hints
from simfoundry.language_server.display.hover import HoverContext, hover_at, key_text
from simfoundry.language_server.display.links import document_links
from simfoundry.language_server.display.markdown import plain_text
from simfoundry.language_server.display.outline import document_symbols, folding_ranges, selection_ranges
from simfoundry.language_server.display.preview import Previews
from simfoundry.language_server.display.tokens import LEGEND, semantic_tokens
from simfoundry.language_server.older import LineShift
from simfoundry.language_server.workspace import is_ours, path_of
from simfoundry.spec.models.kinds import KINDS

if TYPE_CHECKING:
    from simfoundry.language_server.server import Server
    from simfoundry.lint.draft import DraftScene

T = TypeVar("T")

PREVIEW = "simfoundry/preview"
PREVIEW_CHANGED = "simfoundry/previewChanged"

# The kind of a document, which may not be readable otherwise.
_KIND = re.compile(r"^simfoundry: *(\w+/\d+)", re.MULTILINE)

# Start of the names of the editors that show pictures in hovers.
_SHOWS_PICTURES = "Visual Studio Code"


@dataclass
class _Displays:
    """State shared by the display features: the editor's settings and the server's documents.

    Attributes:
        server: The server.
        previews: The pictures of documents.
        pictures: True if hovers contain pictures.
        hinted: True if the editor has asked for hints.
        drafts: The lowered scenes of documents that are not lowered when they are checked.
    """

    server: Server
    previews: Previews
    pictures: bool = False
    hinted: bool = False
    drafts: WeakKeyDictionary[Analysis, DraftScene | None] = field(default_factory=WeakKeyDictionary)

    def context(self, analysis: Analysis) -> HoverContext:
        """Return what is known about a text: the scene lowered from it, or from an earlier text."""
        lowered = analysis if analysis.draft is not None else self.server.documents.lowered(analysis.path)
        if lowered is not None:
            return HoverContext(analysis, lowered.draft, lowered.loaded)
        if getattr(analysis.loaded.spec, "twin", None) is None or analysis.has_errors:
            return HoverContext(analysis, None, analysis.loaded)
        if analysis not in self.drafts:
            from simfoundry.language_server.display.pictures import draft_of

            self.drafts[analysis] = draft_of(analysis)
        return HoverContext(analysis, self.drafts[analysis], analysis.loaded)

    async def answer(self, uri: str, compute: Callable[[Analysis], T]) -> T | None:
        """Return an answer about a document.

        If its text cannot be parsed at the moment, the answer is that of the latest text that could be, moved to where
        the unchanged lines are now.
        """
        analysis = await self.analysis(uri)
        if analysis is None:
            return None
        if analysis.source is not None:
            return compute(analysis)
        older = self.server.documents.parsed(analysis.path)
        return None if older is None else LineShift(older.lines, analysis.lines).moved(compute(older))

    async def analysis(self, uri: str) -> Analysis | None:
        """Return the analysis of the present text of a document, or None if it is not one of ours."""
        buffer = self.server.documents.buffers.get(uri)
        return await self.server.current(uri) if buffer is not None and is_ours(buffer) else None

    @property
    def has_markdown(self) -> bool:
        """Return True if the editor shows Markdown in hovers."""
        document = self.server.client_capabilities.text_document
        formats = document.hover.content_format if document is not None and document.hover is not None else None
        return types.MarkupKind.Markdown in (formats or ())

    def markup(self, text: str) -> types.MarkupContent:
        """Return a description for the editor, as Markdown if it shows that."""
        if self.has_markdown:
            return types.MarkupContent(types.MarkupKind.Markdown, text)
        return types.MarkupContent(types.MarkupKind.PlainText, plain_text(text))

    def finished(self, analysis: Analysis) -> None:
        """Tell the editor that what it shows beside the text of a document may have changed."""
        self.previews.checked(analysis)
        buffer = self.server.documents.buffer_of(analysis.path)
        if buffer is not None and not analysis.has_errors and self.previews.is_shown(buffer.uri):
            self.server.protocol.notify(PREVIEW_CHANGED, {"uri": buffer.uri, "version": analysis.version})
        workspace = self.server.client_capabilities.workspace
        hints = workspace.inlay_hint if workspace is not None else None
        if self.hinted and hints is not None and hints.refresh_support and analysis.draft is not None:
            self.server.workspace_inlay_hint_refresh(None)


def add_displays(server: Server) -> None:
    """Register the features that show something."""
    displays = _Displays(server, Previews(lambda: server.is_checking, server.idle))
    server.checked.append(displays.finished)
    server.closed.append(displays.previews.close)
    _add_hover(server, displays)
    _add_structure(server, displays)
    _add_decorations(server, displays)
    _add_preview(server, displays)


def _add_hover(server: Server, displays: _Displays) -> None:
    @server.feature(types.INITIALIZE)
    def initialize(params: types.InitializeParams) -> None:
        options = params.initialization_options
        wanted = options.get("hoverPictures") if isinstance(options, dict) else getattr(options, "hoverPictures", None)
        client = params.client_info.name if params.client_info is not None else ""
        displays.pictures = wanted if isinstance(wanted, bool) else client.startswith(_SHOWS_PICTURES)

    @server.feature(types.TEXT_DOCUMENT_HOVER)
    async def hover(params: types.HoverParams) -> types.Hover | None:
        analysis = await displays.analysis(params.text_document.uri)
        if analysis is None:
            return None
        position, shown = params.position, analysis
        if analysis.source is None:
            older = server.documents.parsed(analysis.path)
            line = LineShift(older.lines, analysis.lines).older_line(position.line) if older is not None else None
            if older is None or line is None:
                return _key_hover(displays, analysis, params.position)
            position, shown = types.Position(line, position.character), older
        found = hover_at(displays.context(shown), shown.lines.offset(position))
        if found is None:
            return None
        where = shown.lines.range(found.start, found.end)
        where = types.Range(
            types.Position(params.position.line, where.start.character),
            types.Position(params.position.line + where.end.line - where.start.line, where.end.character),
        )
        text = found.text
        if displays.pictures and found.object and displays.has_markdown:
            uri = await displays.previews.object_picture(analysis.path, found.object)
            text += f"\n\n![{found.object}]({uri})" if uri else ""
        return types.Hover(displays.markup(text), where)


def _key_hover(displays: _Displays, analysis: Analysis, position: types.Position) -> types.Hover | None:
    """Return the meaning of the key at a place of a text that cannot be parsed, or None if there is none."""
    cursor = cursor_at(analysis.lines.text, analysis.lines.offset(position))
    kind = _KIND.search(analysis.lines.text)
    text = key_text(kind[1], cursor.path) if kind is not None and kind[1] in KINDS else None
    if text is None:
        return None
    return types.Hover(displays.markup(text), analysis.lines.range(cursor.start, cursor.end))


def _add_structure(server: Server, displays: _Displays) -> None:
    @server.feature(types.TEXT_DOCUMENT_DOCUMENT_SYMBOL)
    async def symbols(params: types.DocumentSymbolParams) -> list[types.DocumentSymbol] | None:
        return await displays.answer(params.text_document.uri, document_symbols)

    @server.feature(types.TEXT_DOCUMENT_FOLDING_RANGE)
    async def folding(params: types.FoldingRangeParams) -> list[types.FoldingRange] | None:
        return await displays.answer(params.text_document.uri, folding_ranges)

    @server.feature(types.TEXT_DOCUMENT_SELECTION_RANGE)
    async def selection(params: types.SelectionRangeParams) -> list[types.SelectionRange] | None:
        analysis = await displays.analysis(params.text_document.uri)
        return None if analysis is None else selection_ranges(analysis, params.positions)

    @server.feature(types.TEXT_DOCUMENT_FORMATTING)
    async def formatting(params: types.DocumentFormattingParams) -> list[types.TextEdit] | None:
        analysis = await displays.analysis(params.text_document.uri)
        # On a thread of its own, because comparing thousands of lines takes longer than a check may wait.
        return None if analysis is None else await asyncio.to_thread(format_edits, analysis.path, analysis.lines)


def _add_decorations(server: Server, displays: _Displays) -> None:
    @server.feature(types.TEXT_DOCUMENT_DOCUMENT_COLOR)
    async def colors(params: types.DocumentColorParams) -> list[types.ColorInformation] | None:
        return await displays.answer(params.text_document.uri, document_colors) or []

    @server.feature(types.TEXT_DOCUMENT_COLOR_PRESENTATION)
    async def presentations(params: types.ColorPresentationParams) -> list[types.ColorPresentation]:
        analysis = await displays.analysis(params.text_document.uri)
        return [] if analysis is None else color_presentations(analysis.lines, params.range, params.color)

    @server.feature(types.TEXT_DOCUMENT_DOCUMENT_LINK)
    async def links(params: types.DocumentLinkParams) -> list[types.DocumentLink] | None:
        return await displays.answer(params.text_document.uri, document_links)

    @server.feature(types.TEXT_DOCUMENT_SEMANTIC_TOKENS_FULL, LEGEND)
    async def tokens(params: types.SemanticTokensParams) -> types.SemanticTokens | None:
        analysis = await displays.analysis(params.text_document.uri)  # an editor keeps the tokens that it has
        return None if analysis is None or analysis.source is None else semantic_tokens(analysis)

    @server.feature(types.TEXT_DOCUMENT_INLAY_HINT)
    async def hints(params: types.InlayHintParams) -> list[types.InlayHint] | None:
        displays.hinted = True

        def compute(analysis: Analysis) -> list[types.InlayHint]:
            return inlay_hints(displays.context(analysis), params.range)

        return await displays.answer(params.text_document.uri, compute)


def _add_preview(server: Server, displays: _Displays) -> None:
    @server.feature(PREVIEW)
    async def preview(params: Any) -> dict[str, Any] | None:
        uri = params.get("uri") if isinstance(params, dict) else getattr(params, "uri", None)
        if not isinstance(uri, str):
            return None
        buffer = server.documents.buffers.get(uri)
        path, version = (buffer.path, buffer.version) if buffer is not None else (path_of(uri), None)
        return await displays.previews.answer(uri, path, version, params)
