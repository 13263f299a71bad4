#!/usr/bin/env bash
# Set up brafit: a virtual environment, the packages at their tried versions, Open3D's system libraries.
#
#   scripts/setup.sh [EXTRA]    EXTRA: none (default), test, dev, or readers (programs that the tests read files with)
#
# Run again it only looks whether something is missing, which takes a fraction of a second. System packages are
# installed where that is allowed without asking (root, or sudo that needs no password); elsewhere the line to run is
# printed and the script ends with status 1.
#
#   VENV=DIR      the virtual environment (default .venv beside this script's folder)
#   PYTHON=FILE   the Python to make it from (default: the first of python3, python3.14 ... python3.11 that is >= 3.11)
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
venv=${VENV:-$root/.venv}
extra=${1:-none}

say() { printf 'setup: %s\n' "$*" >&2; }
stop() { say "$*"; exit 1; }

# What to put before a command that needs root: nothing, or sudo; fails where neither is to be had.
as_root() {
    if [ "$(id -u)" -eq 0 ]; then return 0; fi
    if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then echo "sudo -n"; return 0; fi
    return 1
}

# system WHY PACKAGE...: install Debian packages, or name the line that does.
system() {
    local why=$1 sudo
    shift
    if ! command -v apt-get >/dev/null; then
        stop "$why. Install the equivalents of these Debian packages, then run this again: $*"
    fi
    if ! sudo=$(as_root); then
        stop "$why. Run this line, then run this again: sudo apt-get update && sudo apt-get install -y $*"
    fi
    say "installing $* ($why)"
    $sudo apt-get update -q >&2 </dev/null
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "$@" >&2 </dev/null
}

is_python() { command -v "$1" >/dev/null && "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }

find_python() {
    local name
    if [ -n "${PYTHON:-}" ]; then
        is_python "$PYTHON" || stop "PYTHON=$PYTHON is not a Python of version 3.11 or later"
        echo "$PYTHON"
        return
    fi
    for name in python3 python3.14 python3.13 python3.12 python3.11; do
        if is_python "$name"; then echo "$name"; return; fi
    done
    return 1
}

make_venv() {
    local python
    if ! python=$(find_python); then
        if [ -n "${PYTHON:-}" ]; then exit 1; fi
        system "brafit needs Python 3.11 or later" python3 python3-venv
        python=$(find_python) || stop "this system's python3 is older than 3.11; name a newer one: PYTHON=FILE make fit"
    fi
    # Debian keeps what venv needs in a package of its own.
    if ! "$python" -c 'import venv, ensurepip' 2>/dev/null; then
        system "Python's venv module is not complete" python3-venv
    fi
    say "making the virtual environment $venv with $("$python" --version)"
    "$python" -m venv "$venv"
}

# The shared libraries that importing Open3D asks for, and the Debian packages they come in.
open3d_libraries="libGL.so.1 libEGL.so.1 libX11.so.6 libudev.so.1 libusb-1.0.so.0 libgomp.so.1"
open3d_packages="libgl1 libegl1 libx11-6 libudev1 libusb-1.0-0 libgomp1"

has_open3d_libraries() {
    local known name
    [ "$(uname -s)" = Linux ] || return 0
    known=$(PATH=$PATH:/sbin:/usr/sbin ldconfig -p 2>/dev/null) || return 0 # no such list here: the import below decides
    for name in $open3d_libraries; do
        case $known in *"$name "*) ;; *) return 1 ;; esac
    done
}

# The stamp of an extra holds what it was installed from; `dev` contains `test`, which contains `none`.
wanted() { echo "$root"; cat "$root/pyproject.toml" "$root/constraints.txt"; }
is_installed() {
    local stamp
    for stamp in "$@"; do
        if [ -f "$venv/brafit-$stamp.stamp" ] && [ "$(wanted)" = "$(cat "$venv/brafit-$stamp.stamp")" ]; then return 0; fi
    done
    return 1
}

# Readers that the tests compare the written files with; a test whose reader is missing is skipped and says so.
if [ "$extra" = readers ]; then
    missing=""
    for pair in ogr2ogr:gdal-bin pdftoppm:poppler-utils rsvg-convert:librsvg2-bin chromium:chromium; do
        command -v "${pair%%:*}" >/dev/null || missing="$missing ${pair##*:}"
    done
    # shellcheck disable=SC2086 # one word a package
    if [ -n "$missing" ]; then system "the tests read pattern files with programs that are missing" $missing; fi
    exit 0
fi

case $extra in
    none) target=$root; enough="none test dev" ;;
    test) target="$root[test]"; enough="test dev" ;;
    dev) target="$root[dev]"; enough="dev" ;;
    *) stop "unknown extra '$extra': none, test, dev or readers" ;;
esac

[ -x "$venv/bin/python" ] || make_venv
if ! has_open3d_libraries; then
    # shellcheck disable=SC2086 # one word a package
    system "Open3D needs system libraries that are missing" $open3d_packages
fi
# shellcheck disable=SC2086 # one word an extra
if ! is_installed $enough; then
    say "installing packages (the first time this takes some minutes)"
    "$venv/bin/python" -m pip install -q -c "$root/constraints.txt" -e "$target" >&2 </dev/null
    if ! message=$("$venv/bin/python" -c 'import open3d' 2>&1); then
        stop "Open3D does not import: ${message##*$'\n'}. On Debian it needs: apt-get install -y $open3d_packages"
    fi
    wanted > "$venv/brafit-$extra.stamp"
    say "ready: $venv/bin/brafit"
fi
