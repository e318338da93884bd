#!/bin/sh
# Fetches MicroPython's sources into a folder: sources.sh FOLDER.
#
# They are Debian's package of one pinned version, of a later release than the machine's may be: the list of its own package sources is read with the release's name replaced, into a folder of
# its own, so that nothing of the machine changes and no right but to the folder is needed. apt
# checks signatures and hashes.
set -eu
RELEASE=trixie
MICROPYTHON=1.25.0+ds-1

folder=$(mkdir -p "$1" && cd "$1" && pwd)
own=$(ls /etc/apt/sources.list.d/debian.sources /etc/apt/sources.list 2>/dev/null | head -n 1)
[ -n "$own" ] || { echo "error: no list of Debian package sources; use Debian 12 or newer" >&2; exit 1; }

apt=$folder/apt
mkdir -p "$apt/lists/partial" "$apt/cache/archives/partial"
case $own in
*.sources) # the first stanza, which is the release's own
  awk 'BEGIN { RS = "" } NR == 1' "$own" |
    sed "s/^Types:.*/Types: deb-src/; s/^Suites:.*/Suites: $RELEASE/; s/^Components:.*/Components: main/" \
      >"$apt/own.sources" ;;
*) # one line: deb [options] URI release components
  sed -n 's/^deb \(\[.*\] \)\?\([^ ]*\) .*/\1\2/p' "$own" | head -n 1 |
    sed "s/.*/deb-src & $RELEASE main/" >"$apt/own.list" ;;
esac
list=$(ls "$apt"/own.*)
get() {
  apt-get -q -o Dir::Etc::SourceList="$list" -o Dir::Etc::SourceParts=/dev/null \
    -o Dir::State::Lists="$apt/lists" -o Dir::Cache="$apt/cache" "$@" >&2
}

cd "$folder"
get update
get source --download-only "micropython=$MICROPYTHON"
tar -xf micropython_*.orig.tar.xz
