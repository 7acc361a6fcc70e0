// SPDX-License-Identifier: Apache-2.0

// Vectors and row-major matrices, and their sums and products.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace kernel {

using Vector = std::vector<double>;

// Numbers side by side that somebody else owns.
template <class T>
struct Span {
    T* data;
    std::size_t size;

    T& operator[](std::size_t i) const { return data[i]; }
    T* begin() const { return data; }
    T* end() const { return data + size; }
    Span part(std::size_t first, std::size_t count) const { return {data + first, count}; }
    operator Vector() const { return {begin(), end()}; }
};

// Numbers that are only read.
struct ConstSpan : Span<const double> {
    ConstSpan(const double* data, std::size_t size) : Span{data, size} {}
    ConstSpan(const Span<double>& row) : Span{row.data, row.size} {}
    ConstSpan(const Span<const double>& row) : Span(row) {}
    ConstSpan(const Vector& v) : Span{v.data(), v.size()} {}
};

// Two numbers side by side, as every processor adds and multiplies them, at any address.
typedef double Two __attribute__((vector_size(16), aligned(8), may_alias));

inline Two two(const double* x) { return *reinterpret_cast<const Two*>(x); }

// y += a x.
inline void add_scaled(double a, const ConstSpan& x, double* y) {
    std::size_t i = 0;
    for (; i + 2 <= x.size; i += 2) *reinterpret_cast<Two*>(y + i) = two(y + i) + a * two(&x[i]);
    if (i < x.size) y[i] += a * x[i];
}

inline void add_scaled(double a, const ConstSpan& x, const Span<double>& y) {
    add_scaled(a, x, y.data);
}
inline void add_scaled(double a, const ConstSpan& x, Vector& y) { add_scaled(a, x, y.data()); }

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
inline double dot(const ConstSpan& x, const double* y) {
    Two one = {0, 0}, other = {0, 0};
    std::size_t i = 0;
    for (; i + 4 <= x.size; i += 4) {
        one += two(&x[i]) * two(y + i);
        other += two(&x[i + 2]) * two(y + i + 2);
    }
    double rest = 0.0;
    for (; i < x.size; ++i) rest += x[i] * y[i];
    return ((one[0] + one[1]) + (other[0] + other[1])) + rest;
}

inline double dot(const ConstSpan& x, const ConstSpan& y) { return dot(x, y.data); }
inline double length(const ConstSpan& x) { return std::sqrt(dot(x, x)); }

// A row-major matrix that somebody else owns; a vector is a matrix with one column.
template <class T>
struct MatrixViewOf {
    const T* data;
    std::size_t rows, columns;

    T operator()(std::size_t i, std::size_t j) const { return data[i * columns + j]; }
    T operator[](std::size_t i) const { return data[i]; }
    ConstSpan row(std::size_t i) const { return {data + i * columns, columns}; }
    MatrixViewOf part(std::size_t first, std::size_t count) const {  // some rows
        return {data + first * columns, count, columns};
    }
    std::size_t size() const { return rows * columns; }
    operator std::vector<T>() const { return {data, data + size()}; }
    operator ConstSpan() const { return {data, size()}; }
};
using MatrixView = MatrixViewOf<double>;

// A row-major matrix of its own.
struct Matrix {
    std::size_t rows = 0, columns = 0;
    Vector data;

    Matrix() = default;
    Matrix(std::size_t r, std::size_t c) : rows(r), columns(c), data(r * c, 0.0) {}
    Matrix(const MatrixView& v) : rows(v.rows), columns(v.columns), data(v) {}

    double& operator()(std::size_t i, std::size_t j) { return data[i * columns + j]; }
    double operator()(std::size_t i, std::size_t j) const { return data[i * columns + j]; }
    Span<double> row(std::size_t i) { return {data.data() + i * columns, columns}; }
    ConstSpan row(std::size_t i) const { return {data.data() + i * columns, columns}; }
    MatrixView part(std::size_t first, std::size_t count) const {
        return MatrixView(*this).part(first, count);
    }
    operator MatrixView() const { return {data.data(), rows, columns}; }
};

// Copies A into `to`, so that its first entry lies at (i, j).
inline void put(const MatrixView& A, Matrix& to, std::size_t i, std::size_t j) {
    for (std::size_t k = 0; k < A.rows; ++k)
        std::copy_n(A.row(k).data, A.columns, to.row(i + k).data + j);
}

// A with as many columns, cut or filled with zeros on the right.
inline Matrix resized(const MatrixView& A, std::size_t columns) {
    Matrix copy(A.rows, columns);
    for (std::size_t k = 0; k < A.rows; ++k)
        std::copy_n(A.row(k).data, std::min(columns, A.columns), copy.row(k).data);
    return copy;
}

inline Matrix transposed(const MatrixView& A) {
    Matrix transpose(A.columns, A.rows);
    for (std::size_t i = 0; i < A.rows; ++i)
        for (std::size_t j = 0; j < A.columns; ++j) transpose(j, i) = A(i, j);
    return transpose;
}

// C += A B. Terms are added in their order, and a row does not depend on the others.
inline void add_product(const MatrixView& A, const MatrixView& B, double* C) {
    const std::size_t n = B.columns, wide = 512;  // parts of B are read once, and stay in a cache
    for (std::size_t c = 0; c < n; c += wide)
        for (std::size_t k = 0; k < B.rows; k += 4)
            for (std::size_t i = 0; i < A.rows; ++i) {
                const double *a = A.row(i).data + k, *b = B.row(k).data + c;
                double* to = C + i * n + c;
                const std::size_t some = std::min(wide, n - c);
                if (k + 4 <= B.rows)
                    add_four(a, b, n, to, some);
                else
                    for (std::size_t j = 0; k + j < B.rows; ++j)
                        add_scaled(a[j], {b + j * n, some}, to);
            }
}

inline Matrix product(const MatrixView& A, const MatrixView& B) {
    Matrix AB(A.rows, B.columns);
    add_product(A, B, AB.data.data());
    return AB;
}

// row A, with as many rows of A as the row has numbers
inline Vector product(const ConstSpan& row, const MatrixView& A) {
    Vector sums(A.columns);
    add_product({row.data, 1, row.size}, A.part(0, row.size), sums.data());
    return sums;
}

}  // namespace kernel
