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
#include "arrays.hpp"
#include "doubled.hpp"

using namespace kernel;

void bind_dynamics(py::module_& module);
void bind_estimation(py::module_& module);

namespace {

using Two = std::pair<Array, Array>;  // both parts of numbers

DoubledMatrix checked_product(const Array& A, const Array& B) {
    const View left = checked(A, "A", ANY, ANY);
    return doubled_product(left, checked(B, "B", left.columns, ANY));
}

DoubledMatrix checked_dots(const Array& X, const Two& Y) {
    const View x = checked(X, "X", ANY, ANY);
    return doubled_dots(x, checked(Y.first, "Y", x.rows, x.columns),
                        checked(Y.second, "Y", x.rows, x.columns));
}

Matrix checked_difference(const Two& Y, const Two& Z, const Array& factors) {
    const View y = checked(Y.first, "Y", ANY, ANY);
    const auto same = [&](const Array& a, const char* name) {
        return checked(a, name, y.rows, y.columns);
    };
    return doubled_difference(y, same(Y.second, "Y"), same(Z.first, "Z"), same(Z.second, "Z"),
                              checked(factors, "factors", y.columns));
}

}  // namespace

PYBIND11_MODULE(_kernel, module) {
    module.attr("SOURCES") = KERNEL_CHECKSUM;  // setup.py: of the files it was compiled from
    module.def("product", &checked_product, "A"_a, "B"_a);
    module.def("dots", &checked_dots, "X"_a, "Y"_a);
    module.def("difference", &checked_difference, "Y"_a, "Z"_a, "factors"_a);
    bind_estimation(module);
    bind_dynamics(module);
}
