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

// Arrays that come from Python, checked, and plain views of them.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>
#include <vector>

#include "rows.hpp"

namespace kernel {

namespace py = pybind11;

// What Python hands over: any order, type and alignment, copied only where these are others.
template <class T>
using ArrayOf = py::array_t<T, py::array::c_style | py::array::forcecast |
                                   py::detail::npy_api::NPY_ARRAY_ALIGNED_>;
using Array = ArrayOf<double>;

// A row-major matrix that somebody else owns; a vector is a matrix with one column.
struct View {
    const double* data;
    std::size_t rows, columns;

    double operator()(std::size_t i, std::size_t j) const { return data[i * columns + j]; }
    double operator[](std::size_t i) const { return data[i]; }
    const double* row(std::size_t i) const { return data + i * columns; }
    std::size_t size() const { return rows * columns; }
};

// A row-major matrix of its own.
struct Matrix {
    std::size_t rows = 0, columns = 0;
    std::vector<double> data;

    Matrix() = default;
    Matrix(std::size_t r, std::size_t c) : rows(r), columns(c), data(r * c, 0.0) {}
    explicit Matrix(const View& v)
        : rows(v.rows), columns(v.columns), data(v.data, v.data + v.size()) {}

    double& operator()(std::size_t i, std::size_t j) { return data[i * columns + j]; }
    double operator()(std::size_t i, std::size_t j) const { return data[i * columns + j]; }
    double* row(std::size_t i) { return data.data() + i * columns; }
    const double* row(std::size_t i) const { return data.data() + i * columns; }
    View view() const { return {data.data(), rows, columns}; }
};

// found += A B. Terms are added in their order, and a row does not depend on the others.
inline void add_matrix_product(const double* A, std::size_t rows, const Matrix& B, double* found) {
    const std::size_t n = B.columns, wide = 512;  // parts of B are read once, and stay in a cache
    for (std::size_t c = 0; c < n; c += wide)
        for (std::size_t k = 0; k < B.rows; k += 4)
            for (std::size_t i = 0; i < rows; ++i) {
                const double *a = A + i * B.rows + k, *b = B.row(k) + c;
                double* to = found + i * n + c;
                const std::size_t some = std::min(wide, n - c);
                if (k + 4 <= B.rows)
                    add_four(a, b, n, to, some);
                else
                    for (std::size_t j = 0; k + j < B.rows; ++j) add(a[j], b + j * n, to, some);
            }
}

inline std::string shape_of(const py::array& a) {
    std::string text = "(";
    for (py::ssize_t k = 0; k < a.ndim(); ++k)
        text += (k ? ", " : "") + std::to_string(a.shape(k));
    return text + (a.ndim() == 1 ? ",)" : ")");
}

// Any size along a dimension.
constexpr py::ssize_t ANY = -1;

// The array as a view; a ValueError names it where its shape is another one or it has a NaN.
inline View checked(const Array& a, const char* name, py::ssize_t rows, py::ssize_t columns) {
    const bool fits = a.ndim() == 2 && (rows == ANY || a.shape(0) == rows) &&
                      (columns == ANY || a.shape(1) == columns);
    if (!fits) {
        const auto text = [](py::ssize_t n) {
            return n == ANY ? std::string("any") : std::to_string(n);
        };
        throw py::value_error(std::string(name) + ": shape " + shape_of(a) + "; expected (" +
                              text(rows) + ", " + text(columns) + ")");
    }
    const View view{a.data(), std::size_t(a.shape(0)), std::size_t(a.shape(1))};
    for (std::size_t k = 0; k < view.size(); ++k)
        if (!std::isfinite(view[k])) throw py::value_error(std::string(name) + ": not finite");
    return view;
}

inline View checked(const Array& a, const char* name, py::ssize_t size) {
    if (a.ndim() != 1 || (size != ANY && a.shape(0) != size))
        throw py::value_error(std::string(name) + ": shape " + shape_of(a) + "; expected (" +
                              (size == ANY ? std::string("any") : std::to_string(size)) + ",)");
    const View view{a.data(), std::size_t(a.shape(0)), 1};
    for (std::size_t k = 0; k < view.size(); ++k)
        if (!std::isfinite(view[k])) throw py::value_error(std::string(name) + ": not finite");
    return view;
}

inline Array to_python(const Matrix& m) {
    Array found({m.rows, m.columns});
    std::copy(m.data.begin(), m.data.end(), found.mutable_data());
    return found;
}

inline Array to_python(const std::vector<double>& values) {
    return Array(py::ssize_t(values.size()), values.data());
}

}  // namespace kernel
