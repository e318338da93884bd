# The module for ports that are built with make: unix and qemu.
THIGMO_BOARD_DIR := $(USERMOD_DIR)

SRC_USERMOD_C += $(THIGMO_BOARD_DIR)/module.c
SRC_USERMOD_LIB_CXX += $(THIGMO_BOARD_DIR)/injected.cpp

CFLAGS_USERMOD += -I$(THIGMO_BOARD_DIR)
CXXFLAGS_USERMOD += -I$(THIGMO_BOARD_DIR) -std=c++14 -Wall -Wextra -Werror -O2
ifdef THIGMO_LARGE
CXXFLAGS_USERMOD += -DTHIGMO_MUSCLES=4 -DTHIGMO_SENSORS=16 -DTHIGMO_BODY_PRESSURES=8 -DTHIGMO_IMUS=16
endif
CXXFLAGS_USERMOD += -fno-exceptions -fno-rtti -fno-threadsafe-statics

ifeq ($(QEMU_ARCH),arm)
SRC_USERMOD_LIB_C += $(THIGMO_BOARD_DIR)/stream_mps2.c
CXXFLAGS_USERMOD += -mthumb -mcpu=cortex-m3 -mfloat-abi=soft -ffunction-sections -fdata-sections
else
SRC_USERMOD_LIB_C += $(THIGMO_BOARD_DIR)/stream_unix.c
LDFLAGS_USERMOD += -lpthread
endif
COMMA := ,
# What takes the program from its course passes through module.c first.
LDFLAGS_USERMOD += $(addprefix -Wl$(COMMA)--wrap=,mp_sched_keyboard_interrupt mp_hal_stdin_rx_chr m_malloc_fail)
