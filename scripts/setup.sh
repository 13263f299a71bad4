#!/usr/bin/env bash
# Set up brafit: a virtual environment, the packages at their tried versions, Open3D's system libraries.
#
#   scripts/setup.sh [EXTRA]    EXTRA: none (default), test, dev, or readers (programs that the tests read files with)
#
# Run again it only looks whether something is missing, which takes a fraction of a second; after an interruption it goes
# on. System packages are installed where that is allowed without asking (root, or sudo that needs no password);
# elsewhere the line to run is printed and the script ends with status 1.
#
#   VENV=DIR      the virtual environment (default .venv beside this script's folder)
#   PYTHON=FILE   the Python to make it from (default: the first of python3, python3.13 ... python3.11 that is one of these)
#   TORCH=BUILD   PyTorch's build on Linux: cpu or cuda (default: the one that is installed; else cuda where an NVIDIA GPU
#                 is found, and cpu elsewhere)
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
venv=${VENV:-$root/.venv}
extra=${1:-none}
# The versions that brafit runs on (all packages exist for 3.14 as well, but Hydra 1.3 stops at its start there:
# facebookresearch/hydra issue 3121), and PyTorch's version.
first_minor=11
last_minor=13
torch=$(sed -n 's/^torch==//p' "$root/constraints.txt")

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
    # An installation that was cut short is to be finished first; a fresh machine may be updating itself just now.
    $sudo env DEBIAN_FRONTEND=noninteractive dpkg --configure -a >&2 </dev/null || true
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300 install -q -y --no-install-recommends "$@" \
        >&2 </dev/null
}

version_of() { "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null; }
is_python() {
    command -v "$1" >/dev/null && "$1" -c "
import sys, sysconfig
known = (3, $first_minor) <= sys.version_info[:2] <= (3, $last_minor)
sys.exit(not known or sys.implementation.name != 'cpython' or bool(sysconfig.get_config_var('Py_GIL_DISABLED')))" 2>/dev/null
}

find_python() {
    local name minor
    if [ -n "${PYTHON:-}" ]; then
        if is_python "$PYTHON"; then echo "$PYTHON"; fi
        return
    fi
    if is_python python3; then echo python3; return; fi
    for ((minor = last_minor; minor >= first_minor; minor--)); do
        if is_python "python3.$minor"; then echo "python3.$minor"; return; fi
    done
}

no_python() {
    local name=${PYTHON:-python3} found
    found=$(version_of "$name") || found="not a Python that runs"
    stop "brafit runs on CPython 3.$first_minor to 3.$last_minor (not free-threaded); $name is $found." \
        "Name another one: PYTHON=FILE make fit"
}

# The shared libraries that importing Open3D asks for, and the Debian packages they come in.
open3d_libraries="libGL.so.1 libEGL.so.1 libX11.so.6 libudev.so.1 libusb-1.0.so.0 libidn2.so.0 libgomp.so.1"
open3d_packages="libgl1 libegl1 libx11-6 libudev1 libusb-1.0-0 libidn2-0 libgomp1"

# Whether the system has all these shared libraries.
has_libraries() {
    local known name
    [ "$(uname -s)" = Linux ] || return 0
    known=$(PATH=$PATH:/sbin:/usr/sbin ldconfig -p 2>/dev/null) || return 0 # no such list here: importing them decides
    for name in "$@"; do
        case $known in *"$name "*) ;; *) return 1 ;; esac
    done
}

# shellcheck disable=SC2086 # one word a library
has_open3d_libraries() { has_libraries $open3d_libraries; }

# A virtual environment that was cut short in the making has a Python, but no pip.
has_venv() { [ -x "$venv/bin/python" ] && "$venv/bin/python" -c 'import pip' 2>/dev/null; }

# All that needs root is asked for at once: without a password for it, that is one line to run and not several.
install_system() {
    local packages="" why="" python
    if ! has_venv; then
        python=$(find_python)
        if [ -z "$python" ] && { [ -n "${PYTHON:-}" ] || command -v python3 >/dev/null; }; then no_python; fi
        if [ -z "$python" ]; then
            why="brafit needs Python 3.$first_minor to 3.$last_minor"
            packages="python3 python3-venv"
        elif ! "$python" -c 'import venv, ensurepip' 2>/dev/null; then
            # Debian keeps what venv needs in a package of its own.
            why="Python's venv module is not complete"
            packages="python$(version_of "$python")-venv"
        fi
    fi
    if ! has_open3d_libraries; then
        why="${why:+$why; }Open3D needs system libraries that are missing"
        packages="$packages $open3d_packages"
    fi
    # shellcheck disable=SC2086 # one word a package
    if [ -n "$packages" ]; then system "$why" $packages; fi
}

make_venv() {
    local python clear=""
    python=$(find_python)
    if [ -z "$python" ]; then no_python; fi
    # Only what is known to be an environment is emptied: VENV may name any folder.
    if [ -f "$venv/pyvenv.cfg" ]; then clear=--clear; fi
    say "making the virtual environment $venv with $("$python" --version)"
    "$python" -m venv $clear "$venv" || stop "the virtual environment could not be made; its last lines above say why"
}

pip() { "$venv/bin/python" -m pip "$@" </dev/null; }

has_gpu() { nvidia-smi -L 2>/dev/null | grep -q '^GPU' || [ -e /dev/nvidia0 ]; }

