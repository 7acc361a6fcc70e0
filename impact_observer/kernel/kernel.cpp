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
