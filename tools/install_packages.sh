#!/bin/sh
# Make the virtual environment and install the pinned packages and this project into it.
# usage: install_packages.sh PYTHON VENV
set -eu
python=$1
venv=$2

recent='import sys; sys.exit(sys.version_info < (3, 11))'

if ! [ -x "$venv/bin/python" ]; then
    for candidate in "$python" python3.13 python3.12 python3.11; do
        if "$candidate" -c "$recent" 2>/dev/null; then
            found=$candidate
            break
        fi
    done
    if [ -z "${found:-}" ]; then
        echo "setup: Python 3.11 or newer is needed; install it, or say make PYTHON=/path/to/python" >&2
        exit 1
    fi
    if ! "$found" -m venv "$venv"; then
        rm -rf "$venv"
        echo "setup: $found cannot make a virtual environment; install its venv package (apt install python3-venv)" >&2
        exit 1
    fi
fi
if ! "$venv/bin/python" -c "$recent"; then
    echo "setup: $venv holds a Python older than 3.11; remove $venv and try again" >&2
    exit 1
fi

echo "setup: installing the pinned packages into $venv (some minutes the first time)"
pip="$venv/bin/python -m pip --disable-pip-version-check --no-input --quiet"
$pip install --require-hashes -r requirements.lock
$pip install --no-deps --no-build-isolation -e .
