// A NumPy array of values that C++ computed.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <utility>
#include <vector>

namespace thigmo {

// An array that Python owns.
template <typename Value, std::size_t N>
nanobind::ndarray<nanobind::numpy, Value> owned_array(std::vector<Value> values,
                                                      const std::size_t (&shape)[N]) {
  auto* kept = new std::vector<Value>(std::move(values));
  nanobind::capsule owner(kept,
                          [](void* p) noexcept { delete static_cast<std::vector<Value>*>(p); });
  return nanobind::ndarray<nanobind::numpy, Value>(kept->data(), N, shape, owner);
}

}  // namespace thigmo
