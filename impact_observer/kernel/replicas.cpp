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

// Estimates from one impact to the next, by the modal flow of a plant without contact.
#include "bindings.hpp"
#include "flights.hpp"
#include "free_motion.hpp"
#include "guards.hpp"

using namespace kernel;

namespace {

constexpr double SMALL = 1e-6;    // scale of the differences by which a jump is linearised
constexpr double FADED = 1e-100;  // differences that count as zero: denormal numbers are slow

// A flight of an estimate, and the contact that ends it.
class Flown {
  public:
    const ModalFlow* flow;
    std::size_t size;
    std::shared_ptr<const Motion> motion;
    std::vector<double> x;  // s seconds later

    Flown(const Arena& arena, const py::object& t, double s, const Array& given)
        : flow(dynamic_cast<const ModalFlow*>(arena.gaps->flow.get())),
          size(2 * arena.M.rows),
          x(size) {
        if (!flow || !flow->coordinates.all_move())
            throw py::value_error("arena: expected the modal flow of a system without contact");
        motion = flow->start(time_of(t), checked(given, "x", py::ssize_t(size)).data);
        if (!(finite(s, "s") >= 0)) throw py::value_error("s: negative");
        motion->states(&s, 1, x.data());
    }
};

const Contact& known(const Arena& arena, std::size_t contact) {
    if (contact >= arena.contacts.size() || arena.contacts[contact].kick.empty())
        throw py::value_error("contact: not known");
    return arena.contacts[contact];
}

py::object flown(const Arena& arena, const py::object& t, double s, double late, const Array& x,
                 const Array& root, const Array& differences) {
    const Flown flight(arena, t, s, x);
    const std::size_t size = flight.size;
    const View own = checked(root, "root", ANY, ANY);
    const View others = checked(differences, "differences", py::ssize_t(own.rows), ANY);
    if (own.rows < size) throw py::value_error("root: expected rows of all states");
    if (!(finite(late, "late") >= 0)) throw py::value_error("late: negative");
    if (s > late && arena.gaps->w > 0) {
        Hunt hunt(arena.gaps->along(flight.motion), arena.window);
        const std::optional<Crossing>& crossing = hunt.first(s - late);
        if (crossing && crossing->s <= s - late) return py::none();
    }
    Matrix after(own), apart(others);
    const Matrix moved = flight.flow->carried(s, {own.data, size, own.columns});
    std::copy(moved.data.begin(), moved.data.end(), after.data.begin());
    const Matrix changed = flight.flow->carried(s, {others.data, size, others.columns});
    std::copy(changed.data.begin(), changed.data.end(), apart.data.begin());
    return py::make_tuple(to_python(flight.x), to_python(after), to_python(apart));
}

py::tuple rebounded(const Arena& arena, std::size_t contact, const py::object& t, double s,
                    const Array& x, const Array& differences) {
    const Contact& stop = known(arena, contact);
    Flown flight(arena, t, s, x);
    const View given = checked(differences, "differences", py::ssize_t(flight.size), ANY);
    Matrix columns = flight.flow->carried(s, given);
    const std::vector<double> before = flight.x;
    stop.strike(flight.x.data(), columns, 1.0);
    double largest = 0.0;
    for (const double each : columns.data) largest = std::max(largest, std::abs(each));
    if (largest < FADED) std::fill(columns.data.begin(), columns.data.end(), 0.0);
    return py::make_tuple(to_python(before), to_python(flight.x), to_python(columns));
}

py::tuple fallback(const Arena& arena, const kalman::FreeMotion& noise, std::size_t contact,
                   const py::object& t, double s, const Array& x, const Array& errors,
                   const Array& lag) {
    const Contact& stop = known(arena, contact);
    Flown flight(arena, t, s, x);
    const std::size_t size = flight.size, n = size / 2;
    const View late = checked(lag, "lag", py::ssize_t(n));
    const View given = checked(errors, "errors", py::ssize_t(size), py::ssize_t(size + 1));
    Matrix moved = flight.flow->carried(s, given), unit(size, 2 * size);
    if (noise.size() != size || !(s * noise.rate < 1e15))
        throw py::value_error("noise, s: expected that of the arena, and not too long");
    const Matrix added = noise.diffusion(s);
    for (std::size_t i = 0; i < size; ++i)
        std::copy(added.row(i), added.row(i) + size,
                  std::copy(moved.row(i), moved.row(i) + size, unit.row(i)));
    make_triangular(unit);
    std::vector<double> seen(size);
    for (std::size_t i = 0; i < size; ++i) {
        std::copy(unit.row(i), unit.row(i) + size, moved.row(i));
        if (i < n) add(stop.W[i], unit.row(i), seen.data(), size);
    }
    const double gap = stop.gap(flight.x.data());
    stop.strike(flight.x.data(), moved, SMALL);
    const double speed = stop.speed(flight.x.data());
    for (std::size_t i = 0; i < n; ++i) moved(i, size) -= late[i] * speed;
    return py::make_tuple(to_python(flight.x), to_python(moved), gap,
                          std::sqrt(dot(seen.data(), seen.data(), size)));
}

}  // namespace

void kernel::bind_replicas(py::class_<Arena, std::shared_ptr<Arena>>& arena) {
    arena
        .def("flown", &flown, py::arg("t"), py::arg("s"), py::arg("late"), py::arg("x"),
             py::arg("root"), py::arg("differences"),
             "An estimate s seconds after t; None if a gap falls below zero, but for the last "
             "ones.")
        .def("rebounded", &rebounded, py::arg("contact"), py::arg("t"), py::arg("s"), py::arg("x"),
             py::arg("differences"),
             "A replica s seconds after t and after an impact then, and its differences.")
        .def("fallback", &fallback, py::arg("noise"), py::arg("contact"), py::arg("t"),
             py::arg("s"), py::arg("x"), py::arg("errors"), py::arg("lag"),
             "The same of a replica with errors; and the gap at the impact, with its deviation.");
}
