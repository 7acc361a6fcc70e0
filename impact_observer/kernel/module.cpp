// SPDX-License-Identifier: Apache-2.0

// The module impact_observer.kernel._kernel: the filter, and products in doubled precision.
#include "arrays.hpp"
#include "doubled.hpp"

using namespace kernel;

namespace {

using Parts = std::pair<Array, Array>;  // both parts of numbers, see doubled.hpp

DoubledMatrix checked_product(const Array& A, const Array& B) {
    const MatrixView left = checked(A, "A", ANY, ANY);
    return doubled_product(left, checked(B, "B", left.columns, ANY));
}

DoubledMatrix checked_dots(const Array& X, const Parts& Y) {
    const MatrixView x = checked(X, "X", ANY, ANY);
    return doubled_dots(x, checked(Y.first, "Y", x.rows, x.columns),
                        checked(Y.second, "Y", x.rows, x.columns));
}

Matrix checked_difference(const Parts& Y, const Parts& Z, const Array& factors) {
    const MatrixView y = checked(Y.first, "Y", ANY, ANY);
    const auto same = [&](const Array& a, const char* name) {
        return checked(a, name, y.rows, y.columns);
    };
    return doubled_difference(y, same(Y.second, "Y"), same(Z.first, "Z"), same(Z.second, "Z"),
                              checked(factors, "factors", y.columns));
}

}  // namespace

void bind_filter(py::module_& module);

PYBIND11_MODULE(_kernel, module) {
    module.attr("SOURCES") = KERNEL_CHECKSUM;  // setup.py: of the files it was compiled from
    bind_filter(module);
    module.def("product", &checked_product, "A"_a, "B"_a);
    module.def("dots", &checked_dots, "X"_a, "Y"_a);
    module.def("difference", &checked_difference, "Y"_a, "Z"_a, "factors"_a);
}
