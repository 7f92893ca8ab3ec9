"""How pages look."""

STYLE = """\
:root { color-scheme: light dark; --ground: #fff; --ink: #1f2328; --quiet: #656d76; --line: #d0d7de; --mark: #888 }
@media (prefers-color-scheme: dark) { :root { --ground: #0d1117; --ink: #e6edf3; --quiet: #8d96a0; --line: #30363d } }
body { margin: 0; background: var(--ground); color: var(--ink); font: 15px/1.5 system-ui, sans-serif }
article { max-width: 1320px; margin: 0 auto; padding: 24px }
article + article { border-top: 1px solid var(--line) }
h1 { font-size: 21px; margin: 0 }
h2 { font-size: 17px; margin: 24px 0 4px }
code { font: 13px ui-monospace, monospace }
.sides { color: var(--quiet); margin: 2px 0 0 }
.summary { font-weight: 600; margin: 10px 0 14px }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(420px, 100%), 1fr)); gap: 16px }
figure { margin: 0 }
figcaption { color: var(--quiet); margin-top: 4px }
.view { position: relative; container-type: inline-size }
.view img { display: block; width: 100%; height: auto; border-radius: 6px }
.none { display: grid; place-content: center; min-height: 240px; padding: 24px; border: 1px dashed var(--line);
  border-radius: 6px; color: var(--quiet) }
.tag { position: absolute; transform: translate(-50%, -100%); padding: 0 .5em; border-radius: .3em;
  background: var(--mark); color: #fff; font-size: 2.4cqw; line-height: 1.5; white-space: nowrap; z-index: 1 }
.stem { position: absolute; width: 1px; background: var(--mark) }
.legend { display: flex; flex-wrap: wrap; gap: 18px; margin: 10px 0; color: var(--quiet); font-size: 13px }
.legend span::before { content: ""; display: inline-block; width: 10px; height: 10px; border-radius: 2px;
  margin-right: 6px; background: var(--mark) }
.changes { list-style: none; margin: 16px 0 0; padding: 0 }
.changes > li { border-left: 4px solid var(--mark); border-radius: 2px; padding: 3px 12px; margin: 5px 0 }
.changes ul { margin: 0; padding-left: 18px; color: var(--quiet) }
.findings { padding-left: 20px }
"""
