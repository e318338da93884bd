// Python's view of a side's readings: the extension module thigmo.field._departures.
//
// Types are in _departures.pyi; fit.py is its only user.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "../owned_array.h"
#include "departures.h"

namespace nb = nanobind;
using namespace nb::literals;
using namespace thigmo::field;
using thigmo::owned_array;

namespace {

template <typename Value, int Dimensions>
using Input = nb::ndarray<const Value, nb::ndim<Dimensions>, nb::c_contig, nb::device::cpu>;
using Numbers = Input<double, 1>;
using Table = Input<double, 2>;
using Cube = Input<double, 3>;

template <typename Value, typename Array>
std::vector<Value> copied(const Array& array) {
  return std::vector<Value>(array.data(), array.data() + array.size());
}

void expect(bool fits) {
  if (!fits) throw nb::value_error("arrays of a side's readings differ in shape");
}

}  // namespace

NB_MODULE(_departures, m) {
  nb::set_leak_warnings(false);  // as in host/thigmo/emulator/plant.cpp
  m.doc() = "Departures of readings from a prediction, and the normal equations of a fit.";
  nb::class_<Bins>(m, "Bins")
      .def(
          "__init__",
          [](Bins* self, const Table& curvature, const Table& deviation, const Numbers& bend,
             const Numbers& bend_bin, const Numbers& standing, const Table& in_bin,
             const Input<std::int64_t, 1>& stage, const Table& on_bend,
             const Input<bool, 1>& drifts, const Cube& shared, const Cube& zeros,
             const Numbers& gain, const Numbers& place, const Numbers& against,
             const Numbers& against_error, double model, double step, int rows) {
            const std::size_t n = curvature.shape(0), sensors = curvature.shape(1);
            for (const Table* table : {&in_bin, &on_bend}) expect(table->shape(0) == n);
            for (const Numbers* numbers : {&bend, &bend_bin, &standing}) {
              expect(numbers->size() == n);
            }
            for (const Numbers* numbers : {&gain, &place, &against, &against_error}) {
              expect(numbers->size() == sensors);
            }
            for (const Cube* cube : {&shared, &zeros}) {
              expect(cube->shape(0) == n && cube->shape(1) == sensors);
            }
            expect(deviation.shape(0) == n && deviation.shape(1) == sensors);
            expect(stage.size() == n && drifts.size() == on_bend.shape(1) && rows > 1);
            new (self) Bins{static_cast<int>(n),
                            static_cast<int>(sensors),
                            static_cast<int>(on_bend.shape(1)),
                            static_cast<int>(shared.shape(2)),
                            static_cast<int>(zeros.shape(2)),
                            static_cast<int>(in_bin.shape(1)),
                            rows,
                            model,
                            step,
                            (rows - 2) * step,
                            copied<double>(curvature),
                            copied<double>(deviation),
                            copied<double>(bend),
                            copied<double>(bend_bin),
                            copied<double>(standing),
                            copied<double>(in_bin),
                            copied<int>(stage),
                            copied<double>(on_bend),
                            copied<unsigned char>(drifts),
                            copied<double>(shared),
                            copied<double>(zeros),
                            copied<double>(gain),
                            copied<double>(place),
                            copied<double>(against),
                            copied<double>(against_error)};
          },
          nb::kw_only(), "curvature"_a, "deviation"_a, "bend"_a, "bend_bin"_a, "standing"_a,
          "in_bin"_a, "stage"_a, "on_bend"_a, "drifts"_a, "shared"_a, "zeros"_a, "gain"_a,
          "place"_a, "against"_a, "against_error"_a, "model"_a, "step"_a, "rows"_a)
      .def_prop_ro("common", &Bins::common)
      .def_prop_ro("count", &Bins::count)
      .def("bends",
           [](const Bins& bins, const Numbers& errors, double spread) {
             expect(static_cast<int>(errors.size()) == bins.count());
             const std::size_t n = bins.bins;
             return owned_array(thigmo::field::bends(bins, errors.data(), spread), {n});
           })
      .def("departures", [](const Bins& bins, const Cube& mean, const Cube& shift,
                            const Numbers& errors, double spread) {
        const int stages = 1 + *std::max_element(bins.stage.begin(), bins.stage.end());
        for (const Cube* table : {&mean, &shift}) {
          expect(static_cast<int>(table->shape(0)) >= stages &&
                 static_cast<int>(table->shape(1)) == bins.rows &&
                 static_cast<int>(table->shape(2)) == bins.sensors);
        }
        expect(static_cast<int>(errors.size()) == bins.count());
        Departures d = departures(bins, mean.data(), shift.data(), errors.data(), spread);
        const std::size_t n = bins.bins, sensors = bins.sensors, parts = bins.parts_count;
        const std::size_t common = bins.common(), separate = bins.separate();
        return nb::make_tuple(owned_array(std::move(d.value), {n, sensors}),
                              owned_array(std::move(d.left), {n, sensors}),
                              owned_array(std::move(d.weight), {n, sensors}),
                              owned_array(std::move(d.along), {n, sensors}),
                              owned_array(std::move(d.common), {n, sensors, common}),
                              owned_array(std::move(d.separate), {n, sensors, separate}),
                              owned_array(std::move(d.answer), {n, sensors}),
                              owned_array(std::move(d.bend), {n}),
                              owned_array(std::move(d.row), {n, parts}),
                              owned_array(std::move(d.part), {n, parts}), d.volume, d.squares);
      });
  m.def(
      "normal_equations",
      [](const Cube& common, const Cube& separate, const Table& weight, const Table& along,
         const Table& left) {
        const std::size_t n = common.shape(0), sensors = common.shape(1);
        expect(separate.shape(0) == n && separate.shape(1) == sensors);
        for (const Table* table : {&weight, &along, &left}) {
          expect(table->shape(0) == n && table->shape(1) == sensors);
        }
        const std::size_t all = common.shape(2) + separate.shape(2) * sensors;
        std::vector<double> matrix(all * all), right(all);
        normal_equations(static_cast<int>(n), static_cast<int>(sensors),
                         static_cast<int>(common.shape(2)), static_cast<int>(separate.shape(2)),
                         common.data(), separate.data(), weight.data(), along.data(), left.data(),
                         matrix.data(), right.data());
        return nb::make_tuple(owned_array(std::move(matrix), {all, all}),
                              owned_array(std::move(right), {all}));
      },
      "common"_a, "separate"_a, "weight"_a, "along"_a, "left"_a);
}
