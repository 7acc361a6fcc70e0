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

// Sums and multiples of rows of numbers.
#pragma once

#include <cstddef>

namespace kernel {

// Two numbers side by side, as every processor adds and multiplies them, at any address.
typedef double Two __attribute__((vector_size(16), aligned(8), may_alias));

inline Two two(const double* x) { return *reinterpret_cast<const Two*>(x); }

// y += a x.
inline void add(double a, const double* x, double* y, std::size_t n) {
    std::size_t i = 0;
    for (; i + 2 <= n; i += 2) *reinterpret_cast<Two*>(y + i) = two(y + i) + a * two(x + i);
    if (i < n) y[i] += a * x[i];
}

// y += a_0 x_0 + a_1 x_1 + a_2 x_2 + a_3 x_3, added one after the other; each row x is `apart`
// from the one before it.
inline void add_four(const double* a, const double* x, std::size_t apart, double* y,
                     std::size_t n) {
    const double *x1 = x + apart, *x2 = x1 + apart, *x3 = x2 + apart;
    std::size_t i = 0;
    for (; i + 2 <= n; i += 2)
        *reinterpret_cast<Two*>(y + i) = two(y + i) + a[0] * two(x + i) + a[1] * two(x1 + i) +
                                         a[2] * two(x2 + i) + a[3] * two(x3 + i);
    if (i < n) y[i] = y[i] + a[0] * x[i] + a[1] * x1[i] + a[2] * x2[i] + a[3] * x3[i];
}

// The sum of x_i y_i, four partial sums at once.
inline double dot(const double* x, const double* y, std::size_t n) {
    Two one = {0, 0}, other = {0, 0};
    std::size_t i = 0;
    for (; i + 4 <= n; i += 4) {
        one += two(x + i) * two(y + i);
        other += two(x + i + 2) * two(y + i + 2);
    }
    double rest = 0.0;
    for (; i < n; ++i) rest += x[i] * y[i];
    return ((one[0] + one[1]) + (other[0] + other[1])) + rest;
}

}  // namespace kernel
