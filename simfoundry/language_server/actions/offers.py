"""Code actions: corrections of findings, and rewrites of values in another form."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from lsprotocol import types

from simfoundry.language_server.analysis import Analysis
from simfoundry.language_server.diagnostics import finding_range, published
from simfoundry.language_server.positions import Lines
from simfoundry.spec.change.fixes import apply_certain_fixes, corrections
from simfoundry.spec.check.report import absolute
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.load import load
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.nodes import Node
from simfoundry.spec.yaml.text import Document, Path_

# Kinds of actions that the server offers, for editors that ask for one of them.
KINDS = (types.CodeActionKind.QuickFix, types.CodeActionKind.RefactorRewrite, types.CodeActionKind.SourceFixAll)


def code_actions(
    analysis: Analysis,
    findings: Iterable[Diagnostic],
    uri: str,
    within: types.Range,
    only: Sequence[str] | None = None,
) -> list[types.CodeAction]:
    """Return the actions for a range of a document.

    Args:
        analysis: The document.
        findings: The findings that the editor shows for it, including those of documents that use it.
        uri: The document, as the editor names it.
        within: The range, which may be empty.
        only: The kinds of actions that the editor asks for, or None for all.
    """
    lines = analysis.lines
    own = [d for d in dict.fromkeys(findings) if absolute(d.document) == analysis.path]
    out: list[types.CodeAction] = []
    if _asks(only, types.CodeActionKind.QuickFix):
        for finding in own:
            if _touch(lines, finding_range(finding, lines), within):
                out += _quick_fixes(analysis, finding, uri)
    if _asks(only, types.CodeActionKind.RefactorRewrite):
        out += _refactorings(analysis, uri, within)
    if _asks(only, types.CodeActionKind.SourceFixAll):
        text, done = apply_certain_fixes(lines.text, own)
        if done:
            title = f"apply {len(done)} suggestion{'s' if len(done) > 1 else ''}"
            out.append(_action(title, types.CodeActionKind.SourceFixAll, lines, uri, text, ()))
    return out


def _asks(only: Sequence[str] | None, kind: types.CodeActionKind) -> bool:
    """Return True if an editor asks for a kind of actions, or for a kind that contains it."""
    return only is None or any(kind.value == asked or kind.value.startswith(f"{asked}.") for asked in map(str, only))


def _touch(lines: Lines, a: types.Range, b: types.Range) -> bool:
    (start, end), (first, last) = lines.span(a), lines.span(b)
    return start <= last and first <= end


def _quick_fixes(analysis: Analysis, finding: Diagnostic, uri: str) -> Iterator[types.CodeAction]:
    lines = analysis.lines
    shown = published([finding], lines)
    first = True
    for each in corrections(lines.text, analysis.source, finding):
        if each.text == lines.text or not _is_sound(analysis, each.text, finding):
            continue
        action = _action(each.title, types.CodeActionKind.QuickFix, lines, uri, each.text, shown)
        action.is_preferred = first and not each.blank
        first = False
        yield action


# Size of a text [characters] up to which a correction is verified; a scene of 100 objects has about 10,000.
MOST_VERIFIED = 20_000


def _is_sound(analysis: Analysis, text: str, finding: Diagnostic) -> bool:
    """Return True if a corrected text has no new finding on the corrected line, or about what was written there.

    Findings elsewhere may have been hidden by the error. Large texts are not checked again.
    """
    if len(text) > MOST_VERIFIED or not finding.fixes:
        return True
    root = project_root(analysis.path)
    loaded = load(analysis.path, root, text=text)
    found = [*loaded.all_findings()]
    if loaded.spec is not None and not loaded.errors:
        from simfoundry.lint.lints import lint_subject, subject_of  # loads numpy

        found += lint_subject(loaded, *subject_of(loaded))
    known = {(d.code, d.message) for d in analysis.findings}
    new = [d for d in found if (d.code, d.message) not in known and absolute(d.document) == analysis.path]
    written = [f"`{fix.text}`" for fix in finding.fixes]
    return not any(d.line == finding.line or any(name in d.message for name in written) for d in new)


def _refactorings(analysis: Analysis, uri: str, within: types.Range) -> Iterator[types.CodeAction]:
    if analysis.source is None:
        return
    from simfoundry.language_server.actions.rewrites import rewrites  # loads numpy

    start, _ = analysis.lines.span(within)
    for each in rewrites(analysis, path_at(analysis.source, analysis.lines, start)):
        if each.text != analysis.lines.text:
            yield _action(each.title, types.CodeActionKind.RefactorRewrite, analysis.lines, uri, each.text, ())


def _action(
    title: str,
    kind: types.CodeActionKind,
    lines: Lines,
    uri: str,
    after: str,
    findings: Sequence[types.Diagnostic],
) -> types.CodeAction:
    edit = types.WorkspaceEdit(changes={uri: [text_edit(lines, after)]})
    title = title.replace("`", "'")  # menus show plain text
    return types.CodeAction(f"{title[0].upper()}{title[1:]}", kind, list(findings) or None, edit=edit)


def text_edit(lines: Lines, after: str) -> types.TextEdit:
    """Return the edit that turns a text into another one, without what both have in common at the start and end."""
    before = lines.text
    most = min(len(before), len(after))
    start = next((k for k in range(most) if before[k] != after[k]), most)
    end = next((k for k in range(most - start) if before[-1 - k] != after[-1 - k]), most - start)
    return types.TextEdit(lines.range(start, len(before) - end), after[start : len(after) - end])


def path_at(document: Document, lines: Lines, offset: int) -> Path_:
    """Return the path of the innermost key or item of a document that starts at or before an offset of its text."""
    path: list[str | int] = []
    node = document.root
    while node.children is not None:
        before = [(_start(node, part, child), part, child) for part, child in _members(node)]
        here = [each for each in before if lines.place(*each[0]) <= offset]
        if not here:
            break
        _, part, node = max(here, key=lambda each: each[0])
        path.append(part)
    return tuple(path)


def _members(node: Node) -> list[tuple[str | int, Node]]:
    children = node.children
    return [*children.items()] if isinstance(children, dict) else [*enumerate(children or ())]


def _start(node: Node, part: str | int, child: Node) -> tuple[int, int]:
    return node.keys[part] if isinstance(part, str) else child.place
