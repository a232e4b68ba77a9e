"""The style sheet of the report."""

STYLE = """
:root { color-scheme: light dark; --ink: #1c2430; --paper: #fbfaf7; --line: #d9d5cb;
  --soft: #f1eee6; --accent: #8a4b14; --good: #2c6e49; --bad: #a4262c; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e2d9; --paper: #16191d; --line: #363b42;
  --soft: #20252b; --accent: #e0a46a; --good: #7cc49a; --bad: #f08a8a; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
header, main { max-width: 72rem; margin: 0 auto; padding: 1.5rem; }
header { border-bottom: 3px solid var(--accent); }
h1 { margin: 0; font-size: 2rem; letter-spacing: -0.02em; }
h2 { margin: 0 0 0.3rem; font-size: 1.35rem; }
a { color: var(--accent); }
.contents { list-style: none; padding: 0; display: flex; flex-wrap: wrap; gap: 0.4rem 1.2rem; }
section { margin: 2rem 0; padding: 1.4rem; border: 1px solid var(--line); border-radius: 8px; }
section p { margin: 0.2rem 0; }
.short { border-left: 6px solid var(--bad); }
.good { border-left: 6px solid var(--good); }
.element { color: var(--accent); font-weight: 600; }
.tag { font-size: 0.75rem; padding: 0.1rem 0.5rem; border-radius: 1rem; vertical-align: middle;
  background: var(--soft); border: 1px solid var(--line); }
.scroll { overflow-x: auto; margin: 0.9rem 0; }
table { border-collapse: collapse; font-size: 0.92rem; }
th, td { padding: 0.3rem 0.8rem; text-align: left; border-bottom: 1px solid var(--line); }
th { background: var(--soft); white-space: nowrap; }
td.number { font-variant-numeric: tabular-nums; }
.ok { color: var(--good); } .fail { color: var(--bad); font-weight: 600; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(22rem, 1fr));
  gap: 1rem; margin: 1rem 0; }
figure { margin: 0; padding: 0.6rem; background: #fff; color: #333; border-radius: 6px;
  border: 1px solid var(--line); }
figure img { width: 100%; height: auto; display: block; }
figcaption { font-size: 0.85rem; padding-top: 0.4rem; }
details { margin: 0.6rem 0; } summary { cursor: pointer; color: var(--accent); }
"""
