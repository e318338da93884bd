# The module for the port that is built with CMake: the Pico's.
add_library(usermod_thigmo_board INTERFACE)
target_sources(usermod_thigmo_board INTERFACE
  ${CMAKE_CURRENT_LIST_DIR}/module.c
  ${CMAKE_CURRENT_LIST_DIR}/pico.cpp
)
target_include_directories(usermod_thigmo_board INTERFACE ${CMAKE_CURRENT_LIST_DIR})
# What takes the program from its course passes through module.c first.
target_link_options(usermod_thigmo_board INTERFACE -Wl,--wrap=mp_sched_keyboard_interrupt
  -Wl,--wrap=mp_hal_stdin_rx_chr -Wl,--wrap=m_malloc_fail)
target_link_libraries(usermod INTERFACE usermod_thigmo_board)
set_source_files_properties(${CMAKE_CURRENT_LIST_DIR}/pico.cpp PROPERTIES COMPILE_OPTIONS
  "-std=c++14;-O2;-Wall;-Wextra;-Werror;-fno-exceptions;-fno-rtti;-fno-threadsafe-statics")
