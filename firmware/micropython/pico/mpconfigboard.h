// MicroPython on a Pico whose second core is the controller's.
#define MICROPY_HW_BOARD_NAME "Raspberry Pi Pico with thigmo"

// The controller's store is the two sectors below the file system.
#define MICROPY_HW_FLASH_STORAGE_BYTES (1400 * 1024)
#define THIGMO_STORE_AT (PICO_FLASH_SIZE_BYTES - MICROPY_HW_FLASH_STORAGE_BYTES - 8192)

#define MICROPY_PY_THREAD (0)  // _thread would take the second core
