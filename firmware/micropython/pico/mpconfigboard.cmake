# A Raspberry Pi Pico with the controller on its second core.
set(PICO_BOARD "pico")
set(PICO_PLATFORM "rp2040")
# What the controller's code calls lies in RAM as it does: flash stands still while it is written.
add_compile_definitions(PICO_MEM_IN_RAM=1 PICO_DIVIDER_IN_RAM=1 PICO_BITS_IN_RAM=1 PICO_INT64_OPS_IN_RAM=1)
