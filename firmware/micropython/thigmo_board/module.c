// The Python module _thigmo, on which thigmo_board.py is built: start, stop and ask the controller.
//
// Whatever takes the program from its course puts the outputs off before Python hears of it:
// Ctrl-C, Ctrl-D, a raw prompt, a full heap (the linker has their functions call those here first),
// an exception in the callback, and a soft reset (by a finaliser).
#include <string.h>

#include "controller.h"
#include "py/mphal.h"
#include "py/runtime.h"
#if !defined(__unix__)
#include "shared/runtime/interrupt_char.h"
#include "shared/runtime/pyexec.h"
#endif

static const qstr pin_names[THIGMO_PINS] = {
    MP_QSTR_drive_left,       MP_QSTR_drive_right,  MP_QSTR_motor_pwm,
    MP_QSTR_motor_direction,  MP_QSTR_muscle_air,   MP_QSTR_body_air,
    MP_QSTR_motor_power,      MP_QSTR_motor_enable, MP_QSTR_brake_enable,
    MP_QSTR_encoder_a,        MP_QSTR_encoder_b,    MP_QSTR_estop,
    MP_QSTR_link_tx,          MP_QSTR_link_rx,      MP_QSTR_adc_sck,
    MP_QSTR_adc_mosi,         MP_QSTR_adc_miso,     MP_QSTR_adc_select_flex,
    MP_QSTR_adc_select_other, MP_QSTR_supply,
};

static void take_pins(mp_obj_t given, int8_t* pins) {
  mp_obj_dict_t* dict = MP_OBJ_TO_PTR(given);
  if (!mp_obj_is_dict_or_ordereddict(given)) {
    mp_raise_TypeError(MP_ERROR_TEXT("pins is a dictionary: name -> number"));
  }
  for (size_t i = 0; i < THIGMO_PINS; ++i) {
    mp_map_elem_t* entry = mp_map_lookup(&dict->map, MP_OBJ_NEW_QSTR(pin_names[i]), MP_MAP_LOOKUP);
    if (entry == NULL) {
      mp_raise_msg_varg(&mp_type_ValueError, MP_ERROR_TEXT("pins lacks '%q'"), pin_names[i]);
    }
    mp_int_t number = mp_obj_get_int(entry->value);
    if (number < 0 || number > 29) {
      mp_raise_msg_varg(&mp_type_ValueError, MP_ERROR_TEXT("pin '%q' is not 0 to 29"),
                        pin_names[i]);
    }
    for (size_t j = 0; j < i; ++j) {
      if (pins[j] == number) {
        mp_raise_msg_varg(&mp_type_ValueError, MP_ERROR_TEXT("'%q' and '%q' share pin %d"),
                          pin_names[j], pin_names[i], (int)number);
      }
    }
    pins[i] = (int8_t)number;
  }
}

// --- what ends the controller --------------------------------------------------------------------
enum { CTRL_C = 3, CTRL_D = 4 };

void __real_mp_sched_keyboard_interrupt(void);
void __wrap_mp_sched_keyboard_interrupt(void) {
  thigmo_halt("Ctrl-C");
  __real_mp_sched_keyboard_interrupt();
}

NORETURN void __real_m_malloc_fail(size_t bytes);
NORETURN void __wrap_m_malloc_fail(size_t bytes) {
  thigmo_halt("the heap is full");
  __real_m_malloc_fail(bytes);
}

int __wrap_mp_hal_stdin_rx_chr(void) {
#if !defined(__unix__)
  if (pyexec_mode_kind == PYEXEC_MODE_RAW_REPL && mp_interrupt_char < 0) {
    thigmo_halt("a raw prompt");
  }
#endif
  const int key = thigmo_key();
  if (key == CTRL_C) thigmo_halt("Ctrl-C");
  if (key == CTRL_D) thigmo_halt("Ctrl-D");
  return key;
}

// --- the program's callback ----------------------------------------------------------------------
MP_REGISTER_ROOT_POINTER(mp_obj_t thigmo_callback);
MP_REGISTER_ROOT_POINTER(mp_obj_t thigmo_guard);
static volatile bool call_waits;

static mp_obj_t call_now(mp_obj_t unused) {
  (void)unused;
  call_waits = false;
  thigmo_serve();
  const mp_obj_t callback = MP_STATE_VM(thigmo_callback);
  if (callback == MP_OBJ_NULL || callback == mp_const_none) return mp_const_none;
  nlr_buf_t nlr;
  if (nlr_push(&nlr) == 0) {
    mp_call_function_0(callback);
    nlr_pop();
    return mp_const_none;
  }
  thigmo_halt("an exception in the callback");
  nlr_jump(nlr.ret_val);
}
static MP_DEFINE_CONST_FUN_OBJ_1(call_now_obj, call_now);

void thigmo_call_soon(void) {
  if (call_waits) return;
  call_waits = true;
  if (!mp_sched_schedule(MP_OBJ_FROM_PTR(&call_now_obj), mp_const_none)) call_waits = false;
}

// --- the module ----------------------------------------------------------------------------------
static mp_obj_t end(void) {
  thigmo_end();
  MP_STATE_VM(thigmo_callback) = mp_const_none;
  return mp_const_none;
}
static MP_DEFINE_CONST_FUN_OBJ_0(end_obj, end);

