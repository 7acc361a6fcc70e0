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

// Numbers as sums of two, which have twice the digits, and sums of products in them.
#pragma once

#include "arrays.hpp"
#include "rows.hpp"

namespace kernel {

typedef double TwoAligned __attribute__((vector_size(16)));

// high + low; T is a number, or two side by side.
template <class T>
struct Doubled {
    T high, low;

    // Adds x and what the sum was rounded by (Knuth).
    void add(T x) {
        const T total = high + x, part = total - high;
        low += (high - (total - part)) + (x - part);
        high = total;
    }

    // Adds a b and what the product was rounded by (Dekker, Numer. Math. 18, 1971).
    void add_product(T a, T b) {
        const T product = a * b, a1 = upper(a), b1 = upper(b), a2 = a - a1, b2 = b - b1;
        low += ((a1 * b1 - product) + a1 * b2 + a2 * b1) + a2 * b2;
        add(product);
    }

    // Half of the bits.
    static T upper(T x) {
        const T scaled = x * 134217729.0;  // 2^27 + 1
        return scaled - (scaled - x);
    }
};

struct DoubledMatrix {
    Matrix high, low;

    DoubledMatrix(std::size_t rows, std::size_t columns) : high(rows, columns), low(high) {}
    DoubledMatrix(Matrix high, Matrix low) : high(std::move(high)), low(std::move(low)) {}

    // Changes row i by `change(j, sum)`: two columns at once, j the first one, and the last alone.
    template <class Change>
    void change_row(std::size_t i, Change change) {
        double *h = high.row(i), *l = low.row(i);
        std::size_t j = 0;
        for (; j + 2 <= high.columns; j += 2) {
            Doubled<TwoAligned> sum{two(h + j), two(l + j)};
            change(j, sum);
            *reinterpret_cast<Two*>(h + j) = sum.high;
            *reinterpret_cast<Two*>(l + j) = sum.low;
        }
        if (j == high.columns) return;
        Doubled<double> sum{h[j], l[j]};
        change(j, sum);
        h[j] = sum.high, l[j] = sum.low;
    }
};

// The numbers from x on that go with a sum: one, or two side by side.
inline double as_in(const Doubled<double>&, const double* x) { return *x; }
inline Two as_in(const Doubled<TwoAligned>&, const double* x) { return two(x); }

// A B, whatever is zero in A left out.
inline DoubledMatrix doubled_product(const View& A, const View& B) {
    DoubledMatrix found(A.rows, B.columns);
    for (std::size_t i = 0; i < A.rows; ++i)
        for (std::size_t k = 0; k < A.columns; ++k) {
            if (A(i, k) == 0) continue;
            found.change_row(i, [&](std::size_t j, auto& sum) {
                const auto b = as_in(sum, B.row(k) + j);
                sum.add_product(0 * b + A(i, k), b);
            });
        }
    return found;
}

// Products of each column of X with that of Y = high + low, a row.
inline DoubledMatrix doubled_dots(const View& X, const View& high, const View& low) {
    DoubledMatrix found(1, X.columns);
    for (std::size_t i = 0; i < X.rows; ++i)
        found.change_row(0, [&](std::size_t j, auto& sum) {
            const auto x = as_in(sum, X.row(i) + j);
            sum.add_product(x, as_in(sum, high.row(i) + j));
            sum.low += x * as_in(sum, low.row(i) + j);
        });
    return found;
}

// Y - Z diag(factors), rounded, of what may be nearly the same.
inline Matrix doubled_difference(DoubledMatrix Y, const View& high, const View& low,
                                 const View& factors) {
    for (std::size_t i = 0; i < Y.high.rows; ++i) {
        Y.change_row(i, [&](std::size_t j, auto& sum) {
            const auto factor = as_in(sum, factors.data + j);
            sum.add_product(as_in(sum, high.row(i) + j), -factor);
            sum.low -= as_in(sum, low.row(i) + j) * factor;
        });
        add(1.0, Y.low.row(i), Y.high.row(i), factors.rows);
    }
    return std::move(Y.high);
}

}  // namespace kernel
