#!/bin/sh
# Make sure that the tests can show what people view: the report in a Chromium, recordings in
# rerun's viewer on a (software) Vulkan; install by apt what is missing, if that can be.
# usage: ensure_viewers.sh
# Without apt or the right to use it the tests that need them are skipped, with the reason.
set -eu
PATH=$PATH:/usr/sbin:/sbin

has_browser() {
    for name in chromium chromium-browser google-chrome; do
        command -v "$name" >/dev/null && return
    done
    return 1
}

has_vulkan() {
    ldconfig -p | grep -q 'libvulkan\.so\.1' || return 1
    [ -n "${VK_DRIVER_FILES:-${VK_ICD_FILENAMES:-}}" ] && return
    for folder in /usr/share/vulkan/icd.d /etc/vulkan/icd.d; do
        ls "$folder"/*.json >/dev/null 2>&1 && return
    done
    return 1
}

missing=""
has_browser || missing="chromium"
has_vulkan || missing="$missing libvulkan1 mesa-vulkan-drivers"
[ -n "$missing" ] || exit 0
if [ "$(id -u)" = 0 ]; then
    root=""
elif sudo -n true 2>/dev/null; then
    root="sudo -n"
fi
if ! command -v apt-get >/dev/null || [ -z "${root+set}" ]; then
    echo "setup: to test the report and the recordings in their viewers: sudo apt install $missing" >&2
    exit 0
fi
echo "setup: installing what shows the report and the recordings ($missing)"
$root apt-get update -qq </dev/null
# shellcheck disable=SC2086  # Several packages.
$root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing \
    </dev/null
