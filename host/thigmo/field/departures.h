// Departures of one side's readings from what the mechanics and calibration's errors predict, with
// their derivatives, and the normal equations of a fit to them. A fit asks for both a thousand
// times; fit.py, which calls them, says what the arrays mean.
#pragma once

#include <vector>

namespace thigmo::field {

// n bins of all sweeps by m sensors, and the effect of one sigma of each error. Row-major.
struct Bins {
  int bins, sensors, on_bend_count, shared_count, zeros_count, parts_count, rows;
  double model;                                // relative error of what a contact adds to a reading
  double step;                                 // between the bends of two rows of a table, 1/cm
  double last_bend;                            // up to which the tables serve
  std::vector<double> curvature;               // [bin][sensor] readings; not a number: none
  std::vector<double> deviation;               // [bin][sensor] sigma of the noise
  std::vector<double> bend;                    // [bin] of the free body
  std::vector<double> bend_bin;                // [bin] sigma of each bin's own error of the bend
  std::vector<double> standing;                // [bin] share before what stood there gave way
  std::vector<double> in_bin;                  // [bin][part] bends beside the mean one
  std::vector<int> stage;                      // [bin]
  std::vector<double> on_bend;                 // [bin][on_bend_count] of the bend
  std::vector<unsigned char> drifts;           // [on_bend_count] whether it grows with the spread
  std::vector<double> shared;                  // [bin][sensor][shared_count]
  std::vector<double> zeros;                   // [bin][sensor][zeros_count]
  std::vector<double> gain, place;             // [sensor]
  std::vector<double> against, against_error;  // [sensor]

  // Numbers of all errors: of the bend, of the gain against a bend sign, shared ones; then each
  // sensor's gain, place, zeros and, with a model's error, that of the mechanics.
  int common() const { return on_bend_count + 1 + shared_count; }
  int separate() const { return 2 + zeros_count + (model > 0.0 ? 1 : 0); }
  int count() const { return common() + separate() * sensors; }
};

struct Departures {
  std::vector<double> value, left;    // [bin][sensor] prediction; what it leaves, 0 if no reading
  std::vector<double> weight, along;  // [bin][sensor] see Noise in fit.py
  std::vector<double> common, separate;  // [bin][sensor][...] derivatives of the prediction
  std::vector<double> answer;            // [bin][sensor] its derivative by the true curvature
  std::vector<double> bend;              // [bin] of the free body as the errors have it
  std::vector<int> row;                  // [bin][part] of the tables, below each bend in the bin
  std::vector<double> part;              // [bin][part] share of the way to the next row
  double volume = 0.0;                   // logarithm of the noise's
  double squares = 0.0;                  // of `left`, whitened
};

// [bin] bends of the free body as the errors have it.
std::vector<double> bends(const Bins& bins, const double* errors, double spread);

// `mean`, `shift`: [stage][row][sensor] of the tables; `errors`: [count] in standard deviations;
// `spread` scales those of gains and maps, which drift.
Departures departures(const Bins& bins, const double* mean, const double* shift,
                      const double* errors, double spread);

// The normal equations of departures `left`: `matrix` [unknown][unknown] and `right` [unknown], for
// `common` derivatives by unknowns of all sensors and `separate` ones of each sensor by itself.
void normal_equations(int bins, int sensors, int common_count, int separate_count,
                      const double* common, const double* separate, const double* weight,
                      const double* along, const double* left, double* matrix, double* right);

}  // namespace thigmo::field
