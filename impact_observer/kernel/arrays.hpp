// SPDX-License-Identifier: Apache-2.0

// Conversion of numpy arrays to checked views, and of vectors and matrices to numpy arrays.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cmath>
#include <string>

#include "matrix.hpp"

namespace kernel {

namespace py = pybind11;
using namespace py::literals;

// What Python hands over: any order, type and alignment, copied only where these are others.
template <class T>
using ArrayOf = py::array_t<T, py::array::c_style | py::array::forcecast |
                                   py::detail::npy_api::NPY_ARRAY_ALIGNED_>;
using Array = ArrayOf<double>;

// For functions that need nothing of Python once their arguments are converted. Not for those with
// tuples of arrays among them, which pybind11 copies for the call.
using Released = py::call_guard<py::gil_scoped_release>;

constexpr std::size_t ANY = std::size_t(-1);   // size along a dimension
constexpr std::size_t NONE = std::size_t(-2);  // no such dimension

inline void expect(bool is_right, const char* otherwise) {
    if (!is_right) throw py::value_error(otherwise);
}

inline double finite(double value, const char* name) {
    if (!std::isfinite(value)) throw py::value_error(std::string(name) + ": not finite");
    return value;
}

template <class T>
std::string shape_text(const T* sizes, std::size_t dimensions) {
    std::string text;
    for (std::size_t k = 0; k < dimensions; ++k)
        text += (k ? ", " : "") + (sizes[k] == T(ANY) ? "any" : std::to_string(sizes[k]));
    return "(" + text + (dimensions == 1 ? ",)" : ")");
}

// The array as a view; a ValueError names it where its shape is another one or it has a NaN.
template <class T>
MatrixViewOf<T> checked(const ArrayOf<T>& a, const char* name, std::size_t rows,
                        std::size_t columns = NONE) {
    const std::size_t wanted[] = {rows, columns}, dimensions = columns == NONE ? 1 : 2;
    bool fits = std::size_t(a.ndim()) == dimensions;
    for (std::size_t k = 0; k < dimensions && fits; ++k)
        fits = wanted[k] == ANY || std::size_t(a.shape(py::ssize_t(k))) == wanted[k];
    if (!fits)
        throw py::value_error(name + (": shape " + shape_text(a.shape(), std::size_t(a.ndim()))) +
                              "; expected " + shape_text(wanted, dimensions));
    const MatrixViewOf<T> view{a.data(), std::size_t(a.shape(0)),
                               dimensions == 1 ? 1 : std::size_t(a.shape(1))};
    for (std::size_t k = 0; k < view.size(); ++k) finite(double(view[k]), name);
    return view;
}

}  // namespace kernel

namespace pybind11::detail {

template <>
struct type_caster<kernel::Matrix> {
    static constexpr auto name = const_name("numpy.ndarray");
    static handle cast(const kernel::Matrix& m, return_value_policy, handle) {
        kernel::Array array({m.rows, m.columns});
        std::copy(m.data.begin(), m.data.end(), array.mutable_data());
        return array.release();
    }
};

template <>
struct type_caster<kernel::Vector> {
    static constexpr auto name = const_name("numpy.ndarray");
    static handle cast(const kernel::Vector& v, return_value_policy, handle) {
        kernel::Array array(ssize_t(v.size()));
        std::copy(v.begin(), v.end(), array.mutable_data());
        return array.release();
    }
};

// Converts a struct with the method `fields` to a tuple.
template <class T>
struct type_caster<T, std::void_t<decltype(std::declval<const T&>().fields())>> {
    static constexpr auto name = const_name("tuple");
    static handle cast(const T& record, return_value_policy, handle) {
        const auto all = [](const auto&... each) { return pybind11::make_tuple(each...); };
        return std::apply(all, record.fields()).release();
    }
};

}  // namespace pybind11::detail
