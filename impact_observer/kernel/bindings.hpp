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

// The parts of the module, one a file, and what they read alike.
#pragma once

#include "arrays.hpp"
#include "phase.hpp"

namespace kernel {

struct Arena;

void bind_dynamics(py::module_& module);
void bind_replicas(py::class_<Arena, std::shared_ptr<Arena>>& arena);

inline double finite(double value, const char* name) {
    if (!std::isfinite(value)) throw py::value_error(std::string(name) + ": not finite");
    return value;
}

// A float, or one with what it is rounded by.
inline Time time_of(const py::object& t) {
    Time found{py::cast<double>(t)};
    if (py::hasattr(t, "remainder")) {
        found.exact = true;
        found.ns = py::cast<std::int64_t>(t.attr("ns"));
        found.remainder = py::cast<double>(t.attr("remainder"));
    }
    finite(found.seconds, "t"), finite(found.remainder, "t");
    return found;
}

}  // namespace kernel
