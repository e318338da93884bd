// Binds the compiled localizer to Python as `thigmo.localization._posterior`: arrays in, answers
// out.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "../owned_array.h"
#include "answer.h"

namespace nb = nanobind;
using namespace nb::literals;
using namespace thigmo;

namespace {

using Numbers = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Table = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

Row row(const Numbers& numbers) { return Row(numbers.data(), numbers.data() + numbers.size()); }

// A copy that Python owns.
nb::ndarray<nb::numpy, double> array(const Row& values) {
  return owned_array(values, {values.size()});
}

Matrix matrix(const Table& table) {
  Matrix out(static_cast<int>(table.shape(0)), static_cast<int>(table.shape(1)));
  std::copy(table.data(), table.data() + out.value.size(), out.value.begin());
  return out;
}

constexpr const char* kStatuses[] = {"no contact", "below detection", "ambiguous", "localized"};
std::string name_of(const Hypothesis& hypothesis) {
  return hypothesis.bad < 0 ? hypothesis.kind->name
                            : std::string(hypothesis.kind->name) + ", one bad reading";
}

// Numbers of many answers: of each row, and of each of its contacts.
constexpr std::size_t kOfRow = 28, kContacts = 3, kOfContact = 6;

// Write them in the order in which batch.py names them.
void write(const Answer& answer, double length, double* row, double* contact) {
  const std::array of_row{static_cast<double>(answer.status),
                          static_cast<double>(answer.contacts.size()),
                          static_cast<double>(answer.problem),
                          answer.shows,
                          answer.touched,
                          answer.log_odds,
                          static_cast<double>(answer.discarded),
                          answer.noise,
                          static_cast<double>(answer.end_open),
                          static_cast<double>(answer.number_open),
                          answer.kinked,
                          answer.misfit,
                          static_cast<double>(answer.freedom),
                          answer.correlation,
                          answer.log_evidence,
                          answer.number[0],
                          answer.number[1],
                          answer.number[2],
                          answer.number[3],
                          answer.mistakes[0],
                          answer.mistakes[1],
                          answer.mistakes[2],
                          answer.mistakes[3],
                          answer.mistakes[4],
                          answer.mistakes[5],
                          answer.mistakes[6],
                          answer.mistakes[7],
                          answer.mistakes[8]};
  static_assert(of_row.size() == kOfRow);
  std::copy(of_row.begin(), of_row.end(), row);
  for (const DetectedContact& detected : answer.contacts) {
    *contact++ = detected.arc * length, *contact++ = detected.force / (length * length);
    *contact++ = detected.low * length, *contact++ = detected.high * length;
    *contact++ = detected.localized, *contact++ = detected.probability;
  }
}

}  // namespace

