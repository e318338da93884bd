// The controller on injected hardware, and the messages of the stream.
//
// Little-endian. From the host:
//   'I' cause u8, latched u8, nonce u32, faults u16, adc_bits u8, frame_us u16, flash 8192   power
//       or reset
//   'S' ticks u8, flags u8, supply_mv u16, encoder_errors u16, count u16, bytes of the line, then
//   for
//       each tick the counts 8 x u16 and the encoder at each pass 4 x i32; flags: 1 estop, 2 the
//       main loop hangs, 4 the motor has its supply
//   after a 'B': result u8, 21 bytes that were read
//   'C' bytes u32                        power fails in that byte written to flash from now on
//   'G'                                  what is kept
// To the host:
//   'R'                                  the controller has started
//   'S' flags u8, drive 2 x i16, motor i16, count u16, bytes of the line; flags: 1 runs, 2 powered,
//       4 the watchdog bites, 8 pays out, 16 muscle air, 32 body air, 64 motor's supply, 128 brake
//       open
//   'G' latched u8, nonce u32, faults u16, erasures 2 x u32, flash 8192, the store's bytes 2048
//   'B' now_us u32, address u8, read u8, count u8, 21 bytes that are written: an I2C transfer
//   'N'                                  nine clocks on that bus, then a STOP
// A build for more has counts and drives for what it holds, and a larger flash and store.
#include <new>

#include "controller.h"
#ifdef THIGMO_SKELETON
#include "../../skeleton/mps2/injected_skeleton.h"
#else
#include "injected_board.h"
#endif
#include "program.h"
#include "stream.h"

