// The controller's life on a Raspberry Pi Pico: thigmo_begin() checks the pins, sets them up and
// starts core 1; thigmo_end() stops it with the outputs off.
#include <new>

#include "hardware/clocks.h"
#include "hardware/gpio.h"
#include "hardware/irq.h"
#include "hardware/pwm.h"
#include "hardware/resets.h"
#include "hardware/spi.h"
#include "hardware/structs/nvic.h"
#include "hardware/structs/scb.h"
#include "hardware/structs/vreg_and_chip_reset.h"
#include "hardware/uart.h"
#include "hardware/watchdog.h"
#include "pico/multicore.h"
#include "pico/time.h"
#include "pico_board.h"
#include "program.h"

namespace {

using namespace thigmo;

constexpr uint32_t kBaud = 250000;
constexpr uint32_t kSpiHz = 1000000;
constexpr uint32_t kDriveHz = 10000;
constexpr uint32_t kMotorHz = 20000;
constexpr uint8_t kVectors = 16 + 32;
constexpr int32_t kClockMs = 2;
// What an image is, readable from its file: `thigmo flash` refuses one of another schema.
const struct {
  char magic[12];
  uint32_t schema_hash;
  uint8_t protocol;
  uint8_t board;
  uint8_t version[3];
} signature = {{'t', 'h', 'i', 'g', 'm', 'o', '-', 'i', 'm', 'a', 'g', 'e'},
               protocol::kSchemaHash,
               protocol::kProtocol,
               static_cast<uint8_t>(protocol::BoardKind::kPico),
               {kFirmwareVersion[0], kFirmwareVersion[1], kFirmwareVersion[2]}};

constexpr int8_t kOutputs[] = {
    THIGMO_DRIVE_LEFT, THIGMO_DRIVE_RIGHT, THIGMO_MOTOR_PWM,    THIGMO_MOTOR_DIRECTION,
    THIGMO_MUSCLE_AIR, THIGMO_BODY_AIR,    THIGMO_MOTOR_ENABLE, THIGMO_BRAKE_ENABLE,
};

PicoFlash flash;
// RAM that no start-up code touches.
LatchRecord kept __attribute__((section(".uninitialized_data")));
bool again;  // the program has begun before, without a reset
bool alive;
const char* volatile halted;  // why, or null
volatile bool asked;          // `request` waits for core 1
volatile bool news;           // the program has not been told of
thigmo_request_t request;
repeating_timer_t clock;  // of core 0
int8_t pin[THIGMO_PINS];
alignas(PicoBoard) uint8_t board_storage[sizeof(PicoBoard)];
alignas(Robot<PicoBoard>) uint8_t robot_storage[sizeof(Robot<PicoBoard>)];
alignas(Program<PicoBoard>) uint8_t program_storage[sizeof(Program<PicoBoard>)];
alignas(8) uint32_t stack[1024];
alignas(256) uint32_t vectors[kVectors];

PicoBoard& board() { return *reinterpret_cast<PicoBoard*>(board_storage); }
Robot<PicoBoard>& robot() { return *reinterpret_cast<Robot<PicoBoard>*>(robot_storage); }
Program<PicoBoard>& program() { return *reinterpret_cast<Program<PicoBoard>*>(program_storage); }

// --- core 1
// ---------------------------------------------------------------------------------------
void on_slot() { board().on_slot(); }
void on_edge() { board().on_edge(); }
void stand_still() {  // a fault: the watchdog resets the chip
  for (;;) {
  }
}

void run() {
  // The encoder before the converters: an edge that is late may be lost, a conversion is not.
  nvic_hw->ipr[(TIMER_IRQ_0 + PicoBoard::kAlarm) / 4] = 0x80808080;
  nvic_hw->ipr[IO_IRQ_BANK0 / 4] = 0;
  nvic_hw->icpr = ~0u;
  nvic_hw->iser = 1u << (TIMER_IRQ_0 + PicoBoard::kAlarm) | 1u << IO_IRQ_BANK0;
  robot().begin();
  board().begin();
  while (halted == nullptr) {
    board().pump();
    robot().loop();
    if (program().look()) news = true;
    if (!asked) continue;
    __dmb();
    program().answer(&request);
    __dmb();
    asked = false;
  }
  save_and_disable_interrupts();
  board().drive_off(0);
  board().drive_off(1);
  board().brake();
  board().release();
  for (;;) board().kick_watchdog();
}

// --- core 0
// ---------------------------------------------------------------------------------------
bool takes(int8_t number, uint8_t remainder) { return number % 4 == remainder; }
int spi_of(int8_t number) { return number / 8 % 2; }
int uart_of(int8_t number) { return (number + 4) / 8 % 2; }
int slice_of(int8_t number) { return number / 2 % 8; }

// Why the chip cannot serve these pins; null if it can.
const char* problem_of(const int8_t* given) {
  for (uint8_t i = 0; i < THIGMO_PINS; ++i) {
    if (given[i] >= 23 && given[i] <= 25) return "pins 23 to 25 are used on the Pico itself";
    if (given[i] == 29) return "pin 29 is used on the Pico itself";
  }
  if (!takes(given[THIGMO_LINK_TX], 0) || !takes(given[THIGMO_LINK_RX], 1) ||
      uart_of(given[THIGMO_LINK_TX]) != uart_of(given[THIGMO_LINK_RX])) {
    return "link_tx and link_rx are not TX and RX of one UART, as 0 and 1 are";
  }
  if (!takes(given[THIGMO_ADC_SCK], 2) || !takes(given[THIGMO_ADC_MOSI], 3) ||
      !takes(given[THIGMO_ADC_MISO], 0) ||
      spi_of(given[THIGMO_ADC_SCK]) != spi_of(given[THIGMO_ADC_MOSI]) ||
      spi_of(given[THIGMO_ADC_SCK]) != spi_of(given[THIGMO_ADC_MISO])) {
    return "adc_sck, adc_mosi and adc_miso are not those of one SPI, as 18, 19 and 16 are";
  }
  if (given[THIGMO_SUPPLY] < 26 || given[THIGMO_SUPPLY] > 28) return "supply is not 26, 27 or 28";
  const int motor = slice_of(given[THIGMO_MOTOR_PWM]);
  if (motor == slice_of(given[THIGMO_DRIVE_LEFT]) || motor == slice_of(given[THIGMO_DRIVE_RIGHT])) {
    return "motor_pwm shares a PWM slice with a drive; choose another pair of pins";
  }
  if (slice_of(given[THIGMO_DRIVE_LEFT]) == slice_of(given[THIGMO_DRIVE_RIGHT]) &&
      (given[THIGMO_DRIVE_LEFT] - given[THIGMO_DRIVE_RIGHT]) % 2 == 0) {
    return "drive_left and drive_right share a PWM channel";
  }
  return nullptr;
}

protocol::ResetCause cause() {
  if (again) return protocol::ResetCause::kExternal;
  if ((watchdog_hw->reason & WATCHDOG_REASON_TIMER_BITS) != 0) {
    return protocol::ResetCause::kWatchdog;
  }
  if ((watchdog_hw->reason & WATCHDOG_REASON_FORCE_BITS) != 0) {
    return protocol::ResetCause::kExternal;
  }
  const uint32_t chip = vreg_and_chip_reset_hw->chip_reset;
  return (chip & VREG_AND_CHIP_RESET_CHIP_RESET_HAD_POR_BITS) != 0
             ? protocol::ResetCause::kPowerOn
             : protocol::ResetCause::kExternal;
}

void outputs_off() {
  for (const int8_t name : kOutputs) {
    gpio_init(pin[name]);  // low, as an input
    gpio_set_dir(pin[name], GPIO_OUT);
  }
}

void input(int8_t name, bool pull_up) {
  gpio_init(pin[name]);
  gpio_set_pulls(pin[name], pull_up, false);
}

void set_up_pwm(int8_t name, uint32_t hz, uint16_t steps) {
  const uint slice = pwm_gpio_to_slice_num(static_cast<uint>(pin[name]));
  // The divider counts in sixteenths: 125 MHz to 16 MHz is exact.
  const uint32_t sixteenths = (clock_get_hz(clk_sys) / hz * 16 + steps / 2) / steps;
  pwm_set_clkdiv_int_frac4(slice, sixteenths / 16, sixteenths % 16);
  pwm_set_wrap(slice, static_cast<uint16_t>(steps - 1));
  pwm_set_both_levels(slice, 0, 0);
  pwm_set_enabled(slice, true);
}

void set_up() {
  outputs_off();
  set_up_pwm(THIGMO_DRIVE_LEFT, kDriveHz, kDriveFull + 1);
  set_up_pwm(THIGMO_DRIVE_RIGHT, kDriveHz, kDriveFull + 1);
  set_up_pwm(THIGMO_MOTOR_PWM, kMotorHz, kMotorFull);
  input(THIGMO_ENCODER_A, false);
  input(THIGMO_ENCODER_B, false);
  input(THIGMO_MOTOR_POWER, false);
  input(THIGMO_ESTOP, true);  // the chip's pull-down would read as released
  for (const int8_t name : {THIGMO_ADC_SELECT_FLEX, THIGMO_ADC_SELECT_OTHER}) {
    gpio_init(pin[name]);
    gpio_put(pin[name], true);
    gpio_set_dir(pin[name], GPIO_OUT);
  }
  spi_init(spi_of(pin[THIGMO_ADC_SCK]) == 0 ? spi0 : spi1, kSpiHz);
  for (const int8_t name : {THIGMO_ADC_SCK, THIGMO_ADC_MOSI, THIGMO_ADC_MISO}) {
    gpio_set_function(pin[name], GPIO_FUNC_SPI);
  }
  uart_init(uart_of(pin[THIGMO_LINK_TX]) == 0 ? uart0 : uart1, kBaud);
  for (const int8_t name : {THIGMO_LINK_TX, THIGMO_LINK_RX}) {
    gpio_set_function(pin[name], GPIO_FUNC_UART);
    gpio_pull_up(pin[name]);
  }
  reset_unreset_block_num_wait_blocking(RESET_ADC);
  adc_hw->cs = ADC_CS_EN_BITS;
  gpio_set_function(pin[THIGMO_SUPPLY], GPIO_FUNC_NULL);
  gpio_disable_pulls(pin[THIGMO_SUPPLY]);
  gpio_set_input_enabled(pin[THIGMO_SUPPLY], false);
  for (const int8_t name : {THIGMO_ENCODER_A, THIGMO_ENCODER_B}) {
    hw_set_bits(&io_bank0_hw->proc1_irq_ctrl.inte[pin[name] / 8], 0xCu << (pin[name] % 8 * 4));
  }
  hw_set_bits(&timer_hw->inte, 1u << PicoBoard::kAlarm);
}

// Core 0, every few milliseconds: what only Python's thread can do is put before it.
bool on_clock(repeating_timer_t*) {
  if (news || board().saving()) thigmo_call_soon();
  return true;
}

}  // namespace