# Whether PyTorch is there in the tried version, in the build that TORCH names, and whole: an installation that was cut
# short may have left the file that names the version, and not all others.
has_torch() {
    local have
    have=$("$venv/bin/python" -c '
from importlib.metadata import distribution
torch = distribution("torch")
files = [(file.locate(), file.size) for file in torch.files]
assert all(path.exists() and size in (None, path.stat().st_size) for path, size in files)
print(torch.version)' 2>/dev/null) || return 1
    case "${TORCH:-any} $have" in
        "any $torch" | "any $torch+"* | "cpu $torch+cpu" | "cuda $torch" | "cuda $torch+cu"*) return 0 ;;
    esac
    return 1
}

# PyPI's PyTorch for Linux is the CUDA build: 2.7 GB to load, and it does not import without its CUDA libraries. The CPU
# build is 0.2 GB and lies in PyTorch's own index, which uv knows by name; where pip is set up to find it, pip is enough.
# What PyTorch depends on comes with the other packages.
install_torch() {
    local build=${TORCH:-}
    if [ -z "$build" ]; then
        if has_gpu; then build=cuda; else build=cpu; fi
    fi
    say "installing PyTorch $torch, the build for $build"
    # Another build, or one whose installation was cut short: pip cannot remove that.
    rm -f "$venv"/brafit-*.stamp
    pip uninstall -q -y torch >/dev/null 2>&1 || rm -rf "$venv"/lib/python3.*/site-packages/torch{,-*.dist-info}
    if [ "$build" = cuda ]; then
        pip install -q --no-deps "torch===$torch" >&2
    elif ! pip install -q --no-deps "torch==$torch+cpu" >/dev/null 2>&1; then
        pip install -q -c "$root/constraints.txt" uv >&2
        "$venv/bin/python" -m uv pip install -q --no-cache --no-deps --python "$venv/bin/python" --torch-backend cpu \
            "torch==$torch" >&2 </dev/null ||
            stop "PyTorch's CPU build could not be loaded from its index (see above). Tell pip where to find it" \
                "(PIP_EXTRA_INDEX_URL or PIP_FIND_LINKS), or take the CUDA build, 2.7 GB: TORCH=cuda make fit"
    fi
}

# The stamp of an extra holds what it was installed from; `dev` contains `test`, which contains `none`.
wanted() { echo "$root"; cat "$root/pyproject.toml" "$root/constraints.txt"; }
is_installed() {
    local stamp
    [ -x "$venv/bin/python" ] || return 1
    for stamp in "$@"; do
        if [ -f "$venv/brafit-$stamp.stamp" ] && [ "$(wanted)" = "$(cat "$venv/brafit-$stamp.stamp")" ]; then return 0; fi
    done
    return 1
}

install_packages() {
    local message
    say "installing packages (the first time this takes some minutes)"
    pip install -q -c "$root/constraints.txt" -e "$1" >&2 ||
        stop "pip could not install the packages; its lines above say why. They are known to exist for Linux on x86_64" \
            "with glibc 2.35 or later (Debian 12, Ubuntu 22.04) and CPython 3.$first_minor to 3.$last_minor; here:" \
            "$(uname -sm), $(getconf GNU_LIBC_VERSION 2>/dev/null || echo no glibc), $("$venv/bin/python" --version)"
    # In a folder that holds a clone called brafit, Python takes the clone for the package, unless it finds one on its path:
    # what pip adds for an editable package comes later.
    echo "$root" > "$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/brafit-clone.pth"
    if ! message=$("$venv/bin/python" -c 'import open3d' 2>&1); then
        stop "Open3D does not import: ${message##*$'\n'}. On Debian it needs: apt-get install -y $open3d_packages"
    fi
}

# Readers that the tests compare the written files with; a test whose reader is missing is skipped and says so.
if [ "$extra" = readers ]; then
    missing=""
    for pair in ogr2ogr:gdal-bin pdftoppm:poppler-utils rsvg-convert:librsvg2-bin chromium:chromium; do
        command -v "${pair%%:*}" >/dev/null || missing="$missing ${pair##*:}"
    done
    # Playwright's Node.js, which drives Chromium, links it; nothing else brings it onto a bare machine.
    has_libraries libatomic.so.1 || missing="$missing libatomic1"
    # shellcheck disable=SC2086 # one word a package
    if [ -n "$missing" ]; then system "the tests read pattern files with programs that are missing" $missing; fi
    exit 0
fi

case $extra in
    none) target=$root; enough="none test dev" ;;
    test) target="${root}[test]"; enough="test dev" ;;
    dev) target="${root}[dev]"; enough="dev" ;;
    *) stop "unknown extra '$extra': none, test, dev or readers" ;;
esac
case ${TORCH:-} in
    "" | cpu | cuda) ;;
    *) stop "TORCH=$TORCH: the builds of PyTorch are cpu and cuda" ;;
esac
# Elsewhere PyPI's PyTorch has one build only.
[ "$(uname -s)" = Linux ] || unset TORCH

# shellcheck disable=SC2086 # one word an extra
if is_installed $enough && has_open3d_libraries && { [ -z "${TORCH:-}" ] || has_torch; }; then exit 0; fi
install_system
has_venv || make_venv
if [ "$(uname -s)" = Linux ] && ! has_torch; then install_torch; fi
# shellcheck disable=SC2086 # one word an extra
if ! is_installed $enough; then
    install_packages "$target"
    wanted > "$venv/brafit-$extra.stamp"
    say "ready: $venv/bin/brafit"
fi
