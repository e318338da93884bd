// What an image is, readable from its hex file: `thigmo flash` refuses one of another schema.
#ifndef THIGMO_MEGA_SIGNATURE_H_
#define THIGMO_MEGA_SIGNATURE_H_

#include <avr/io.h>

#include "program_memory.h"
// The core comes after the access to its tables is defined.
#include "../core/link/session.h"

namespace thigmo {
namespace mega {

// host/thigmo/link/flash.py looks for `magic` and reads what follows, little-endian.
struct Signature {
  char magic[12];
  uint32_t schema_hash;
  uint8_t protocol;
  uint8_t board;
  uint8_t version[3];
};
const Signature kSignature PROGMEM = {
    {'t', 'h', 'i', 'g', 'm', 'o', '-', 'i', 'm', 'a', 'g', 'e'},
    protocol::kSchemaHash,
    protocol::kProtocol,
    static_cast<uint8_t>(protocol::BoardKind::kMega),
    {kFirmwareVersion[0], kFirmwareVersion[1], kFirmwareVersion[2]}};

// Keeps the signature in the image: the linker drops what nobody refers to, and the compiler a
// reference without effect. The register is the tasks' mark, which means nothing yet.
inline void sign_image() { GPIOR1 = pgm_read_byte(kSignature.magic); }

}  // namespace mega
}  // namespace thigmo

#endif  // THIGMO_MEGA_SIGNATURE_H_
