#!/bin/sh
# Fetches sources into a folder: `sources.sh FOLDER` MicroPython's, `sources.sh FOLDER pico` those of
# the Pico's libraries.
#
# They are Debian's packages of pinned versions, of a later release than the machine's may be: the
# list of its own package sources is read with the release's name replaced, into a folder of its own,
# so that nothing of the machine changes and no right but to the folder is needed. apt checks
# signatures and hashes.
set -eu
RELEASE=trixie
MICROPYTHON=1.25.0+ds-1
PICO_SDK=2.1.1-1
TINYUSB=0.18.0+dfsg-1

folder=$(mkdir -p "$1" && cd "$1" && pwd)
own=$(ls /etc/apt/sources.list.d/debian.sources /etc/apt/sources.list 2>/dev/null | head -n 1)
[ -n "$own" ] || { echo "error: no list of Debian package sources; use Debian 12 or newer" >&2; exit 1; }

apt=$folder/apt
mkdir -p "$apt/lists/partial" "$apt/cache/archives/partial"
case $own in
*.sources) # the first stanza, which is the release's own
  awk 'BEGIN { RS = "" } NR == 1' "$own" |
    sed "s/^Types:.*/Types: deb deb-src/; s/^Suites:.*/Suites: $RELEASE/; s/^Components:.*/Components: main/" \
      >"$apt/own.sources" ;;
*) # one line: deb [options] URI release components
  sed -n 's/^deb \(\[.*\] \)\?\([^ ]*\) .*/\1\2/p' "$own" | head -n 1 |
    sed "s/.*/deb & $RELEASE main\ndeb-src & $RELEASE main/" >"$apt/own.list" ;;
esac
list=$(ls "$apt"/own.*)
get() {
  apt-get -q -o Dir::Etc::SourceList="$list" -o Dir::Etc::SourceParts=/dev/null \
    -o Dir::State::Lists="$apt/lists" -o Dir::Cache="$apt/cache" "$@" >&2
}

cd "$folder"
get update
if [ "${2:-}" = pico ]; then
  get download "pico-sdk-source=$PICO_SDK" "tinyusb-source=$TINYUSB"
  dpkg-deb -x pico-sdk-source_*.deb pico
  dpkg-deb -x tinyusb-source_*.deb pico
else
  get source --download-only "micropython=$MICROPYTHON"
  tar -xf micropython_*.orig.tar.xz
fi
