// Python's view of the virtual board: the extension modules thigmo.emulator._board, of the thesis's
// capacity, and _large_board, of the wire's.
//
// Types are in host/thigmo/emulator/_board.pyi; the emulator and the tests are its only users.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include <stdexcept>
#include <string>

#include "virtual_board.h"

namespace nb = nanobind;
using thigmo::Analog;
using thigmo::VirtualBoard;

namespace {

using Levels =
    nb::ndarray<const double, nb::shape<Analog::kChannels, 2>, nb::c_contig, nb::device::cpu>;
using Noise =
    nb::ndarray<const double, nb::shape<Analog::kChannels>, nb::c_contig, nb::device::cpu>;
using Trace = nb::ndarray<const int64_t, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;

std::string text(const nb::bytes& bytes) { return std::string(bytes.c_str(), bytes.size()); }
nb::bytes bytes(const std::string& text) { return nb::bytes(text.data(), text.size()); }

void check_eeprom(const std::string& image) {
  if (image.size() > VirtualBoard::kEepromSize) {
    throw std::invalid_argument("the image is longer than the EEPROM");
  }
}

void check_profile(uint8_t adc_bits, uint16_t frame_us) {
  if (adc_bits < thigmo::kAdcBits || adc_bits > 16 || frame_us == 0 || frame_us >= 1000) {
    throw std::invalid_argument("a converter has 10 to 16 bits and a frame 1 to 999 us");
  }
}

}  // namespace

NB_MODULE(THIGMO_MODULE, m) {
  nb::set_leak_warnings(false);  // as in host/thigmo/emulator/plant.cpp
  m.doc() = "The firmware core on a virtual board.";
  m.attr("SCHEMA_HASH") = thigmo::protocol::kSchemaHash;
  nb::class_<Analog>(m, "Analog")
      .def(
          "__init__",
          [](Analog* self, uint64_t seed, uint8_t adc_bits, uint16_t frame_us) {
            check_profile(adc_bits, frame_us);
            new (self) Analog(seed, adc_bits, frame_us);
          },
          nb::arg("seed"), nb::arg("adc_bits"), nb::arg("frame_us"))
      .def(
          "set_levels", [](Analog& self, const Levels& counts) { self.set_levels(counts.data()); },
          nb::arg("counts"))
      .def(
          "set_noise", [](Analog& self, const Noise& sigma) { self.set_noise(sigma.data()); },
          nb::arg("sigma"))
      .def("settle", &Analog::settle)
      .def(
          "feed", [](Analog& self, const Trace& rows) { self.feed(rows.data(), rows.shape(0)); },
          nb::arg("rows"))
      .def(
          "frames",
          [](Analog& self, uint32_t tick, uint32_t ticks, uint32_t begun, double tick_share) {
            auto* counts = new std::vector<uint16_t>;
            for (uint32_t i = 0; i < ticks; ++i) {
              const thigmo::AdcFrame frame =
                  self.frame(tick + i, (begun + i) * tick_share, tick_share);
              counts->insert(counts->end(), frame.count, frame.count + thigmo::kAdcSlots);
            }
            nb::capsule owner(
                counts, [](void* p) noexcept { delete static_cast<std::vector<uint16_t>*>(p); });
            return nb::ndarray<nb::numpy, uint16_t, nb::ndim<2>>(counts->data(),
                                                                 {ticks, thigmo::kAdcSlots}, owner);
          },
          nb::arg("tick"), nb::arg("ticks"), nb::arg("begun"), nb::arg("tick_share"));
  nb::class_<VirtualBoard>(m, "VirtualBoard")
      .def(
          "__init__",
          [](VirtualBoard* self, uint64_t seed, const nb::bytes& eeprom, uint8_t adc_bits,
             uint16_t frame_us) {
            const std::string image = text(eeprom);
            check_eeprom(image);
            check_profile(adc_bits, frame_us);
            new (self) VirtualBoard(seed, image, adc_bits, frame_us);
          },
          nb::arg("seed"), nb::arg("eeprom") = nb::bytes("", 0),
          nb::arg("adc_bits") = thigmo::kAdcBits,
          nb::arg("frame_us") = static_cast<int>(VirtualBoard::kFrameUs))
      .def("step", &VirtualBoard::step, nb::arg("ticks"))
      .def_prop_ro("now_us", &VirtualBoard::now_us)
      .def(
          "write", [](VirtualBoard& self, const nb::bytes& data) { self.write(text(data)); },
          nb::arg("data"))
      .def("read", [](VirtualBoard& self) { return bytes(self.read()); })
      .def(
          "set_analog",
          [](VirtualBoard& self, const Levels& counts) { self.analog().set_levels(counts.data()); },
          nb::arg("counts"))
      .def(
          "set_adc_noise",
          [](VirtualBoard& self, const Noise& sigma) { self.analog().set_noise(sigma.data()); },
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
            self.analog().feed(rows.data(), rows.shape(0));
          },
          nb::arg("rows"))
      .def(
          "record_trace", [](VirtualBoard& self, bool on) { self.analog().record(on); },
          nb::arg("on"))
      .def("recorded_trace",
           [](const VirtualBoard& self) {
             const auto& rows = self.analog().recorded();
             auto* copy = new std::vector<std::array<int64_t, 3>>(rows);
             nb::capsule owner(copy, [](void* p) noexcept {
               delete static_cast<std::vector<std::array<int64_t, 3>>*>(p);
             });
             return nb::ndarray<nb::numpy, int64_t, nb::ndim<2>>(copy->data(), {copy->size(), 3},
                                                                 owner);
           })
      .def_prop_ro("drive",
                   [](const VirtualBoard& self) {
                     nb::list drive;
                     for (const int duty : self.drive()) drive.append(duty);
                     return nb::tuple(drive);
                   })
      .def_prop_ro("drive_enabled",
                   [](const VirtualBoard& self) {
                     nb::list enabled;
                     for (const bool on : self.drive_enabled()) enabled.append(on);
                     return nb::tuple(enabled);
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
