// Python's view of the rod: the extension module thigmo.mechanics._rod.
//
// Types are in _rod.pyi; elastica.py is its only user.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <tuple>

#include "../owned_array.h"
#include "rod.h"

namespace nb = nanobind;
using namespace thigmo::mechanics;
using thigmo::owned_array;

namespace {

using Values = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Result = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using RestRows = std::vector<std::tuple<double, double>>;  // ends and curvatures of pieces
using PegRows = std::vector<std::tuple<double, double, double, double, double, double>>;

constexpr const char* kModels[] = {"arc", "beam", "elastica"};
constexpr const char* kStatuses[] = {"converged", "relaxed", "approximate"};
constexpr const char* kKinds[] = {"side", "corner", "face", "corner", "side"};

template <typename Enum>
const char* name(const char* const* names, Enum value) {
  return names[static_cast<int>(value)];
}

std::optional<Model> model_named(const std::string& name) {
  if (name == "auto") return std::nullopt;
  for (int i = 0; i < 3; ++i) {
    if (name == kModels[i]) return static_cast<Model>(i);
  }
  throw BadInput("a model is 'auto', 'arc', 'beam' or 'elastica'");
}

double moment_or_none(std::optional<double> critical) {
  return critical.value_or(std::numeric_limits<double>::infinity());
}

std::vector<Peg> pegs_of(const PegRows& rows) {
  std::vector<Peg> pegs;
  for (const auto& [x, y, radius, to_x, to_y, compliance] : rows) {
    pegs.push_back({x, y, radius, to_x, to_y, compliance});
  }
  return pegs;
}

RestShape rest_of(const RestRows& rows) {
  std::vector<RestShape::Piece> pieces;
  for (const auto& [until, curvature] : rows) pieces.push_back({until, curvature});
  return RestShape(std::move(pieces));
}

}  // namespace

