// The parts of the module, one a file.
#pragma once

#include <pybind11/pybind11.h>

namespace kernel {

void bind_dynamics(pybind11::module_& module);

}  // namespace kernel
