#include "departures.h"

#include <algorithm>
#include <cmath>

namespace thigmo::field {

std::vector<double> bends(const Bins& bins, const double* errors, double spread) {
  std::vector<double> bends = bins.bend;
  for (int i = 0; i < bins.bins; ++i) {
    for (int j = 0; j < bins.on_bend_count; ++j) {
      const double scale = bins.drifts[j] ? spread : 1.0;
      bends[i] += bins.on_bend[i * bins.on_bend_count + j] * scale * errors[j];
    }
    bends[i] = std::clamp(bends[i], 0.0, bins.last_bend);
  }
  return bends;
}

Departures departures(const Bins& bins, const double* mean, const double* shift,
                      const double* errors, double spread) {
  const int n = bins.bins, m = bins.sensors, parts = bins.parts_count;
  const int on_bend = bins.on_bend_count, shared = bins.shared_count, zeros = bins.zeros_count;
  const int common = bins.common(), separate = bins.separate();
  const double* by_against = errors + on_bend;
  const double* by_shared = by_against + 1;
  const double* by_gain = errors + common;
  const double* by_place = by_gain + m;
  const double* by_zero = by_place + m;
  const double* by_model = by_zero + zeros * m;
  const auto cells = static_cast<std::size_t>(n) * m;
  Departures d;
  for (auto* values : {&d.value, &d.left, &d.weight, &d.along, &d.answer}) values->resize(cells);
  d.common.resize(cells * common);
  d.separate.resize(cells * separate);
  d.bend = bends(bins, errors, spread);
  d.row.resize(static_cast<std::size_t>(n) * parts);
  d.part.resize(static_cast<std::size_t>(n) * parts);
  std::vector<double> bend_by(on_bend);
  for (int i = 0; i < n; ++i) {
    const double bend = d.bend[i];
    for (int j = 0; j < on_bend; ++j) {
      bend_by[j] = bins.on_bend[i * on_bend + j] * (bins.drifts[j] ? spread : 1.0);
    }
    // A touch is a kink, so the mean of a bin's readings is not the reading at its mean bend.
    for (int p = 0; p < parts; ++p) {
      const double inside = std::clamp(bend + bins.in_bin[i * parts + p], 0.0, bins.last_bend);
      const double whole = std::floor(inside / bins.step);
      d.row[i * parts + p] = std::min(static_cast<int>(whole), bins.rows - 2);
      d.part[i * parts + p] = inside / bins.step - whole;
    }
    double squared = 0.0, squares = 0.0, shared_left = 0.0;
    for (int q = 0; q < m; ++q) {
      double touched = 0.0, rise = 0.0, moved = 0.0;
      for (int p = 0; p < parts; ++p) {
        const std::size_t low =
            (static_cast<std::size_t>(bins.stage[i]) * bins.rows + d.row[i * parts + p]) * m + q;
        const std::size_t high = low + m;
        const double u = d.part[i * parts + p];
        touched += mean[low] * (1.0 - u) + mean[high] * u;
        rise += mean[high] - mean[low];
        moved += shift[low] * (1.0 - u) + shift[high] * u;
      }
      const double stood = bins.standing[i];
      touched = stood * touched / parts + (1.0 - stood) * bend;
      rise = stood * rise / parts / bins.step + (1.0 - stood);
      moved = stood * moved / parts;
      const double true_curvature = touched + moved * bins.place[q] * by_place[q];
      // A flex sensor answers less to a bend against its `bend_sign`.
      const bool back = true_curvature < 0.0;
      const double gain = 1.0 + spread * bins.gain[q] * by_gain[q];
      const double answer = back ? bins.against[q] + bins.against_error[q] * *by_against : 1.0;
      const double slope = gain * answer * rise;
      const std::size_t cell = static_cast<std::size_t>(i) * m + q;
      double* common_at = &d.common[cell * common];
      for (int j = 0; j < on_bend; ++j) common_at[j] = slope * bend_by[j];
      common_at[on_bend] = back ? bins.against_error[q] * gain * true_curvature : 0.0;
      double* separate_at = &d.separate[cell * separate];
      separate_at[0] = spread * bins.gain[q] * answer * true_curvature;
      separate_at[1] = bins.place[q] * gain * answer * moved;
      double value = gain * answer * true_curvature;
      for (int j = 0; j < shared; ++j) {
        common_at[on_bend + 1 + j] = bins.shared[cell * shared + j];
        value += bins.shared[cell * shared + j] * by_shared[j];
      }
      for (int j = 0; j < zeros; ++j) {
        separate_at[2 + j] = bins.zeros[cell * zeros + j];
        value += bins.zeros[cell * zeros + j] * by_zero[j * m + q];
      }
      if (bins.model > 0.0) {
        separate_at[2 + zeros] = bins.model * (true_curvature - bend);
        value += separate_at[2 + zeros] * by_model[q];
      }
      const double added = bins.model * (value - bend) / bins.deviation[cell];
      const double weight = 1.0 / (bins.deviation[cell] * std::sqrt(1.0 + added * added));
      const double along = weight * slope * bins.bend_bin[i];
      const double reading = bins.curvature[cell];
      const double left = std::isnan(reading) ? 0.0 : reading - value;
      d.volume += std::log1p(added * added);
      squared += along * along;
      squares += weight * left * weight * left;
      shared_left += along * weight * left;
      d.value[cell] = value;
      d.left[cell] = left;
      d.weight[cell] = weight;
      d.along[cell] = along;
      d.answer[cell] = gain * answer;
    }
    d.volume += std::log1p(squared);
    d.squares += squares - shared_left * shared_left / (1.0 + squared);
  }
  return d;
}

// A bin's precision is diag(weight^2) - u u', so what belongs to one sensor meets other sensors in
// the rank-one part alone. Most errors are another sweep's, and leave a bin's readings as they are.
void normal_equations(int bins, int sensors, int common_count, int separate_count,
                      const double* common, const double* separate, const double* weight,
                      const double* along, const double* left, double* matrix, double* right) {
  const int all = common_count + separate_count * sensors;
  std::fill(matrix, matrix + static_cast<std::size_t>(all) * all, 0.0);
  std::fill(right, right + all, 0.0);
  std::vector<double> outwards(all), scaled(common_count);
  std::vector<int> moving;  // columns that are not 0, ascending
  for (int i = 0; i < bins; ++i) {
    double squared = 0.0;
    for (int q = 0; q < sensors; ++q) squared += along[i * sensors + q] * along[i * sensors + q];
    std::fill(outwards.begin(), outwards.end(), 0.0);
    double outwards_left = 0.0;
    for (int q = 0; q < sensors; ++q) {
      const std::size_t cell = static_cast<std::size_t>(i) * sensors + q;
      const double* common_at = common + cell * common_count;
      const double* separate_at = separate + cell * separate_count;
      const double precision = weight[cell] * weight[cell];
      const double u = weight[cell] * along[cell] / std::sqrt(1.0 + squared);
      outwards_left += u * left[cell];
      moving.clear();
      for (int r = 0; r < common_count; ++r) {
        if (common_at[r] == 0.0) continue;
        moving.push_back(r);
        scaled[r] = precision * common_at[r];
        outwards[r] += u * common_at[r];
        right[r] += scaled[r] * left[cell];
        double* row = matrix + static_cast<std::size_t>(r) * all;
        for (const int c : moving) row[c] += scaled[r] * common_at[c];
      }
      for (int k = 0; k < separate_count; ++k) {
        const int r = common_count + k * sensors + q;
        if (separate_at[k] == 0.0) continue;  // another sweep's
        outwards[r] = u * separate_at[k];
        right[r] += precision * separate_at[k] * left[cell];
        double* row = matrix + static_cast<std::size_t>(r) * all;
        for (const int c : moving) row[c] += separate_at[k] * scaled[c];
        for (int l = 0; l <= k; ++l) {
          row[common_count + l * sensors + q] += precision * separate_at[k] * separate_at[l];
        }
      }
    }
    moving.clear();
    for (int r = 0; r < all; ++r) {
      if (outwards[r] == 0.0) continue;
      moving.push_back(r);
      right[r] -= outwards[r] * outwards_left;
      double* row = matrix + static_cast<std::size_t>(r) * all;
      for (const int c : moving) row[c] -= outwards[r] * outwards[c];
    }
  }
  for (int r = 0; r < all; ++r) {
    for (int c = 0; c < r; ++c) {
      matrix[static_cast<std::size_t>(c) * all + r] = matrix[static_cast<std::size_t>(r) * all + c];
    }
  }
}

}  // namespace thigmo::field
