#!/bin/sh
# Make sure that MuJoCo can render off screen; install Mesa by apt only if it cannot.
# usage: ensure_rendering.sh PYTHON
set -eu
python=$1
packages="libegl1 libegl-mesa0 libopengl0 libgl1 libgl1-mesa-dri"

renders() {
    "$python" -m experiments.doctor.render_probe >/dev/null 2>&1
}

if renders; then
    exit 0
fi
if ! command -v apt-get >/dev/null; then
    echo "setup: off-screen rendering does not work here; install Mesa's EGL and software driver" >&2
    exit 1
fi
if [ "$(id -u)" = 0 ]; then
    root=""
elif sudo -n true 2>/dev/null; then
    root="sudo -n"
else
    echo "setup: off-screen rendering needs: sudo apt install $packages" >&2
    exit 1
fi
echo "setup: installing Mesa for off-screen rendering ($packages)"
$root apt-get update -qq </dev/null
# shellcheck disable=SC2086  # Several packages.
$root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $packages \
    </dev/null
if ! renders; then
    echo "setup: off-screen rendering still fails; $python -m experiments doctor shows why" >&2
    exit 1
fi
