// The EEPROM, a byte at a time, without waiting: a write takes 3.4 ms on its own.
#ifndef THIGMO_MEGA_EEPROM_H_
#define THIGMO_MEGA_EEPROM_H_

#include <avr/io.h>
#include <util/atomic.h>

namespace thigmo {
namespace mega {

class Eeprom {
 public:
  static bool ready() { return (EECR & _BV(EEPE)) == 0; }

  static uint8_t read(uint16_t address) {
    EEAR = address;
    EECR |= _BV(EERE);
    return EEDR;
  }

  static void write(uint16_t address, uint8_t value) {
    EEAR = address;
    EEDR = value;
    EECR = 0;                            // erase and write in one operation
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {  // EEPE must follow EEMPE within four cycles
      EECR |= _BV(EEMPE);
      EECR |= _BV(EEPE);
    }
  }
};

}  // namespace mega
}  // namespace thigmo

#endif  // THIGMO_MEGA_EEPROM_H_
