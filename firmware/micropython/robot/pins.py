# The lab's wiring: the number of the pin of each signal, 0 to 29, each pin once.
#
# Injected hardware (the unix port, QEMU's Cortex-M3) has no pins: the map is checked, and no more.
PINS = {
    "drive_left": 2,  # transducer current left, PWM
    "drive_right": 3,  # transducer current right, PWM
    "motor_pwm": 4,  # motor driver PWM
    "motor_direction": 5,  # motor driver DIR, high pays out
    "muscle_air": 6,  # air enable of the muscles: toggles while air is wanted
    "body_air": 7,  # air enable of the body
    "motor_power": 11,  # the motor's supply, behind its contacts, divided
    "motor_enable": 12,  # enable of the motor's supply: toggles while the motor may move
    "brake_enable": 13,  # enable of the brake's coil
    "encoder_a": 8,
    "encoder_b": 9,
    "estop": 10,  # closed to ground = run
    "link_tx": 0,  # the host's serial line, never the one of Python's prompt
    "link_rx": 1,
    "adc_sck": 18,  # the external converters
    "adc_mosi": 19,
    "adc_miso": 16,
    "adc_select_flex": 17,  # of flex left 0..4 and flex right 0..2
    "adc_select_other": 20,  # of flex right 3..4, pressures left and right
    "supply": 26,  # the sensors' 5 V rail, divided
}
