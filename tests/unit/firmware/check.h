// The smallest test harness: named cases, checks that print what differs, one process a case.
#ifndef THIGMO_TESTS_FIRMWARE_CHECK_H_
#define THIGMO_TESTS_FIRMWARE_CHECK_H_

#include <cstdint>
#include <cstdio>
#include <random>
#include <vector>

struct Case {
  const char* name;
  void (*run)();
};

inline std::vector<Case>& cases() {
  static std::vector<Case> all;
  return all;
}

inline int& failures() {
  static int count = 0;
  return count;
}

struct Register {
  Register(const char* name, void (*run)()) { cases().push_back({name, run}); }
};

#define TEST(name)                            \
  static void name();                         \
  static const Register name##_(#name, name); \
  static void name()

inline void fail(const char* file, int line, const char* expression, double got, double want) {
  if (++failures() <= 10) {
    std::printf("%s:%d: %s: got %.9g, want %.9g\n", file, line, expression, got, want);
  }
}

#define CHECK(condition) \
  if (!(condition)) fail(__FILE__, __LINE__, #condition, 0, 1)
#define CHECK_EQUAL(got, want) \
  if (!((got) == (want)))      \
  fail(__FILE__, __LINE__, #got " == " #want, static_cast<double>(got), static_cast<double>(want))
#define CHECK_NEAR(got, want, within)                                                 \
  if (!(std::fabs(static_cast<double>(got) - static_cast<double>(want)) <= (within))) \
  fail(__FILE__, __LINE__, #got " ~ " #want, static_cast<double>(got), static_cast<double>(want))

#endif  // THIGMO_TESTS_FIRMWARE_CHECK_H_