namespace {

using namespace thigmo;

constexpr uint16_t kFlashSize = 2 * kFlashSector;
constexpr uint16_t kTickBytes = 2 * kAdcSlots + 4 * kPasses;
constexpr uint16_t kStepHeader = 9;
constexpr uint16_t kMostLine = 4096;

// One machine: a chip's flash, what its RAM keeps, and the controller while it lives. All zeros at
// first: no start-up code of the Cortex-M3 runs constructors.
struct Machine {
  InjectedFlash flash;
  LatchRecord latches;
  protocol::ResetCause cause;
  uint8_t adc_bits;
  uint16_t frame_us;
  volatile bool known;  // its hardware has been described
  bool again;           // the program has begun before, without a reset
  uint32_t tick;        // since the controller began
  volatile bool alive;
  const char* volatile halted;  // why, or null
  uint8_t received[kFlashSize + kStepHeader + kMostLine];
  uint32_t filled;
  uint8_t answer[kFlashSize + kEepromUsed + 32];
};
Machine machine;
alignas(InjectedBoard) uint8_t board_storage[sizeof(InjectedBoard)];
alignas(Robot<InjectedBoard>) uint8_t robot_storage[sizeof(Robot<InjectedBoard>)];
alignas(Program<InjectedBoard>) uint8_t program_storage[sizeof(Program<InjectedBoard>)];

InjectedBoard& board() { return *reinterpret_cast<InjectedBoard*>(board_storage); }
Robot<InjectedBoard>& robot() { return *reinterpret_cast<Robot<InjectedBoard>*>(robot_storage); }
Program<InjectedBoard>& program() {
  return *reinterpret_cast<Program<InjectedBoard>*>(program_storage);
}

template <typename T>
T take(const uint8_t*& cursor) {
  T value;
  memcpy(&value, cursor, sizeof value);
  cursor += sizeof value;
  return value;
}

template <typename T>
void put(uint8_t*& cursor, T value) {
  memcpy(cursor, &value, sizeof value);
  cursor += sizeof value;
}

void end() {
  machine.alive = false;  // with the board, its outputs are gone: the pins float, pulled down
}

// Instants of the main loop's passes in a tick, one of them when the conversions are complete.
void pass_times(uint16_t* passes_us) {
  const uint16_t fixed_us[] = {250, 500, 990};
  uint8_t i = 0;
  bool placed = false;
  for (const uint16_t pass_us : fixed_us) {
    if (!placed && machine.frame_us < pass_us) {
      passes_us[i++] = machine.frame_us;
      placed = true;
    }
    passes_us[i++] = pass_us;
  }
  if (!placed) passes_us[i] = machine.frame_us;
}

void step(const uint8_t* message) {
  const uint8_t ticks = take<uint8_t>(message);
  const uint8_t flags = take<uint8_t>(message);
  const uint16_t supply_mv = take<uint16_t>(message);
  const uint16_t encoder_errors = take<uint16_t>(message);
  const uint16_t count = take<uint16_t>(message);
  const uint8_t* const line = message;
  message += count;
  uint16_t instants[kPasses];
  pass_times(instants);
  bool bites = false;
  if (machine.alive) {
    board().inputs(supply_mv, encoder_errors, (flags & 1) != 0, (flags & 4) != 0);
    board().sent(line, count);
  }
  for (uint8_t i = 0; i < ticks && machine.alive; ++i) {
    uint16_t counts[kAdcSlots];
    memcpy(counts, message, sizeof counts);
    message += sizeof counts;
    const uint32_t begun = machine.tick * 1000;
    int32_t encoder = 0;
    for (uint8_t pass = 0; pass < kPasses && machine.alive; ++pass) {
      encoder = take<int32_t>(message);
      if (machine.halted != nullptr) {
        end();
        break;
      }
      board().set_time(begun + instants[pass], encoder);
      const Configuration& c = robot().controller().configuration();
#if THIGMO_IMUS
      board().poll_imus(c);
#endif
      if (instants[pass] == machine.frame_us) board().convert(machine.tick, counts, c);
      if ((flags & 2) == 0) {
        robot().loop();
        if (program().look()) thigmo_call_soon();
      }
      machine.latches.keep(board().kept_latches());
      if (!machine.flash.powered) end();
    }
    if (!machine.alive) break;
    ++machine.tick;
    board().set_time(machine.tick * 1000, encoder);
    if (board().watchdog_bites()) {
      bites = true;
      end();
    }
  }
  uint8_t* out = machine.answer;
  put<uint8_t>(out, 'S');
  uint8_t* const answered = out++;
  const bool alive = machine.alive;
  *answered =
      static_cast<uint8_t>((alive ? 1 : 0) | (machine.flash.powered ? 2 : 0) | (bites ? 4 : 0));
  if (alive) {
    *answered =
        static_cast<uint8_t>(*answered | (board().pays_out() ? 8 : 0) |
                             (board().enabled(0) ? 16 : 0) | (board().enabled(1) ? 32 : 0) |
                             (board().enabled(2) ? 64 : 0) | (board().enabled(3) ? 128 : 0));
  }
  for (uint8_t i = 0; i < kMuscles; ++i) {
    put<int16_t>(out, alive ? board().duty(i) : static_cast<int16_t>(-1));
  }
  put<int16_t>(out, alive ? board().motor_duty() : static_cast<int16_t>(0));
  uint8_t* const length = out;
  out += 2;
  // Bytes that were on their way when the controller ended have left.
  while (board().to_host().size() != 0) put<uint8_t>(out, board().to_host().pop());
  const uint16_t bytes = static_cast<uint16_t>(out - length - 2);
  memcpy(length, &bytes, sizeof bytes);
  stream_send(machine.answer, static_cast<uint32_t>(out - machine.answer));
}

void describe(const uint8_t* message) {
  machine.cause = static_cast<protocol::ResetCause>(take<uint8_t>(message));
  Latches latches;
  latches.stop.latched = take<uint8_t>(message) != 0;
  latches.stop.nonce = take<uint32_t>(message);
  latches.faults = take<uint16_t>(message);
  machine.latches.keep(latches);
  machine.adc_bits = take<uint8_t>(message);
  machine.frame_us = take<uint16_t>(message);
  memcpy(machine.flash.cells, message, kFlashSize);
  machine.flash.cut_after = UINT32_MAX;
  machine.flash.powered = true;
  new (board_storage)
      InjectedBoard(machine.flash, machine.frame_us, machine.adc_bits, machine.cause, latches);
  machine.known = true;
}

void give() {
  uint8_t* out = machine.answer;
  put<uint8_t>(out, 'G');
  const Latches latches = machine.latches.kept();
  put<uint8_t>(out, latches.stop.latched);
  put<uint32_t>(out, latches.stop.nonce);
  put<uint16_t>(out, latches.faults);
  for (const uint32_t erased : machine.flash.erased) put<uint32_t>(out, erased);
  memcpy(out, machine.flash.cells, kFlashSize);
  out += kFlashSize;
  for (uint16_t i = 0; i < kEepromUsed; ++i) *out++ = board().eeprom_read(i);
  stream_send(machine.answer, static_cast<uint32_t>(out - machine.answer));
}

// Bytes of the message that begins with these, as far as they tell.
uint32_t message_size(const uint8_t* message, uint32_t filled) {
  switch (message[0]) {
    case 'I':
      return 12 + kFlashSize;
    case 'S': {
      if (filled < kStepHeader) return kStepHeader;
      uint16_t count;
      memcpy(&count, message + 7, sizeof count);
      return kStepHeader + count + static_cast<uint32_t>(message[1]) * kTickBytes;
    }
    case 'C':
      return 5;
    default:
      return 1;
  }
}

}  // namespace

