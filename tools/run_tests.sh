#!/bin/sh
# Run the tests on all cores, then, one by one, those that need the machine for themselves.
# usage: run_tests.sh PYTHON [PYTEST_ARGS...]
set -u
python=$1
shift

kept=build/test-results
rm -rf "$kept"

# pytest exits with 5 where the arguments select no test.
"$python" -m pytest -n auto --dist loadfile --no-loadscope-reorder --real-time=skip \
    --keep-results="$kept" "$@"
shared=$?
"$python" -m pytest --real-time=only --keep-results="$kept" "$@"
alone=$?

# What the quick runs have written makes one page, as for all results.
report=0
if [ -d "$kept" ]; then
    "$python" -m pytest -rP --keep-results="$kept" tests/experiments/harness/check_kept_results.py
    report=$?
fi

[ "$shared" -eq 5 ] && [ "$alone" -eq 5 ] && exit 5
{ [ "$shared" -eq 0 ] || [ "$shared" -eq 5 ]; } && { [ "$alone" -eq 0 ] || [ "$alone" -eq 5 ]; } &&
    [ "$report" -eq 0 ]
