// The Python module thigmo_board: run(pins, each=None).
//
// While run() waits, the controller runs; whatever ends the wait (Ctrl-C, mpremote, an exception in
// `each`, a full heap) first puts the outputs off and ends the controller, then goes on in Python.
// run() itself allocates nothing after its start.
#include "controller.h"
#include "py/mphal.h"
#include "py/runtime.h"

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
    mp_map_elem_t* found = mp_map_lookup(&dict->map, MP_OBJ_NEW_QSTR(pin_names[i]), MP_MAP_LOOKUP);
    if (found == NULL) {
      mp_raise_msg_varg(&mp_type_ValueError, MP_ERROR_TEXT("pins lacks '%q'"), pin_names[i]);
    }
    mp_int_t number = mp_obj_get_int(found->value);
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
  if (dict->map.used != THIGMO_PINS) {
    mp_raise_ValueError(MP_ERROR_TEXT("pins has a name that the board does not know"));
  }
}

static mp_obj_t board_run(size_t n_args, const mp_obj_t* args) {
  int8_t pins[THIGMO_PINS];
  take_pins(args[0], pins);
  mp_obj_t each = n_args > 1 ? args[1] : mp_const_none;
  const char* problem = thigmo_begin(pins);
  if (problem != NULL) {
    mp_raise_msg_varg(&mp_type_OSError, MP_ERROR_TEXT("%s"), problem);
  }
  nlr_buf_t nlr;
  if (nlr_push(&nlr) == 0) {
    while (thigmo_wait()) {
      mp_handle_pending(true);
      if (each != mp_const_none) {
        mp_call_function_0(each);
      }
    }
    nlr_pop();
    thigmo_end();
    return mp_const_none;
  }
  thigmo_end();
  nlr_jump(nlr.ret_val);
}
static MP_DEFINE_CONST_FUN_OBJ_VAR_BETWEEN(board_run_obj, 1, 2, board_run);

// A soft reset imports main.py and this module again: nothing keeps running from before.
static mp_obj_t board_init(void) {
  thigmo_end();
  return mp_const_none;
}
static MP_DEFINE_CONST_FUN_OBJ_0(board_init_obj, board_init);

static const mp_rom_map_elem_t board_globals_table[] = {
    {MP_ROM_QSTR(MP_QSTR___name__), MP_ROM_QSTR(MP_QSTR_thigmo_board)},
    {MP_ROM_QSTR(MP_QSTR___init__), MP_ROM_PTR(&board_init_obj)},
    {MP_ROM_QSTR(MP_QSTR_run), MP_ROM_PTR(&board_run_obj)},
};
static MP_DEFINE_CONST_DICT(board_globals, board_globals_table);

const mp_obj_module_t thigmo_board_module = {
    .base = {&mp_type_module},
    .globals = (mp_obj_dict_t*)&board_globals,
};
MP_REGISTER_MODULE(MP_QSTR_thigmo_board, thigmo_board_module);
