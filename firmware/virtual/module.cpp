// Python's view of the virtual board: the extension module thigmo.emulator._board.
//
// Types are in host/thigmo/emulator/_board.pyi; the emulator and the tests are its only users.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include <stdexcept>
#include <string>

#include "virtual_board.h"

namespace nb = nanobind;
using thigmo::VirtualBoard;

namespace {

using Analog =
    nb::ndarray<const double, nb::shape<VirtualBoard::kChannels, 2>, nb::c_contig, nb::device::cpu>;
using Noise =
    nb::ndarray<const double, nb::shape<VirtualBoard::kChannels>, nb::c_contig, nb::device::cpu>;
using Trace = nb::ndarray<const int64_t, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;

std::string text(const nb::bytes& bytes) { return std::string(bytes.c_str(), bytes.size()); }
nb::bytes bytes(const std::string& text) { return nb::bytes(text.data(), text.size()); }

void check_eeprom(const std::string& image) {
  if (image.size() > VirtualBoard::kEepromSize) {
    throw std::invalid_argument("the EEPROM holds 4096 bytes");
  }
}

}  // namespace

NB_MODULE(_board, m) {
  m.doc() = "The firmware core on a virtual board.";
  m.attr("SCHEMA_HASH") = thigmo::protocol::kSchemaHash;
  nb::class_<VirtualBoard>(m, "VirtualBoard")
      .def(
          "__init__",
          [](VirtualBoard* self, uint64_t seed, const nb::bytes& eeprom) {
            const std::string image = text(eeprom);
            check_eeprom(image);
            new (self) VirtualBoard(seed, image);
          },
          nb::arg("seed"), nb::arg("eeprom") = nb::bytes("", 0))
      .def("step", &VirtualBoard::step, nb::arg("ticks"))
      .def_prop_ro("now_us", &VirtualBoard::now_us)
      .def(
          "write", [](VirtualBoard& self, const nb::bytes& data) { self.write(text(data)); },
          nb::arg("data"))
      .def("read", [](VirtualBoard& self) { return bytes(self.read()); })
      .def(
          "set_analog",
          [](VirtualBoard& self, const Analog& counts) { self.set_analog(counts.data()); },
          nb::arg("counts"))
      .def(
          "set_adc_noise",
          [](VirtualBoard& self, const Noise& sigma) { self.set_adc_noise(sigma.data()); },
          nb::arg("sigma"))
      .def("set_encoder", &VirtualBoard::set_encoder, nb::arg("start"), nb::arg("end"))
      .def("set_supply_mv", &VirtualBoard::set_supply_mv, nb::arg("supply_mv"))
      .def("set_encoder_errors", &VirtualBoard::set_encoder_errors, nb::arg("errors"))
      .def("set_estop", &VirtualBoard::set_estop, nb::arg("pressed"))
      .def("set_motor_power", &VirtualBoard::set_motor_power, nb::arg("on"))
      .def(
          "reset",
          [](VirtualBoard& self, int cause) {
            if (cause < 0 || cause >= thigmo::protocol::kResetCauseCount) {
              throw std::invalid_argument("no such reset cause");
            }
            self.reset(static_cast<thigmo::protocol::ResetCause>(cause));
          },
          nb::arg("cause"))
      .def("hang", &VirtualBoard::hang)
      .def("stall", &VirtualBoard::stall, nb::arg("ticks"))
      .def("cut_power_after", &VirtualBoard::cut_power_after, nb::arg("bytes_written"))
      .def(
          "feed_trace",
          [](VirtualBoard& self, const Trace& rows) {
            self.feed_trace(rows.data(), rows.shape(0));
          },
          nb::arg("rows"))
      .def("record_trace", &VirtualBoard::record_trace, nb::arg("on"))
      .def("recorded_trace",
           [](const VirtualBoard& self) {
             const auto& rows = self.recorded();
             auto* copy = new std::vector<std::array<int64_t, 3>>(rows);
             nb::capsule owner(copy, [](void* p) noexcept {
               delete static_cast<std::vector<std::array<int64_t, 3>>*>(p);
             });
             return nb::ndarray<nb::numpy, int64_t, nb::ndim<2>>(copy->data(), {copy->size(), 3},
                                                                 owner);
           })
      .def_prop_ro(
          "drive",
          [](const VirtualBoard& self) { return nb::make_tuple(self.drive()[0], self.drive()[1]); })
      .def_prop_ro("drive_enabled",
                   [](const VirtualBoard& self) {
                     return nb::make_tuple(self.drive_enabled()[0], self.drive_enabled()[1]);
                   })
      .def_prop_ro("motor", static_cast<int (VirtualBoard::*)() const>(&VirtualBoard::motor))
      .def_prop_ro("braked", &VirtualBoard::braked)
      .def_prop_ro(
          "air",
          [](const VirtualBoard& self) { return nb::make_tuple(self.enabled(0), self.enabled(1)); })
      .def_prop_ro(
          "motor_enables",
          [](const VirtualBoard& self) { return nb::make_tuple(self.enabled(2), self.enabled(3)); })
      .def_prop_ro("direction", &VirtualBoard::direction)
      .def_prop_ro("powered", &VirtualBoard::powered)
      .def_prop_ro("running", &VirtualBoard::running)
      .def_prop_ro("boots", &VirtualBoard::boots)
      .def_prop_ro("eeprom", [](const VirtualBoard& self) { return bytes(self.eeprom()); });
}
