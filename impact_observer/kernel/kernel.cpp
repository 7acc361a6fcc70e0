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

// The module impact_observer.kernel._kernel.
#include "bindings.hpp"
#include "doubled.hpp"
#include "triangular.hpp"

using namespace kernel;

void bind_estimation(py::module_& module);

namespace {

Array triangular(const Array& root) {
    const View given = checked(root, "root", ANY, ANY);
    Matrix whole(given.rows, std::max(given.rows, given.columns));
    for (std::size_t i = 0; i < given.rows; ++i)
        std::copy(given.row(i), given.row(i) + given.columns, whole.row(i));
    make_triangular(whole);
    Matrix found(given.rows, given.rows);
    for (std::size_t i = 0; i < given.rows; ++i)
        std::copy(whole.row(i), whole.row(i) + given.rows, found.row(i));
    return to_python(found);
}

// Both parts of numbers of one shape.
struct Parts {
    Array first, second;
    View high, low;

    Parts(const py::tuple& given, const char* name, py::ssize_t rows, py::ssize_t columns)
        : first(py::cast<Array>(given[0])),
          second(py::cast<Array>(given[1])),
          high(checked(first, name, rows, columns)),
          low(checked(second, name, py::ssize_t(high.rows), py::ssize_t(high.columns))) {}
};

py::tuple to_python(const DoubledMatrix& m) {
    return py::make_tuple(to_python(m.high), to_python(m.low));
}

py::tuple product(const Array& A, const Array& B) {
    const View left = checked(A, "A", ANY, ANY), right = checked(B, "B", A.shape(1), ANY);
    return to_python(doubled_product(left, right));
}

py::tuple dots(const Array& X, const py::tuple& Y) {
    const View given = checked(X, "X", ANY, ANY);
    const Parts parts(Y, "Y", X.shape(0), X.shape(1));
    return to_python(doubled_dots(given, parts.high, parts.low));
}

Array difference(const py::tuple& Y, const py::tuple& Z, const Array& factors) {
    const Parts from(Y, "Y", ANY, ANY);
    const Parts other(Z, "Z", py::ssize_t(from.high.rows), py::ssize_t(from.high.columns));
    const View each = checked(factors, "factors", py::ssize_t(from.high.columns));
    return to_python(
        doubled_difference({Matrix(from.high), Matrix(from.low)}, other.high, other.low, each));
}

}  // namespace

PYBIND11_MODULE(_kernel, module) {
    module.attr("SOURCES") = KERNEL_CHECKSUM;  // setup.py: of the files it was compiled from
    bind_estimation(module);
    module.def("triangular", &triangular, py::arg("root"),
               "A lower triangular square root, shape (d, d), of the same covariance; (d, any) is "
               "given.");
    module.def("product", &product, py::arg("A"), py::arg("B"),
               "A B in twice the digits: rounded, and what it was rounded by.");
    module.def("dots", &dots, py::arg("X"), py::arg("Y"),
               "Products of each column of X with that of Y in twice the digits, shape (1, "
               "columns).");
    module.def("difference", &difference, py::arg("Y"), py::arg("Z"), py::arg("factors"),
               "Y - Z diag(factors) of numbers in twice the digits, rounded.");
    bind_dynamics(module);
}
