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

}  // namespace

PYBIND11_MODULE(_kernel, module) {
    module.attr("SOURCES") = KERNEL_CHECKSUM;  // setup.py: of the files it was compiled from
    bind_estimation(module);
    module.def("triangular", &triangular, py::arg("root"),
               "A lower triangular square root, shape (d, d), of the same covariance; (d, any) is "
               "given.");
    bind_dynamics(module);
}
