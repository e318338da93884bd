#!/bin/sh
# Prepares MicroPython's sources for the Pico: patch.sh MICROPYTHON PICO, folders of sources.sh.
#
# - The libraries that Debian packages apart (Pico SDK, TinyUSB) are put where the port looks for them.
# - No encrypted connections: their library is not in Debian's sources, and a Pico has no network.
# - The controller's code and constants lie in RAM, with the garbage collector and the interpreter.
set -eu
port=$1/ports/rp2
rm -rf "$1/lib/tinyusb"
ln -s "$2/usr/src/tinyusb" "$1/lib/tinyusb"
sed -i 's/^set(MICROPY_SSL_MBEDTLS ON)/set(MICROPY_SSL_MBEDTLS OFF)/
  /mbedtls\/mbedtls_port.c/d; /micropy_lib_mbedtls)/d' "$port/CMakeLists.txt"
sed -i 's/^\(#define MICROPY_\(SSL_MBEDTLS\|PY_CRYPTOLIB\|PY_HASHLIB_SHA1\) .*\)(1)/\1(0)/' \
  "$port/mpconfigport.h"
grep -q 'pico.cpp.o' "$port/memmap_mp_rp2040.ld" || sed -i 's/ \*gc\.c\.obj/ *pico.cpp.o&/
  s/ \*libm\.a:) \.rodata/ *libm.a: *pico.cpp.o) .rodata/' "$port/memmap_mp_rp2040.ld"
grep -q 'libm.a: \*pico.cpp.o) .rodata' "$port/memmap_mp_rp2040.ld"
