#!/bin/sh
# Make sure that there is a Chromium to look at the report with; install it by apt if that can be.
# usage: ensure_browser.sh
# Without apt or the right to use it the test of the report in a browser is skipped, and says so.
set -eu

for name in chromium chromium-browser google-chrome; do
    if command -v "$name" >/dev/null; then
        exit 0
    fi
done
if [ "$(id -u)" = 0 ]; then
    root=""
elif sudo -n true 2>/dev/null; then
    root="sudo -n"
fi
if ! command -v apt-get >/dev/null || [ -z "${root+set}" ]; then
    echo "setup: no Chromium; to test the report in a browser: sudo apt install chromium" >&2
    exit 0
fi
echo "setup: installing Chromium for the test of the report"
$root apt-get update -qq </dev/null
$root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium \
    </dev/null
