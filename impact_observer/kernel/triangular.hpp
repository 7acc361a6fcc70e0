// SPDX-License-Identifier: Apache-2.0

// Triangular square roots of covariances, by Householder reflections.
#pragma once

#include <algorithm>
#include <cmath>

#include "matrix.hpp"

namespace kernel {

// Turns the columns of `root` from column k on by one Householder reflection, so that row k
// becomes zero right of its entry k: the same covariance root root^T. Rows above k are zero there.
inline void reflect(Matrix& root, std::size_t k) {
    const std::size_t c = root.columns - k - 1;
    double& diagonal = root(k, k);
    const Span<double> tail = root.row(k).part(k + 1, c);
    double size = 0.0;
    for (const double each : tail) size = std::max(size, std::abs(each));
    if (size == 0.0) return;
    size = std::max(size, std::abs(diagonal));
    double squares = (diagonal / size) * (diagonal / size);
    for (const double each : tail) squares += (each / size) * (each / size);
    const double end = -std::copysign(size * std::sqrt(squares), diagonal);
    const double along = (end - diagonal) / end, scale = diagonal - end;
    for (double& each : tail) each /= scale;
    for (std::size_t i = k + 1; i < root.rows; ++i) {
        double* other = &root(i, k);
        const double seen = along * (other[0] + dot(tail, other + 1));
        other[0] -= seen;
        add_scaled(-seen, tail, other + 1);
    }
    diagonal = end;
    std::fill(tail.begin(), tail.end(), 0.0);
}

// Turns `root`, d x c with c >= d, until it is lower triangular; right of the first d columns it
// becomes zero.
inline void make_triangular(Matrix& root) {
    for (std::size_t k = 0; k < root.rows; ++k) reflect(root, k);
}

// Returns the lower triangular root, d x d, of the same covariance.
inline Matrix squared(Matrix root) {
    if (root.columns < root.rows) root = resized(root, root.rows);
    make_triangular(root);
    return resized(root, root.rows);
}

}  // namespace kernel
