"""``living-twin``: what a twin beside a rover notices, and what it foresees.

In reading order:

- `happenings`: what happens to a simulated rover.
- `trial`: one rover, its twin, and one happening.
- `ahead`: motions that may tip a rover over, and what was foreseen of them.
- `missions`: missions in whose midst something happens, with and without a twin.
- `boards`: a rover on emulated boards, its twin beside it in real time.
- `living_twin`: the experiment.
"""
