// Copyright 2026 impact_observer developers
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

// Square roots of covariances.
#pragma once

#include <algorithm>
#include <cmath>

#include "arrays.hpp"
#include "rows.hpp"

namespace kernel {

// Turns the columns of `root` from column k on by one Householder reflection, so that row k
// becomes zero right of its entry k: the same covariance root root^T. Rows above k are zero there.
inline void reflect(Matrix& root, std::size_t k) {
    const std::size_t c = root.columns - k - 1;
    double *row = root.row(k), *tail = row + k + 1;
    double size = 0.0;
    for (std::size_t j = 0; j < c; ++j) size = std::max(size, std::abs(tail[j]));
    if (size == 0.0) return;
    size = std::max(size, std::abs(row[k]));
    double squares = (row[k] / size) * (row[k] / size);
    for (std::size_t j = 0; j < c; ++j) squares += (tail[j] / size) * (tail[j] / size);
    const double end = -std::copysign(size * std::sqrt(squares), row[k]);
    const double along = (end - row[k]) / end, scale = row[k] - end;
    for (std::size_t j = 0; j < c; ++j) tail[j] /= scale;
    for (std::size_t i = k + 1; i < root.rows; ++i) {
        double* other = root.row(i) + k;
        const double seen = along * (other[0] + dot(other + 1, tail, c));
        other[0] -= seen;
        add(-seen, tail, other + 1, c);
    }
    row[k] = end;
    std::fill(tail, tail + c, 0.0);
}

// Turns `root`, d x c with c >= d, until it is lower triangular; right of the first d columns it
// becomes zero.
inline void make_triangular(Matrix& root) {
    for (std::size_t k = 0; k < root.rows; ++k) reflect(root, k);
}

}  // namespace kernel
