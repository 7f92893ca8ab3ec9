"""Texts, messages and frames that an editor should never send to a language server."""

from __future__ import annotations

GARBAGE = (
    "\0", "\t", "\r", "\r\n", "\n\n", "\u2028", "\x85", "\ufeff", "😀", "𝒳𐍈", "e\u0301", "\ud83d", "\x1b[31m", "&a ",
    "*a", "<<: ", "!!python/object:os.system ", "---\n", "...\n", "? ", "- ", ": ", "{", "}", "[", "]", "'", '"', "|\n",
    ">-\n", "%YAML 1.1\n", "<<<<<<< ours\n", "=======\n", ">>>>>>> theirs\n", "#", "${x}", "$a", "[" * 300,
    "{a: " * 120, "a" * 200_000, "- " * 5_000, "1e999", "0x" + "f" * 200, "-0", ".nan", "../../../etc/passwd", "file:///",
    "pkg:os/path", "extends: boxes.scene.yaml\n", "include: {a: {scene: boxes.scene.yaml}}\n",
    "repeat: {count: [99, 99]}",
    "a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\nd: [*c, *c]\n", "simfoundry: task/1\n", "place: {on: box_1}",
)  # fmt: skip

METHODS = (
    "completion", "hover", "definition", "references", "documentHighlight", "prepareRename", "rename", "codeAction",
    "documentSymbol", "foldingRange", "inlayHint", "formatting", "documentColor", "colorPresentation", "documentLink",
    "semanticTokens/full", "signatureHelp", "selectionRange",
)  # fmt: skip

URIS = (
    "untitled:Untitled-1", "http://example.com/a.scene.yaml", "file:///nowhere/a.scene.yaml", "file://host/a.scene.yaml",
    "", "a.scene.yaml", "file:///", "file:///a%00b.scene.yaml", "file:///%FF%FE.scene.yaml", "file:///" + "a" * 5000,
    "vscode-notebook-cell:/a#b", "file:///tmp/../../..", "::", "file://[::1", "git:/a.scene.yaml?%7B%7D", "\ud800",
)  # fmt: skip

BODIES = (
    b"", b"{", b"null", b"[]", b"42", b'"text"', b"{}", b"\xff\xfe", b'{"jsonrpc": "1.0"}', b'{"jsonrpc": "2.0"}',
    b'{"jsonrpc": "2.0", "id": 1}', b'{"jsonrpc": "2.0", "method": 5}', b'{"jsonrpc": "2.0", "id": {}, "method": []}',
    b'{"jsonrpc": "2.0", "id": "x", "result": 1}',
    b'{"jsonrpc": "2.0", "id": null, "error": {"code": 1, "message": ""}}',
    b'[{"jsonrpc": "2.0", "id": 1, "method": "shutdown"}]', b"[" * 20_000, b'{"jsonrpc": "2.0", "method": "no/such"}',
    b'{"jsonrpc": "2.0", "id": 999999, "method": "no/such", "params": {}}',
    b'{"jsonrpc": "2.0", "method": "$/cancelRequest", "params": {"id": 123456}}',
    b'{"jsonrpc": "2.0", "method": "$/setTrace", "params": {"value": "verbose"}}',
    b'{"jsonrpc": "2.0", "method": "textDocument/didChange", "params": {"textDocument": 5}}',
    b'{"jsonrpc": "2.0", "method": "textDocument/didOpen", "params": null}',
    b'{"jsonrpc": "2.0", "method": "textDocument/didOpen"}',
    b'{"jsonrpc": "2.0", "method": "workspace/didChangeWatchedFiles", "params": {"changes": [{"uri": 5, "type": 9}]}}',
)  # fmt: skip

FRAMES = (
    b"Content-Length: 5\r\n\r\n{\"jsonrpc\": \"2.0\"}\r\n", b"Content-Length: x\r\n\r\n", b"\r\n\r\n", b"garbage\r\n",
    b"Content-Type: text\r\n\r\n", b"Content-Length: -5\r\n\r\n", b"content-length: 2\r\n\r\n{}\r\n", b"\0\xff\r\n",
)  # fmt: skip
