"""The style sheet of the report: wide screens, phones, dark rooms and paper."""

STYLE = """
:root { color-scheme: light dark; --ink: #1c2430; --paper: #fbfaf7; --line: #d9d5cb;
  --soft: #f1eee6; --accent: #8a4b14; --good: #2c6e49; --bad: #a4262c; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e2d9; --paper: #16191d; --line: #363b42;
  --soft: #20252b; --accent: #e0a46a; --good: #7cc49a; --bad: #f08a8a; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); overflow-wrap: anywhere;
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
header, main { max-width: 72rem; margin: 0 auto; padding: 1.5rem; }
header { border-bottom: 3px solid var(--accent); }
h1 { margin: 0; font-size: 2rem; letter-spacing: -0.02em; }
h2 { margin: 0 0 0.3rem; font-size: 1.35rem; }
h3 { margin: 1.2rem 0 0.2rem; font-size: 1rem; }
a { color: var(--accent); }
code { font: 0.88rem/1.4 ui-monospace, Menlo, Consolas, monospace; background: var(--soft);
  padding: 0.15rem 0.4rem; border-radius: 4px; }
.contents { list-style: none; padding: 0; display: flex; flex-wrap: wrap; gap: 0.4rem 1.2rem; }
section { margin: 2rem 0; padding: 1.4rem; border: 1px solid var(--line); border-radius: 8px; }
section p { margin: 0.2rem 0; }
:target { scroll-margin-top: 1rem; outline: 2px solid var(--accent); outline-offset: 3px; }
.short { border-left: 6px solid var(--bad); }
.good { border-left: 6px solid var(--good); }
.element { color: var(--accent); font-weight: 600; }
.tag { font-size: 0.75rem; padding: 0.1rem 0.5rem; border-radius: 1rem; vertical-align: middle;
  background: var(--soft); border: 1px solid var(--line); }
.scroll { overflow-x: auto; margin: 0.9rem 0; }
table { border-collapse: collapse; font-size: 0.92rem; overflow-wrap: normal; }
th, td { padding: 0.3rem 0.8rem; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); }
th { background: var(--soft); white-space: nowrap; }
td.number { font-variant-numeric: tabular-nums; white-space: nowrap; }
td.text { min-width: 12rem; }
td strong, td > a { white-space: nowrap; }
td.why { min-width: 16rem; }
tr.differs td:nth-child(3) { color: var(--accent); font-weight: 600; }
.ok { color: var(--good); } .fail { color: var(--bad); font-weight: 600; }
.cards { display: grid; gap: 1rem; margin: 1rem 0;
  grid-template-columns: repeat(auto-fill, minmax(min(18rem, 100%), 1fr)); }
article { border: 1px solid var(--line); border-radius: 6px; padding: 0.8rem; }
article h3 { margin: 0 0 0.5rem; } article ul { padding-left: 1.1rem; margin: 0.5rem 0; }
article img { width: 100%; height: 11rem; object-fit: contain; background: #fff; }
.figures { display: grid; gap: 1rem; margin: 1rem 0; align-items: start;
  grid-template-columns: repeat(auto-fit, minmax(min(22rem, 100%), 1fr)); }
figure { margin: 0; padding: 0.6rem; background: #fff; color: #333; border-radius: 6px;
  border: 1px solid var(--line); }
figure img { width: 100%; height: auto; display: block; }
figcaption { font-size: 0.85rem; padding-top: 0.4rem; }
details { margin: 0.6rem 0; } summary { cursor: pointer; color: var(--accent); }
@media (max-width: 40rem) {
  header, main { padding: 0.8rem; }
  section { padding: 0.8rem; margin: 1rem 0; }
  .contents { gap: 0.5rem 1rem; }
  th, td { padding: 0.3rem 0.5rem; }
}
@media print {
  :root { color-scheme: light; --ink: #000; --paper: #fff; --line: #bbb; --soft: #f3f3f3;
    --accent: #5a3210; --good: #1d5636; --bad: #8a1c22; }
  @page { margin: 14mm; }
  body { font-size: 9.5pt; }
  header, main { max-width: none; padding: 0; }
  section { border: 0; border-top: 2px solid var(--line); border-radius: 0; padding: 0.5rem 0; }
  nav, details:not(.extra) > summary { display: none; }
  details:not(.extra)::details-content { content-visibility: visible; block-size: auto; }
  .scroll { overflow: visible; }
  table { font-size: 7.5pt; } table.wide { font-size: 4.5pt; }
  thead { display: table-header-group; } tr, figure, article { break-inside: avoid; }
  th, td { padding: 0.1rem 0.25rem; }
  td, td.why, td.text { min-width: 0; } table.wide th { white-space: normal; }
  table.wide th, table.wide td { padding: 1px 2px; }
  h2, h3 { break-after: avoid; }
  .figures { grid-template-columns: repeat(2, 1fr); }
}
"""
