#!/bin/sh
# Run the tests on all cores, then, one by one, those that need the machine for themselves.
# usage: run_tests.sh PYTHON [PYTEST_ARGS...]
set -u
python=$1
shift

# pytest says 5 where the arguments leave it no test.
"$python" -m pytest -n auto --dist loadfile --no-loadscope-reorder --real-time=skip "$@"
shared=$?
"$python" -m pytest --real-time=only "$@"
alone=$?

[ "$shared" -eq 5 ] && [ "$alone" -eq 5 ] && exit 5
{ [ "$shared" -eq 0 ] || [ "$shared" -eq 5 ]; } && { [ "$alone" -eq 0 ] || [ "$alone" -eq 5 ]; }
