// SPDX-License-Identifier: Apache-2.0

// Sums of products in twice the digits, each number a sum of two (Knuth's exact sum, and fma).
//
// Without them the slow modes beside a spring that is 1e4 times as stiff would lose digits: see
// dynamics/flow/eigenmodes.py and test/dynamics/flow/test_hard_systems.py.
#pragma once

#include <cmath>
#include <tuple>

#include "matrix.hpp"

namespace kernel {

struct Doubled {
    double high = 0.0, low = 0.0;

    // Adds x and what the sum was rounded by (Knuth).
    void add_number(double x) {
        const double total = high + x, part = total - high;
        low += (high - (total - part)) + (x - part);
        high = total;
    }

    // Adds a b and what the product was rounded by.
    void add_product(double a, double b) {
        const double product = a * b;
        low += std::fma(a, b, -product);
        add_number(product);
    }
};

struct DoubledMatrix {
    Matrix high, low;

    DoubledMatrix(std::size_t rows, std::size_t columns) : high(rows, columns), low(high) {}
    void set(std::size_t i, std::size_t j, Doubled x) { high(i, j) = x.high, low(i, j) = x.low; }
    auto fields() const { return std::tie(high, low); }
};

// A B, whatever is zero in A left out.
inline DoubledMatrix doubled_product(const MatrixView& A, const MatrixView& B) {
    DoubledMatrix product(A.rows, B.columns);
    for (std::size_t i = 0; i < A.rows; ++i) {
        std::vector<Doubled> row(B.columns);
        for (std::size_t k = 0; k < A.columns; ++k)
            for (std::size_t j = 0; j < B.columns && A(i, k) != 0; ++j)
                row[j].add_product(A(i, k), B(k, j));
        for (std::size_t j = 0; j < B.columns; ++j) product.set(i, j, row[j]);
    }
    return product;
}

// Products of each column of X with that of Y = high + low, a row.
inline DoubledMatrix doubled_dots(const MatrixView& X, const MatrixView& high,
                                  const MatrixView& low) {
    std::vector<Doubled> sums(X.columns);
    for (std::size_t i = 0; i < X.rows; ++i)
        for (std::size_t j = 0; j < X.columns; ++j) {
            sums[j].add_product(X(i, j), high(i, j));
            sums[j].low += X(i, j) * low(i, j);
        }
    DoubledMatrix dots(1, X.columns);
    for (std::size_t j = 0; j < X.columns; ++j) dots.set(0, j, sums[j]);
    return dots;
}

// Y - Z diag(factors), rounded, of what may be nearly the same; Y and Z are high + low.
inline Matrix doubled_difference(const MatrixView& Y, const MatrixView& Y_low, const MatrixView& Z,
                                 const MatrixView& Z_low, const MatrixView& factors) {
    Matrix rounded(Y.rows, Y.columns);
    for (std::size_t i = 0; i < Y.rows; ++i)
        for (std::size_t j = 0; j < Y.columns; ++j) {
            Doubled x{Y(i, j), Y_low(i, j)};
            x.add_product(Z(i, j), -factors[j]);
            rounded(i, j) = x.high + (x.low - Z_low(i, j) * factors[j]);
        }
    return rounded;
}

}  // namespace kernel
