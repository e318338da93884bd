# The lab's wiring: edit this file, and nothing else, if yours differs from docs/hardware/pico.md.
#
# GPIO numbers of the Pico, 0 to 29. The two outputs of a PWM slice are GP 2n and 2n + 1; the
# transducers need both outputs of one slice, the motor one of another.
PINS = {
    "drive_left": 2,         # transducer current left, PWM 9.8 kHz
    "drive_right": 3,        # transducer current right
    "motor_pwm": 4,          # motor driver PWM, 19.5 kHz
    "motor_direction": 5,    # motor driver DIR, high pays out
    "muscle_air": 6,         # air enable of the muscles: toggles while air is wanted
    "body_air": 7,           # air enable of the body
    "encoder_a": 8,          # through the level shifter
    "encoder_b": 9,
    "estop": 10,             # closed to ground = run; pull-up inside
    "link_tx": 0,            # UART 0 to the host's serial adapter, 3.3 V
    "link_rx": 1,
    "adc_sck": 18,           # SPI 0 to the two MCP3208
    "adc_mosi": 19,
    "adc_miso": 16,
    "adc_select_flex": 17,   # MCP3208 with flex left 0..4 and flex right 0..2
    "adc_select_other": 20,  # MCP3208 with flex right 3..4, pressures left and right
    "supply": 26,            # 5 V rail over 1:2, ADC 0
}
