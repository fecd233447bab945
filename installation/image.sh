#!/bin/sh
# Build the container image sawmill-calibration:VERSION (`make image`): by Docker where its engine runs, else by
# Debian's buildah as root, and then into dist/ (or the folder that is named) as an archive that every engine loads.
#
# Where no image registry can be reached, mmdebstrap makes the base, which is kept in SAWMILL_IMAGE_CACHE
# (~/.cache/sawmill-image by default) with buildah's layers.
set -eu
folder=$(realpath "${1:-$(dirname "$0")/../dist}")
cd "$(dirname "$0")/.."

version=$(sed -n 's/^VERSION = "\(.*\)"$/\1/p' worker/sawmill_vocabulary/version.py)
name=sawmill-calibration:$version
archive=$folder/sawmill-calibration-$version-image.tar
cache=${SAWMILL_IMAGE_CACHE:-${HOME:?}/.cache/sawmill-image}
# Files of the image and its layers have the time of the commit.
SOURCE_DATE_EPOCH=$(git log -1 --format=%ct)
export SOURCE_DATE_EPOCH
mkdir -p "$folder" "$cache"

if docker info > /dev/null 2>&1; then
  docker build --build-arg "VERSION=$version" --tag "$name" .
  docker save --output "$archive" "$name"
  echo "$name is built; $archive: $(du -m "$archive" | cut -f 1) MB"
  exit 0
fi

if ! command -v buildah > /dev/null; then
  echo "neither a Docker engine nor buildah is here: apt-get install --no-install-recommends buildah mmdebstrap crun" >&2
  exit 1
fi
if [ "$(id -u)" -ne 0 ]; then
  echo "buildah builds the image as root here: run make image as root" >&2
  exit 1
fi

builder() { buildah --root "$cache/layers" --runroot "$cache/run" --storage-driver overlay "$@"; }

base=python:3.11-slim-bookworm
if ! builder pull --quiet "$base" > /dev/null 2>&1; then
  base=localhost/sawmill-base:bookworm
  if ! builder inspect --type image "$base" > /dev/null 2>&1; then
    echo "no image registry can be reached: mmdebstrap makes the base (two minutes) ..."
    mmdebstrap --quiet --variant=minbase --include=ca-certificates,python3,python3-venv,python-is-python3 \
      bookworm "$cache/base.tar"
    container=$(builder from scratch)
    builder add --quiet "$container" "$cache/base.tar" / > /dev/null
    builder config --cmd python3 "$container"
    builder commit --quiet --rm "$container" "$base" > /dev/null
    rm "$cache/base.tar"
  fi
fi

# The machine's own certificates, for a registry of packages behind a proxy that signs for itself.
builder build --quiet --layers --format docker --isolation chroot --network host --pull-never --timestamp "$SOURCE_DATE_EPOCH" \
  --volume /etc/ssl/certs:/etc/ssl/certs:ro --build-arg "BASE=$base" --build-arg "VERSION=$version" --tag "$name" . > /dev/null
rm -f "$archive.part"
builder push --quiet "$name" "docker-archive:$archive.part:$name"
mv "$archive.part" "$archive"
echo "$name is built; $archive: $(du -m "$archive" | cut -f 1) MB"
