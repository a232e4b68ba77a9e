#!/bin/sh
# Build the image of the Dockerfile and run commands in it: by docker or, where no docker runs, as
# root by buildah, on a Debian that debootstrap makes (apt install buildah debootstrap).
# usage: try_image.sh
set -eu
work=$PWD/build/image

if docker info >/dev/null 2>&1; then
    docker build -t fieldtwin .
    in_image() {
        docker run --rm --user "$user" fieldtwin "$@"
    }
elif [ "$(id -u)" = 0 ] && command -v buildah >/dev/null && command -v debootstrap >/dev/null; then
    release=$(sed -n 's/^FROM debian:\(.*\)-slim$/\1/p' Dockerfile)
    rm -rf "$work"
    mkdir -p "$work"
    store() {
        buildah --root "$work/root" --runroot "$work/run" --storage-driver vfs "$@"
    }
    debootstrap --variant=minbase "$release" "$work/debian"
    base=$(store from scratch)
    # Packages may come to this machine through a proxy with a certificate of its own.
    if [ -d /usr/local/share/ca-certificates ]; then
        cp -R /usr/local/share/ca-certificates "$work/debian/usr/local/share/"
    fi
    store add -q "$base" "$work/debian" /
    store commit -q --rm "$base" "docker.io/library/debian:$release-slim"
    rm -rf "$work/debian"
    store bud --isolation chroot --network host --pull-never -t fieldtwin .
    container=$(store from --pull-never localhost/fieldtwin)
    in_image() {
        store run --isolation chroot --user "$user" "$container" -- fieldtwin "$@"
    }
else
    echo "image: needs a running docker, or root with buildah and debootstrap" >&2
    exit 1
fi

user=fieldtwin
in_image --version
in_image list
in_image doctor
in_image appd-calibration --quick
# As whoever starts it, who has no home in the image.
user=12345:12345
in_image ch2-friction --quick --out /tmp/results
echo "image: built, and run"