NB_MODULE(_rod, m) {
  nb::set_leak_warnings(false);  // as in host/thigmo/emulator/plant.cpp
  m.doc() = "The loaded body: arc, beam and large-deflection rod among pegs.";
  nb::register_exception_translator([](const std::exception_ptr& error, void*) {
    try {
      std::rethrow_exception(error);
    } catch (const BadInput& bad) {
      const nb::object type = nb::module_::import_("thigmo.errors").attr("DataError");
      PyErr_SetString(type.ptr(), bad.what());
    }
  });
  nb::class_<Rod>(m, "Rod")
      .def(
          "__init__",
          [](Rod* self, double diameter, std::optional<double> critical, const PegRows& pegs,
             double cell, const std::string& model, double tolerance, double friction,
             double base_compliance, double rounding, const RestRows& rest) {
            new (self)
                Rod(diameter, moment_or_none(critical), pegs_of(pegs), cell, model_named(model),
                    tolerance, friction, base_compliance, rounding, rest_of(rest));
          },
          nb::arg("diameter"), nb::arg("critical_moment").none(), nb::arg("pegs"), nb::arg("cell"),
          nb::arg("model"), nb::arg("tolerance"), nb::arg("friction"), nb::arg("base_compliance"),
          nb::arg("tip_rounding"), nb::arg("rest_curvature"))
      // Relaxation after a snap takes milliseconds.
      .def("step", &Rod::step, nb::arg("free_curvature"), nb::arg("length"),
           nb::call_guard<nb::gil_scoped_release>())
      .def("assume_free", &Rod::assume_free, nb::arg("free_curvature"), nb::arg("length"))
      .def("_place", [](Rod& rod, const PegRows& pegs) { rod.place(pegs_of(pegs)); })
      .def("press",
           [](Rod& rod, const Values& force, const Values& place, double fold_angle, double natural,
              double length) {
             std::vector<Contact> contacts;
             for (std::size_t j = 0; j < force.size(); ++j) {
               contacts.push_back({static_cast<int>(j), force.data()[j], place.data()[j]});
             }
             rod.press(std::move(contacts), fold_angle, natural, length);
           })
      .def("save", [](const Rod& rod) { return Rod(rod); })
      .def("restore", [](Rod& rod, const Rod& saved) { rod = saved; })
      .def("nodes",
           [](const Rod& rod) {
             auto* kept = new std::vector<Node>(rod.nodes());
             nb::capsule owner(kept,
                               [](void* p) noexcept { delete static_cast<std::vector<Node>*>(p); });
             return nb::ndarray<nb::numpy, double, nb::shape<-1, 5>>(kept->data(),
                                                                     {kept->size(), 5}, owner);
           })
      .def("averages_into",
           [](const Rod& rod, const Values& centers, const Values& spans, const Result& out) {
             const Centreline line = rod.centreline();
             for (std::size_t i = 0; i < std::min({centers.size(), spans.size(), out.size()});
                  ++i) {
               out.data()[i] = line.mean(centers.data()[i], spans.data()[i]);
             }
           })
      .def("_sweep",
           [](const Rod& rod, const Values& naturals, double length, const Values& centers,
              const Values& spans) {
             const auto list = [](const Values& values) {
               return std::vector<double>(values.data(), values.data() + values.size());
             };
             if (centers.size() != spans.size()) throw BadInput("a sensor has a centre and a span");
             Rod swept(rod);  // the rod itself stays where it is
             Sweep sweep;
             {
               nb::gil_scoped_release release;
               sweep = swept.sweep(list(naturals), length, list(centers), list(spans));
             }
             const std::size_t rows = sweep.rows, sensors = sweep.sensors;
             const std::size_t obstacles = sweep.obstacles, parameters = sweep.parameters();
             return nb::make_tuple(
                 owned_array(std::move(sweep.readings), {rows, sensors}),
                 owned_array(std::move(sweep.by_place), {rows, sensors}),
                 owned_array(std::move(sweep.by_parameter), {rows, sensors, parameters}),
                 owned_array(std::move(sweep.contacts), {rows, obstacles, 4}),
                 owned_array(std::move(sweep.approximate), {rows}));
           })
      .def("pose",
           [](const Rod& rod, double arc) {
             const Pose pose = rod.centreline().pose(arc);
             return std::make_tuple(pose.x, pose.y, pose.heading);
           })
      .def("locate",
           [](const Rod& rod, double x, double y, double radius) {
             const Outline outline = rod.outline();
             const Gap gap = rod.centreline().gap_to({x, y, radius}, outline);
             const Skin on = outline.at(gap.place, radius);
             return std::make_tuple(gap.distance, on.arc + on.ahead);
           })
      .def("_contacts",
           [](const Rod& rod) {
             nb::list rows;
             for (const ContactReport& c : rod.contacts()) {
               rows.append(nb::make_tuple(c.peg, c.arc, name(kKinds, c.kind), c.normal,
                                          c.tangential, c.couple, c.x, c.y, c.force_x, c.force_y));
             }
             return rows;
           })
      .def("axial_push", &Rod::axial_push)
      .def_prop_ro("touching", &Rod::touching)
      .def_prop_ro("base_moment", &Rod::base_moment)
      .def_prop_ro("fold_angle", &Rod::fold_angle)
      .def_prop_ro("length", &Rod::length)
      .def_prop_ro("free_curvature", &Rod::natural)
      .def_prop_ro("diameter_cm", &Rod::diameter)
      .def_prop_ro("base_compliance_cm", &Rod::base_compliance)
      .def_prop_ro("tip_rounding_cm", &Rod::rounding)
      .def_prop_ro("rest_curvature",
                   [](const Rod& rod) {
                     nb::list pieces;
                     for (const RestShape::Piece& piece : rod.rest().pieces()) {
                       pieces.append(nb::make_tuple(piece.until, piece.curvature));
                     }
                     return nb::tuple(pieces);
                   })
      .def_prop_rw(
          "critical_moment",
          [](const Rod& rod) {
            return std::isfinite(rod.critical()) ? std::optional(rod.critical()) : std::nullopt;
          },
          [](Rod& rod, std::optional<double> value) { rod.set_critical(moment_or_none(value)); },
          nb::for_setter(nb::arg("value").none()))
      .def_prop_ro("status", [](const Rod& rod) { return name(kStatuses, rod.status()); })
      .def_prop_ro("model", [](const Rod& rod) { return name(kModels, rod.model()); })
      .def_prop_ro("error_bound_cm", &Rod::error_bound)
      .def_prop_ro("counts", [](const Rod& rod) {
        nb::dict counts;
        for (int i = 0; i < 3; ++i) {
          if (rod.counts()[i] > 0) counts[kModels[i]] = rod.counts()[i];
        }
        return counts;
      });
}