extern "C" {

const char* thigmo_begin(const int8_t* given) {
  if (const char* const problem = problem_of(given)) return problem;
  memcpy(pin, given, sizeof pin);
  static_cast<void>(*const_cast<const volatile char*>(signature.magic));  // stays in the image
  set_up();
  const protocol::ResetCause why = cause();
  if (why == protocol::ResetCause::kPowerOn) kept.keep(Latches{});
  again = true;
  new (board_storage) PicoBoard(pin, flash, kept, why);
  new (robot_storage) Robot<PicoBoard>(board());
  new (program_storage) Program<PicoBoard>(robot());
  halted = nullptr;
  asked = news = false;
  for (uint32_t& vector : vectors) vector = reinterpret_cast<uint32_t>(stand_still);
  vectors[16 + TIMER_IRQ_0 + PicoBoard::kAlarm] = reinterpret_cast<uint32_t>(on_slot);
  vectors[16 + IO_IRQ_BANK0] = reinterpret_cast<uint32_t>(on_edge);
  watchdog_enable(kWatchdogMs, false);
  alive = true;
  multicore_launch_core1_raw(run, stack + sizeof stack / sizeof *stack,
                             reinterpret_cast<uint32_t>(vectors));
  if (!add_repeating_timer_ms(-kClockMs, on_clock, nullptr, &clock)) {
    thigmo_end();
    return "the chip has no alarm left";
  }
  return nullptr;
}

void thigmo_end(void) {
  if (!alive) return;
  cancel_repeating_timer(&clock);
  multicore_reset_core1();
  outputs_off();
  watchdog_disable();
  alive = false;
  hw_clear_bits(&timer_hw->inte, 1u << PicoBoard::kAlarm);
  for (const int8_t name : {THIGMO_ENCODER_A, THIGMO_ENCODER_B}) {
    hw_clear_bits(&io_bank0_hw->proc1_irq_ctrl.inte[pin[name] / 8], 0xCu << (pin[name] % 8 * 4));
  }
  gpio_put(pin[THIGMO_ADC_SELECT_FLEX], true);
  gpio_put(pin[THIGMO_ADC_SELECT_OTHER], true);
}

void thigmo_halt(const char* why) {
  if (alive && halted == nullptr) halted = why;
}

const char* thigmo_halted(void) { return halted; }

bool thigmo_runs(void) { return alive && halted == nullptr; }

uint32_t thigmo_schema_hash(void) { return protocol::kSchemaHash; }

bool thigmo_ask(thigmo_request_t* wanted) {
  if (!thigmo_runs()) return false;
  request = *wanted;
  __dmb();
  asked = true;
  while (asked) {  // a core that hangs is reset by the watchdog
    if (halted != nullptr) return false;
  }
  __dmb();
  *wanted = request;
  return true;
}

void thigmo_serve(void) {
  news = false;
  if (thigmo_runs()) board().save_if_asked();
}

int __real_mp_hal_stdin_rx_chr(void);
int thigmo_key(void) { return __real_mp_hal_stdin_rx_chr(); }
}
