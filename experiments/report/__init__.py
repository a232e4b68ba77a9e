"""``python -m experiments report``: all results in one self-contained page.

- `report`: writes the page; `bench_table`: the table of docs/benchmarks.md.
- `results`: result folders as read.
- `page`: the page's parts.
- `elements`: every table and figure of the thesis, and where it is shown.
- `overview`: what was found, a card for each experiment.
- `findings`: what falls short of its bar, and why.
- `html`, `images`, `style`: pieces of HTML, pictures and the style sheet.
"""
