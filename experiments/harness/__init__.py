"""What all experiments share.

- `contract`: options and errors.
- `catalogue`: all experiments and commands by name.
- `command_line`: options from the command line; `robot_option`: `--robot`.
- `output`: metrics, checks, figures and tables of a run.
- `sweep`: one function over many configurations, in parallel and resumable.
- `intervals`: medians and fractions with their 95 % intervals.
- `recording`: recordings for the rerun viewer, and moving pictures.
- `live_viewer`: a recording shown while it is written; `viewer_page`: the page of that.
- `figure_style`: the style of figures, and one colour for each method.
- `timing`: processor time of a function.
- `provenance`: versions, commit and processor of a run.
- `summary`: the result of a run on the terminal.
- `thesis_elements`: every table and figure of the thesis, and reasons of shortfalls.
"""
