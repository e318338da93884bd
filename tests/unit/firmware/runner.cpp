// All C++ tests of the firmware core in one program: `runner` lists the cases, `runner NAME` runs
// one. test_firmware_core.py builds it (with sanitizers) and runs each case as a test of its own.
#include <cstring>

#include "check.h"
#include "control_cases.h"
#include "flash_store_cases.h"
#include "link_cases.h"
#include "safety_cases.h"
#include "sensing_cases.h"
#include "store_cases.h"

int main(int count, char** arguments) {
  for (const Case& test : cases()) {
    if (count < 2) {
      std::puts(test.name);
    } else if (std::strcmp(test.name, arguments[1]) == 0) {
      test.run();
      return failures() == 0 ? 0 : 1;
    }
  }
  return count < 2 ? 0 : 2;
}
