#!/bin/sh
# Installs Sawmill calibration from this folder; no network is needed.
set -eu
umask 022  # the service's user must be able to read it

usage='usage: sh install.sh [--python PROGRAM] FOLDER, as in sh install.sh /opt/sawmill'

refuse() {
  printf 'install.sh: %s\n' "$1" >&2
  exit "${2:-1}"
}

asked_python=
folder=
while [ "$#" -gt 0 ]; do
  case $1 in
    --help) printf '%s\n' "$usage"; exit 0 ;;
    --python) [ "$#" -ge 2 ] || refuse "$usage" 2; asked_python=$2; shift ;;
    -*) refuse "there is no option $1; $usage" 2 ;;
    *) [ -z "$folder" ] || refuse "$usage" 2; folder=$1 ;;
  esac
  shift
done
[ -n "$folder" ] || refuse "$usage" 2
case $folder in /*) ;; *) folder=$PWD/$folder ;; esac
here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)

# What is in this folder is what was packed.
damaged=$(cd -- "$here" && sha256sum --check --quiet SHA256SUMS 2>&1) ||
  refuse "the bundle is damaged, so unpack or copy it again:
$damaged"
. "$here/BUNDLE"
wheels=$(sed -n 's|^[0-9a-f]*  \(wheels/.*\.whl\)$|\1|p' "$here/SHA256SUMS")

# The machine can run it.
[ "$(uname -m)" = "$machine" ] || refuse "this bundle is for $machine, and this machine is $(uname -m)"
program=${asked_python:-python$python}
command -v "$program" > /dev/null ||
  refuse "there is no $program: install Python $python, or name it with --python"
found=$("$program" -I -c 'import sys; print("%d.%d" % sys.version_info[:2])') ||
  refuse "$program cannot be run: name Python $python with --python"
[ "$found" = "$python" ] || refuse "this bundle needs Python $python, and $program is Python $found: name another with --python"
"$program" -I -c 'import ensurepip, venv' 2> /dev/null ||
  refuse "$program lacks venv or ensurepip: on Debian and Ubuntu install the package python$python-venv"
"$program" -I - "$glibc" <<'END' || refuse "this bundle needs glibc $glibc or later: use a newer system"
import os, sys
try:
    found = os.confstr("CS_GNU_LIBC_VERSION").split()[1]
except (AttributeError, OSError, ValueError):
    found = "0.0"  # another C library
sys.exit([int(part) for part in found.split(".")[:2]] < [int(part) for part in sys.argv[1].split(".")])
END

# There is room, and nothing is in the way.
place=$folder/$version
there=$folder
while [ ! -e "$there" ]; do there=$(dirname -- "$there"); done
[ -d "$there" ] || refuse "$there is no folder"
[ -w "$there" ] || refuse "$there cannot be written to: install as root, or into a folder of your own"
free=$(df -Pk -- "$there" | awk 'NR == 2 { print int($4 / 1000) }')
[ "$free" -ge "$megabytes" ] || refuse "$there has $free MB free, and the installation needs $megabytes MB"
if [ -e "$place" ] && [ ! -e "$place/unfinished" ]; then
  refuse "$place is there already: version $version is installed; remove that folder to install it again"
fi

printf 'Installing version %s into %s ...\n' "$version" "$place"
rm -rf -- "$place"
mkdir -p -- "$place"
trap 'rm -rf -- "$place"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM HUP
: > "$place/unfinished"
"$program" -I -m venv "$place"
# Neither settings of pip's on this machine nor variables of this shell change what is installed.
(
  cd -- "$here"
  # shellcheck disable=SC2086 # one word a wheel
  PIP_CONFIG_FILE=/dev/null "$place/bin/python" -I -m pip --isolated --disable-pip-version-check install \
    --quiet --no-index --no-deps --no-cache-dir $wheels
  missing=$(PIP_CONFIG_FILE=/dev/null "$place/bin/python" -I -m pip --isolated --disable-pip-version-check check) ||
    refuse "the bundle is not complete for this Python: $missing"
)
mkdir -p "$place/share/sawmill"
for name in README.md CHANGELOG.md CONTRIBUTING.md SECURITY.md LICENSE LICENSES.txt sbom.cdx.json docker-compose.yml \
  docs examples openapi; do
  cp -R -- "$here/$name" "$place/share/sawmill/"
done
printf 'Compiling the kernels (some minutes) ...\n'
env -u NUMBA_CACHE_DIR "$place/bin/sawmill" compile
rm -- "$place/unfinished"
trap - EXIT

printf 'Version %s is installed; its documents are in %s/share/sawmill.\n' "$version" "$place"
if [ -e "$folder/current" ] || [ -L "$folder/current" ]; then
  cat << END
$folder/current leads to $(readlink -- "$folder/current") still. Take a backup, then change over:
  ln -sfn $version "$folder/current"
  systemctl restart sawmill.service
The earlier version stays where it is.
END
else
  ln -s -- "$version" "$folder/current"
  cat << END
Next, as root, a service of systemd's (docs/do/install.md):
  "$folder/current/bin/sawmill" install-service --to /etc/systemd/system
or try it at once, at http://127.0.0.1:8000:
  "$folder/current/bin/sawmill" serve
END
fi