NB_MODULE(_posterior, m) {
  nb::class_<Priors>(m, "Priors").def("__init__", [](Priors* self, nb::dict values) {
    auto* priors = new (self) Priors{};
    const auto take = [&](const char* name, auto& prior) {
      prior = nb::cast<std::decay_t<decltype(prior)>>(values[name]);
    };
    take("moments", priors->moments), take("noise_levels", priors->noise_levels);
    take("noise_factors", priors->noise_factors), take("noise_odds", priors->noise_odds);
    take("correlations", priors->correlations);
#define THIGMO_PRIOR(name) take(#name, priors->name);
    THIGMO_PRIORS(THIGMO_PRIOR)
#undef THIGMO_PRIOR
  });

  nb::class_<Answer>(m, "Answer")
      .def_prop_ro("status", [](const Answer& a) { return static_cast<int>(a.status); })
      .def_prop_ro("problem", [](const Answer& a) { return static_cast<int>(a.problem); })
      .def_ro("shows", &Answer::shows)
      .def_ro("number", &Answer::number)
      .def_ro("discarded", &Answer::discarded)
      .def_ro("end_open", &Answer::end_open)
      .def_ro("number_open", &Answer::number_open)
      .def_ro("noise", &Answer::noise)
      .def_ro("log_odds", &Answer::log_odds)
      .def_ro("log_evidence", &Answer::log_evidence)
      .def_ro("mistakes", &Answer::mistakes)
      .def_ro("kinked", &Answer::kinked)
      .def_prop_ro(
          "residual", [](const Answer& a) { return array(a.residual); }, nb::rv_policy::reference)
      .def_ro("misfit", &Answer::misfit)
      .def_ro("freedom", &Answer::freedom)
      .def_ro("correlation", &Answer::correlation)
      // The fields of `Contact`, in the caller's unit.
      .def("contacts",
           [](const Answer& a, double length) {
             nb::list out;
             for (const DetectedContact& c : a.contacts) {
               nb::list pieces;
               for (const auto& [low, high] : c.pieces) {
                 pieces.append(nb::make_tuple(low * length, high * length));
               }
               const ContactStatus lowest =
                   c.localized ? ContactStatus::localized : ContactStatus::ambiguous;
               const bool hint = a.status == ContactStatus::below_detection;
               out.append(nb::make_tuple(
                   c.arc * length, c.force / (length * length),
                   nb::make_tuple(c.low * length, c.high * length),
                   kStatuses[static_cast<int>(hint ? a.status : lowest)], nb::tuple(pieces),
                   c.deviation / (length * length), c.probability,
                   std::isnan(c.offset) ? nb::none() : nb::cast(c.offset * length),
                   std::isnan(c.vector[0])
                       ? nb::none()
                       : nb::object(nb::make_tuple(c.vector[0] / (length * length),
                                                   c.vector[1] / (length * length),
                                                   c.vector[2] / (length * length)))));
             }
             return out;
           })
      // Of each hypothesis: name, index of the bad reading or -1, log weight.
      .def_prop_ro("weighed",
                   [](const Answer& a) {
                     nb::list out;
                     for (const Hypothesis& h : a.hypotheses) {
                       out.append(nb::make_tuple(h.kind->name, h.bad, h.log_weight));
                     }
                     return out;
                   })
      .def_prop_ro("hypothesis", [](const Answer& a) { return name_of(a.hypotheses[a.best]); })
      .def_prop_ro("hypotheses",
                   [](const Answer& a) {
                     nb::dict out;  // in the order of weighing
                     for (std::size_t k = 0; k < a.hypotheses.size(); ++k) {
                       const std::string name = name_of(a.hypotheses[k]);
                       const double before =
                           out.contains(name.c_str()) ? nb::cast<double>(out[name.c_str()]) : 0.0;
                       out[name.c_str()] = before + a.probability[k];
                     }
                     return out;
                   })
      // Further numbers of the likeliest one, in the caller's unit.
      .def("parameters",
           [](const Answer& a, double length) {
             const Hypothesis& h = a.hypotheses[a.best];
             nb::dict out;
             const auto add = [&](const char* name, double value) {
               if (!std::isnan(value)) out[name] = value;
             };
             add("hinge_arc", h.kink_arc * length), add("end_offset", h.offset(a.radius) * length);
             for (const PlacedLoad& placed : h.loads) {
               if (placed.load->kinks) add("fold_angle", placed.value[0]);
             }
             const auto [push, push_spread, couple, couple_spread] = h.end_load();
             add("push_back", push / (length * length)), add("tip_moment", couple / length);
             return out;
           })
      // Force that pushes the end back and couple on it, by the likeliest explanation, each with
      // its standard deviation; NaN where nothing loads the end.
      .def_prop_ro("end_load", [](const Answer& a) { return a.hypotheses[a.best].end_load(); })
      // Of each contact: edges of cells of the body; the mass in each, the force there and its
      // standard deviation.
      .def_prop_ro("masses",
                   [](const Answer& a) {
                     nb::list out;
                     for (const DetectedContact& c : a.contacts) {
                       out.append(nb::make_tuple(array(c.edges), array(c.mass), array(c.force_at),
                                                 array(c.spread)));
                     }
                     return out;
                   })
      // Of two contacts, by the likeliest explanation: edges of cells of each, mass of each pair.
      .def_prop_ro("joint",
                   [](const Answer& a) -> nb::object {
                     const Hypothesis& h = a.hypotheses[a.best];
                     if (h.shares.contacts.size() != 2) return nb::none();
                     const auto edges = [](const Cells& cells) {
                       Row out{cells.place.front() - 0.5 * cells.width};
                       for (const double place : cells.place)
                         out.push_back(place + 0.5 * cells.width);
                       return array(out);
                     };
                     const std::size_t near = h.shares.contacts[0].place.size();
                     const std::size_t far = h.shares.contacts[1].place.size();
                     Row mass(near * far);
                     for (const DetectedSet& set : h.shares.sets) {
                       if (set.count == 2) mass[set.cell[0] * far + set.cell[1]] += set.mass;
                     }
                     return nb::make_tuple(edges(h.shares.contacts[0]), edges(h.shares.contacts[1]),
                                           owned_array(std::move(mass), {near, far}));
                   })
      .def_ro("touched", &Answer::touched)
      .def_prop_ro("bend", [](const Answer& a) { return array(a.bend); }, nb::rv_policy::reference);

  nb::class_<Options>(m, "Localizer")
      .def("__init__",
           [](Options* self, nb::kwargs values) {
             auto* options = new (self) Options{};
             const auto take = [&]<class T>(const char* name, T& option) {
               if constexpr (std::is_same_v<T, Row>) {
                 option = row(nb::cast<Numbers>(values[name]));
               } else if constexpr (std::is_same_v<T, Matrix>) {
                 option = matrix(nb::cast<Table>(values[name]));
               } else if constexpr (std::is_enum_v<T>) {
                 option = T(nb::cast<int>(values[name]));
               } else {
                 option = nb::cast<T>(values[name]);
               }
             };
#define TAKE(name) take(#name, options->name)
             TAKE(position), TAKE(span), TAKE(noise), TAKE(gain), TAKE(bad_odds), TAKE(shared);
             TAKE(offset), TAKE(map_scale), TAKE(length), TAKE(radius);
             TAKE(base_fold), TAKE(correlation), TAKE(largest_noise), TAKE(couple_odds);
             TAKE(critical), TAKE(critical_error), TAKE(folds_perhaps);
             TAKE(held_end), TAKE(end_odds), TAKE(held_odds), TAKE(contacts);
             TAKE(width_limit), TAKE(number_level);
             TAKE(axis), TAKE(curvature_map), TAKE(compliance), TAKE(weight), TAKE(priors);
#undef TAKE
             std::tie(options->within.near, options->within.far) =
                 nb::cast<std::pair<double, double>>(values["within"]);
           })
      .def_prop_ro("length", [](const Options& self) { return self.length; })
      .def_prop_ro("count", [](const Options& self) { return self.position.size(); })
      .def("localize",
           [](const Options& self, Numbers curvature, Numbers free, Numbers body) {
             const Input input{row(curvature), row(free), row(body)};
             nb::gil_scoped_release released;
             return answer(input, self);
           })
      // Rows of a table: `free` and `body` have one row of one or N numbers for
      // each row, or one for all; no numbers if they are not given. Residuals
      // only if `all` asks for them.
      .def("localize_rows", [](const Options& self, Table curvature, Table free, Table body,
                               bool all) {
        const std::size_t n = curvature.shape(1), count = curvature.shape(0);
        Input input{Row(n), {}, {}};
        Row rows(count * kOfRow), contacts(count * kContacts * kOfContact, NAN);
        Row residuals(all ? count * n : 0);
        std::vector<std::string> names(count);
        const auto pick_row = [](const Table& table, std::size_t m, Row& row) {
          const std::size_t wide = table.shape(1);
          const double* first = table.data() + (table.shape(0) == 1 ? 0 : m * wide);
          row.assign(first, first + wide);
        };
        {
          nb::gil_scoped_release released;
          for (std::size_t m = 0; m < count; ++m) {
            pick_row(curvature, m, input.curvature);
            pick_row(free, m, input.free), pick_row(body, m, input.body);
            const Answer result = answer(input, self);
            write(result, self.length, &rows[m * kOfRow], &contacts[m * kContacts * kOfContact]);
            if (result.problem != InputProblem::none) continue;
            names[m] = name_of(result.hypotheses[result.best]);
            if (all) std::copy(result.residual.begin(), result.residual.end(), &residuals[m * n]);
          }
        }
        return nb::make_tuple(owned_array(std::move(rows), {count, kOfRow}),
                              owned_array(std::move(contacts), {count, kContacts, kOfContact}),
                              names, owned_array(std::move(residuals), {all ? count : 0, n}));
      });
}
