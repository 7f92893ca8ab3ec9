"""The findings of `check`, as a list whose lines select the object."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.studio.view.panels.panel import Panel, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Number of findings that are listed; more than a screen of them are better read on the command line.
MAX_LISTED = 25

# Number of characters of a finding that fit on a button; its details are below, once it is selected.
MAX_LABEL = 60


class FindingsPanel(Panel):
    """One line for each finding, and the details of the line that was clicked last."""

    edits = False

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        self._summary = window.gui.add_markdown("")
        self._list = window.gui.add_folder("Findings", visible=False)
        self._shown: tuple[Diagnostic, ...] = ()
        self._buttons: list[Any] = []
        self._details = window.gui.add_markdown("")

    def refresh(self) -> None:
        """Show the findings."""
        session = self.session
        findings = session.findings
        set_value(self._summary, summary(findings, session.is_current))
        if findings == self._shown:
            return
        self._shown = findings
        for button in self._buttons:
            button.remove()
        self._buttons = []
        self._list.visible = bool(findings)
        with self._list:
            for finding in findings[:MAX_LISTED]:
                button = self.window.gui.add_button(
                    finding_label(finding), color="red" if finding.severity is Severity.ERROR else "yellow"
                )
                button.on_click(partial(self._choose, finding))
                self._buttons.append(button)
        if not findings:
            set_value(self._details, "")

    def _choose(self, finding: Diagnostic, _event: object) -> None:
        hint = f" {finding.hint}." if finding.hint else ""
        place = f"{finding.file.rpartition('/')[2]}:{finding.line}:{finding.column}"
        set_value(self._details, f"`{finding.code}` {place}: {finding.message}.{hint}")
        section, _, rest = finding.path.partition(".")
        name = rest.partition(".")[0]
        if section in ("objects", "cameras") and name:
            self.window.select(f"{section}.{name}")
        elif finding.about:
            self.window.select(f"objects.{finding.about[0]}")


def summary(findings: tuple[Diagnostic, ...], is_current: bool) -> str:
    """Return one or two sentences about the findings, and about the scene if it is that of an earlier text."""
    errors = sum(d.severity is Severity.ERROR for d in findings)
    warnings = len(findings) - errors
    counted = f"{errors} error{'s' * (errors != 1)} and {warnings} warning{'s' * (warnings != 1)}."
    older = "" if is_current else " The scene shows an earlier text, because the present one has errors."
    return f"{counted}{older}" if findings or older else "`check` finds nothing to report."


def finding_label(finding: Diagnostic) -> str:
    """Return one short line for a finding."""
    text = f"{finding.code} {finding.message}"
    return text if len(text) <= MAX_LABEL else f"{text[: MAX_LABEL - 1]}…"
