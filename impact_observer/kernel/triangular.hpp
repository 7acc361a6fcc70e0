// Square roots of covariances.
#pragma once

#include <algorithm>
#include <cmath>

#include "arrays.hpp"

namespace kernel {

// Turns the rows of `root`, d x c with c >= d, by Householder reflections from the right until it
// is lower triangular: the same covariance root root^T. What is right of the first d columns
// becomes zero.
inline void make_triangular(Matrix& root) {
    const std::size_t d = root.rows, c = root.columns;
    for (std::size_t k = 0; k < d; ++k) {
        double* row = root.row(k);
        double size = 0.0;
        for (std::size_t j = k + 1; j < c; ++j) size = std::max(size, std::abs(row[j]));
        if (size == 0.0) continue;
        size = std::max(size, std::abs(row[k]));
        double squares = 0.0;
        for (std::size_t j = k; j < c; ++j) squares += (row[j] / size) * (row[j] / size);
        const double end = -std::copysign(size * std::sqrt(squares), row[k]);
        const double along = (end - row[k]) / end, scale = row[k] - end;
        for (std::size_t j = k + 1; j < c; ++j) row[j] /= scale;
        for (std::size_t i = k + 1; i < d; ++i) {
            double* other = root.row(i);
            double seen = other[k];
            for (std::size_t j = k + 1; j < c; ++j) seen += other[j] * row[j];
            seen *= along;
            other[k] -= seen;
            for (std::size_t j = k + 1; j < c; ++j) other[j] -= seen * row[j];
        }
        row[k] = end;
        std::fill(row + k + 1, row + c, 0.0);
    }
}

}  // namespace kernel