// Swept at a soft reset, and then ends the controller.
static mp_obj_t guard_del(mp_obj_t self) {
  if (self == MP_STATE_VM(thigmo_guard)) end();
  return mp_const_none;
}
static MP_DEFINE_CONST_FUN_OBJ_1(guard_del_obj, guard_del);
static const mp_rom_map_elem_t guard_locals_table[] = {
    {MP_ROM_QSTR(MP_QSTR___del__), MP_ROM_PTR(&guard_del_obj)},
};
static MP_DEFINE_CONST_DICT(guard_locals, guard_locals_table);
static MP_DEFINE_CONST_OBJ_TYPE(guard_type, MP_QSTR_guard, MP_TYPE_FLAG_NONE, locals_dict,
                                &guard_locals);

static mp_obj_t start(mp_obj_t given) {
  int8_t pins[THIGMO_PINS];
  take_pins(given, pins);
  mp_obj_base_t* guard = mp_obj_malloc_with_finaliser(mp_obj_base_t, &guard_type);
  end();
  MP_STATE_VM(thigmo_guard) = MP_OBJ_FROM_PTR(guard);
  call_waits = false;
  const char* problem = thigmo_begin(pins);
  if (problem != NULL) {
    mp_raise_msg_varg(&mp_type_OSError, MP_ERROR_TEXT("%s"), problem);
  }
  return mp_const_none;
}
static MP_DEFINE_CONST_FUN_OBJ_1(start_obj, start);

static mp_obj_t runs(void) { return mp_obj_new_bool(thigmo_runs()); }
static MP_DEFINE_CONST_FUN_OBJ_0(runs_obj, runs);

static mp_obj_t schema_hash(void) { return mp_obj_new_int_from_uint(thigmo_schema_hash()); }
static MP_DEFINE_CONST_FUN_OBJ_0(schema_hash_obj, schema_hash);

static mp_obj_t notify(mp_obj_t callback) {
  MP_STATE_VM(thigmo_callback) = callback;
  thigmo_call_soon();
  return mp_const_none;
}
static MP_DEFINE_CONST_FUN_OBJ_1(notify_obj, notify);

// ask(what, id=0, payload=b""): the answer's bytes.
static mp_obj_t ask(size_t count, const mp_obj_t* args) {
  thigmo_request_t request = {0};
  request.kind = (uint8_t)mp_obj_get_int(args[0]);
  if (count > 1) request.id = (uint8_t)mp_obj_get_int(args[1]);
  if (count > 2) {
    mp_buffer_info_t given;
    mp_get_buffer_raise(args[2], &given, MP_BUFFER_READ);
    if (given.len > sizeof request.bytes) {
      mp_raise_ValueError(MP_ERROR_TEXT("the payload is too long"));
    }
    memcpy(request.bytes, given.buf, given.len);
    request.size = (uint8_t)given.len;
  }
  if (!thigmo_ask(&request)) {
    const char* why = thigmo_halted();
    mp_raise_msg_varg(&mp_type_OSError, MP_ERROR_TEXT("the controller does not run: %s"),
                      why != NULL ? why : "start() it");
  }
  if (request.outcome == THIGMO_HOSTED) {
    mp_raise_msg(&mp_type_OSError, MP_ERROR_TEXT("a host has the robot; arm() takes it over once "
                                                 "the host is silent"));
  }
  if (request.outcome == THIGMO_NOT_SO) {
    mp_raise_ValueError(MP_ERROR_TEXT("the controller knows no such command"));
  }
  return mp_obj_new_bytes(request.bytes, request.size);
}
static MP_DEFINE_CONST_FUN_OBJ_VAR_BETWEEN(ask_obj, 1, 3, ask);

static const mp_rom_map_elem_t thigmo_globals_table[] = {
    {MP_ROM_QSTR(MP_QSTR___name__), MP_ROM_QSTR(MP_QSTR__thigmo)},
    {MP_ROM_QSTR(MP_QSTR_start), MP_ROM_PTR(&start_obj)},
    {MP_ROM_QSTR(MP_QSTR_end), MP_ROM_PTR(&end_obj)},
    {MP_ROM_QSTR(MP_QSTR_runs), MP_ROM_PTR(&runs_obj)},
    {MP_ROM_QSTR(MP_QSTR_schema_hash), MP_ROM_PTR(&schema_hash_obj)},
    {MP_ROM_QSTR(MP_QSTR_notify), MP_ROM_PTR(&notify_obj)},
    {MP_ROM_QSTR(MP_QSTR_ask), MP_ROM_PTR(&ask_obj)},
    {MP_ROM_QSTR(MP_QSTR_TAKE), MP_ROM_INT(THIGMO_TAKE)},
    {MP_ROM_QSTR(MP_QSTR_BEAT), MP_ROM_INT(THIGMO_BEAT)},
    {MP_ROM_QSTR(MP_QSTR_COMMAND), MP_ROM_INT(THIGMO_COMMAND)},
    {MP_ROM_QSTR(MP_QSTR_STOP), MP_ROM_INT(THIGMO_STOP)},
    {MP_ROM_QSTR(MP_QSTR_CURVATURE), MP_ROM_INT(THIGMO_CURVATURE)},
    {MP_ROM_QSTR(MP_QSTR_EVENT), MP_ROM_INT(THIGMO_EVENT)},
};
static MP_DEFINE_CONST_DICT(thigmo_globals, thigmo_globals_table);

const mp_obj_module_t thigmo_module = {
    .base = {&mp_type_module},
    .globals = (mp_obj_dict_t*)&thigmo_globals,
};
MP_REGISTER_MODULE(MP_QSTR__thigmo, thigmo_module);
