#!/bin/sh
# Gets what makes a run nicer and never fails: the real furniture models and the libraries that Open3D loads.
# As root it installs Debian packages; otherwise the furniture is unpacked into the user's cache, and for
# Open3D's libraries the one command to run as root is printed. Without them dssmsg takes its own embedded
# furniture and the next renderer, and says so.
set -u
python=$1
packages_open3d="libgl1 libgomp1 libx11-6 libegl1 libusb-1.0-0"
cache="${XDG_CACHE_HOME:-$HOME/.cache}/dssmsg/furniture"
system=/usr/share/sweethome3d/furniture

if ! command -v apt-get >/dev/null 2>&1; then
    echo "assets: no apt-get here; the embedded furniture is used (docs/scenes.md says how to get the real one)"
    exit 0
fi

root=no
[ "$(id -u)" -eq 0 ] && root=yes

updated=no
update_lists() {
    [ "$updated" = yes ] && return
    updated=yes
    [ "$root" = yes ] && apt-get update -qq >/dev/null 2>&1
}

if ! "$python" -c "import open3d" >/dev/null 2>&1; then
    if [ "$root" = yes ]; then
        echo "assets: installing the libraries that Open3D loads: $packages_open3d"
        update_lists
        # shellcheck disable=SC2086 # a list of packages
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $packages_open3d >/dev/null 2>&1 ||
            echo "assets: apt-get failed; the next renderer is used"
    else
        echo "assets: Open3D cannot load, the slower renderer is used. As root: apt-get install $packages_open3d"
    fi
fi

if [ -d "$system" ] || ls "$cache"/*.sh3f >/dev/null 2>&1; then
    exit 0
fi
echo "assets: getting the furniture models (Debian package sweethome3d-furniture)"
update_lists
if [ "$root" = yes ]; then
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends sweethome3d-furniture >/dev/null 2>&1 && exit 0
fi
work=$(mktemp -d) || exit 0
if (cd "$work" && apt-get download -qq sweethome3d-furniture >/dev/null 2>&1 && dpkg-deb -x ./*.deb unpacked); then
    mkdir -p "$cache" && cp "$work"/unpacked/usr/share/sweethome3d/furniture/*.sh3f "$cache"/
    cp "$work"/unpacked/usr/share/doc/sweethome3d-furniture/copyright "$cache"/copyright 2>/dev/null
    echo "assets: unpacked into $cache"
else
    echo "assets: could not be fetched; the embedded furniture is used"
fi
rm -rf "$work"
exit 0
