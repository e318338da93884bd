// The bytes by which injected hardware is reached: a socket of the unix port, UART 1 of the MPS2.
#ifndef THIGMO_MICROPYTHON_STREAM_H_
#define THIGMO_MICROPYTHON_STREAM_H_

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

// From now on received bytes go to injected_receive(), in a thread or an interrupt routine. A
// sentence if the hardware cannot be reached, else null. Calls after the first do nothing.
const char* stream_open(void);
void stream_send(const uint8_t* bytes, uint32_t count);
// Waits for so many bytes inside injected_receive(); on the unix port only.
void stream_take(uint8_t* bytes, uint32_t count);
// Nothing is received between the two.
void stream_lock(void);
void stream_unlock(void);
// Waits for a moment; false when the hardware has gone.
bool stream_wait(void);

void injected_receive(const uint8_t* bytes, uint32_t count);

#ifdef __cplusplus
}
#endif

#endif  // THIGMO_MICROPYTHON_STREAM_H_