extern "C" {

void injected_receive(const uint8_t* bytes, uint32_t count) {
  while (count != 0) {
    uint32_t whole = machine.filled == 0 ? 1 : message_size(machine.received, machine.filled);
    if (whole > sizeof machine.received) {
      machine.filled = 0;  // no host sends that
      return;
    }
    const uint32_t taken = whole - machine.filled < count ? whole - machine.filled : count;
    memcpy(machine.received + machine.filled, bytes, taken);
    machine.filled += taken;
    bytes += taken;
    count -= taken;
    if (machine.filled < message_size(machine.received, machine.filled)) continue;
    machine.filled = 0;
    const uint8_t* message = machine.received + 1;
    switch (machine.received[0]) {
      case 'I':
        describe(message);
        break;
      case 'S':
        if (machine.known) step(message);
        break;
      case 'C':
        machine.flash.cut_after = take<uint32_t>(message);
        break;
      case 'G':
        give();
        break;
    }
  }
}

const char* thigmo_begin(const int8_t*) {
  const char* const problem = stream_open();
  if (problem != nullptr) return problem;
  while (!machine.known) {
    if (!stream_wait()) return "the injected hardware has gone";
  }
  stream_lock();
  new (board_storage) InjectedBoard(machine.flash, machine.frame_us, machine.adc_bits,
                                    machine.again ? protocol::ResetCause::kExternal : machine.cause,
                                    machine.latches.kept());
  new (robot_storage) Robot<InjectedBoard>(board());
  new (program_storage) Program<InjectedBoard>(robot());
  robot().begin();
  machine.tick = 0;
  machine.again = true;
  machine.halted = nullptr;
  machine.alive = true;
  const uint8_t started = 'R';
  stream_send(&started, 1);
  stream_unlock();
  return nullptr;
}

void thigmo_end(void) {
  stream_lock();
  end();
  stream_unlock();
}

void thigmo_halt(const char* why) {
  if (machine.alive && machine.halted == nullptr) machine.halted = why;
}

const char* thigmo_halted(void) { return machine.halted; }

bool thigmo_runs(void) { return machine.alive && machine.halted == nullptr; }

uint32_t thigmo_schema_hash(void) { return protocol::kSchemaHash; }

bool thigmo_ask(thigmo_request_t* request) {
  stream_lock();
  const bool answered = thigmo_runs();
  if (answered) program().answer(request);
  stream_unlock();
  return answered;
}

void thigmo_serve(void) {}  // its store is written as the controller asks
}
