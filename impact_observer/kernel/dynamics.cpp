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

// Flow, guards and event location for Python.
#include <pybind11/stl.h>

#include "bindings.hpp"
#include "flights.hpp"
#include "guards.hpp"
#include "series.hpp"

namespace kernel {

namespace {

using Flags = ArrayOf<bool>;
using Counts = ArrayOf<std::uint64_t>;

// Samples, and what raises Python's error for instants without any.
struct SampledForces : Samples {
    py::object check;
};

// A motion and its start as Python gave it.
struct Started {
    py::object t;
    std::shared_ptr<const Flow> flow;
    std::shared_ptr<const Motion> motion;
    std::shared_ptr<const SampledForces> samples;

    std::size_t size() const { return 2 * flow->coordinates.n; }

    void check(const double* s, std::size_t count) const {
        const double start = py::cast<double>(t);
        for (std::size_t k = 0; samples && k < count; ++k)
            if (start + s[k] < samples->time.front())
                samples->check(to_python(std::vector<double>{start + s[k]}));
    }
};

std::vector<Pair> pairs_of(const Array& J, const Array& rates, const Flags& oscillates) {
    const View four = checked(J, "J", ANY, 4);
    const View each = checked(rates, "rates", py::ssize_t(four.rows), 3);
    if (oscillates.ndim() != 1 || oscillates.shape(0) != J.shape(0))
        throw py::value_error("oscillates: shape " + shape_of(oscillates));
    std::vector<Pair> found(four.rows);
    for (std::size_t p = 0; p < found.size(); ++p) {
        Pair& pair = found[p];
        pair.a = each(p, 0), pair.d = each(p, 1), pair.slow = each(p, 2);
        pair.oscillates = oscillates.data()[p];
        std::copy(four.row(p), four.row(p) + 4, pair.J);
        for (std::size_t k = 0; k < 4; ++k) pair.D[k] = pair.J[k] - (k % 3 == 0 ? pair.a : 0.0);
    }
    return found;
}

Harmonics harmonics_of(const Array& frequency, const Counts& turns) {
    const View each = checked(frequency, "frequency", ANY);
    if (turns.ndim() != 2 || turns.shape(0) != frequency.shape(0) || turns.shape(1) != 2)
        throw py::value_error("turns: shape " + shape_of(turns) + "; expected (h, 2)");
    Harmonics found;
    for (std::size_t k = 0; k < each.rows; ++k) {
        found.frequency.push_back(each[k]);
        found.turns.push_back(Turns(turns.data()[2 * k]) << 64 | turns.data()[2 * k + 1]);
    }
    return found;
}

// The loads of those pairs and harmonics that are marked, n x (1 + h).
std::vector<Drive> drives_of(const ModalFlow& flow, const View& load, const Flags& marked) {
    const std::size_t n = flow.pairs.size(), h = flow.harmonics.size();
    if (marked.ndim() != 2 || std::size_t(marked.shape(0)) != n ||
        std::size_t(marked.shape(1)) != 1 + h)
        throw py::value_error("near, driven: shape " + shape_of(marked) + "; expected (n, 1 + h)");
    std::vector<Drive> found;
    for (std::size_t p = 0; p < n; ++p)
        for (std::size_t k = 0; k <= h; ++k) {
            if (!marked.data()[p * (1 + h) + k]) continue;
            const Pair& pair = flow.pairs[p];
            Drive drive;
            drive.pair = p, drive.harmonic = k;
            drive.one = pair.oscillates ? Complex(pair.a, pair.d) : Complex(pair.slow);
            drive.two = pair.oscillates ? std::conj(drive.one) : Complex(2 * pair.a - pair.slow);
            drive.mu = k == 0 ? Complex(0.0) : Complex(0.0, flow.harmonics.frequency[k - 1]);
            for (std::size_t i = 0; i < 2; ++i)
                drive.beta[i] = {load(2 * p + i, k), k == 0 ? 0.0 : -load(2 * p + i, k + h)};
            for (std::size_t i = 0; i < 2; ++i)
                drive.turned[i] = pair.D[2 * i] * drive.beta[0] +
                                  pair.D[2 * i + 1] * drive.beta[1] +
                                  (pair.a - drive.one) * drive.beta[i];
            found.push_back(drive);
        }
    return found;
}

Array part(const py::tuple& of, std::size_t k) { return py::cast<Array>(of[k]); }

// T, T^-1, what is held, Q, the offset, and whether coordinates and velocities are side by side.
Coordinates coordinates_of(const py::tuple& given) {
    const bool paired = py::cast<bool>(given[5]);
    const Array T = part(given, 0), inverse = part(given, 1), held = part(given, 2);
    const Array Q = part(given, 3), offset = part(given, 4);
    const View forward = checked(T, "T", ANY, ANY);
    if (!paired && (forward.rows % 2 || forward.columns % 2))
        throw py::value_error("T: shape " + shape_of(T) + "; expected even numbers");
    const py::ssize_t n = T.shape(0) / (paired ? 1 : 2);
    const py::ssize_t rest = held.size() ? n : 0, seen = Q.size() ? n : 0;
    return Coordinates(forward, checked(inverse, "T_inverse", T.shape(1), T.shape(0)),
                       checked(held, "held", rest, rest), checked(Q, "Q", seen, seen),
                       checked(offset, "offset", seen), paired);
}

Harmonics harmonics_of(const py::tuple& waves) {
    return harmonics_of(part(waves, 0), py::cast<Counts>(waves[1]));
}

std::shared_ptr<ModalFlow> make_modal(const py::tuple& coordinates, const py::tuple& splitting,
                                      const py::tuple& waves, const Array& response,
                                      const Array& load, const Flags& near, const Flags& all,
                                      const Array& energy, double small, double young) {
    const auto pairs =
        pairs_of(part(splitting, 0), part(splitting, 1), py::cast<Flags>(splitting[2]));
    const py::ssize_t r = py::ssize_t(pairs.size());
    const Harmonics harmonics = harmonics_of(waves);
    const py::ssize_t columns = 1 + 2 * py::ssize_t(harmonics.size());
    Coordinates checked_coordinates = coordinates_of(coordinates);
    if (checked_coordinates.size != 2 * pairs.size())
        throw py::value_error("T: expected twice as many coordinates as pairs");
    auto flow = std::make_shared<ModalFlow>(std::move(checked_coordinates), harmonics, pairs,
                                            Matrix(checked(response, "response", 2 * r, columns)),
                                            Matrix(checked(energy, "energy", r, 2)),
                                            finite(small, "small"), finite(young, "young"));
    const View loads = checked(load, "load", 2 * r, columns);
    flow->near = drives_of(*flow, loads, near);
    flow->all = drives_of(*flow, loads, all);
    return flow;
}

std::shared_ptr<SampledForces> make_samples(const Array& time, const Array& jets, double rounding,
                                            const py::object& check, std::size_t dropped,
                                            double newest) {
    const View at = checked(time, "time", ANY);
    const std::size_t k = at.rows;
    const View values = checked(jets, "jets", py::ssize_t(JETS * k), ANY);
    if (k < 1) throw py::value_error("time: expected a sample at least");
    for (std::size_t i = 1; i < k; ++i)
        if (!(at[i] > at[i - 1])) throw py::value_error("time: does not ascend");
    auto found = std::make_shared<SampledForces>();
    found->time.assign(at.data, at.data + k);
    for (std::size_t order = 0; order < JETS; ++order) {
        found->jets[order] = Matrix(k, values.columns);
        std::copy(values.row(order * k), values.row(order * k) + k * values.columns,
                  found->jets[order].data.begin());
    }
    found->rounding = finite(rounding, "rounding");
    found->check = check;
    found->dropped = dropped;
    found->newest = newest;
    return found;
}

// Other samples from number `first` on, and none to change before `newest`.
void splice(SampledForces& samples, std::size_t first, const Array& time, const Array& jets,
            double newest) {
    const View at = checked(time, "time", ANY);
    if (at.rows == 0) throw py::value_error("time: expected a sample at least");
    if (first < samples.dropped || first > samples.count())
        throw py::value_error("first: no such sample");
    double before = first > samples.dropped ? samples.at(first - 1) : -INFINITY;
    for (std::size_t i = 0; i < at.rows; before = at[i++])
        if (!(at[i] > before)) throw py::value_error("time: does not ascend");
    samples.splice(
        first, at,
        checked(jets, "jets", py::ssize_t(JETS * at.rows), py::ssize_t(samples.jets[0].columns)));
    samples.newest = newest;
}

void drop(SampledForces& samples, std::size_t first) {
    if (first < samples.dropped || first >= samples.count())
        throw py::value_error("first: no such sample");
    samples.drop(first);
}

std::shared_ptr<SeriesFlow> make_series(const py::tuple& coordinates, const Array& J,
                                        const py::tuple& waves, const Array& load,
                                        const Array& push,
                                        const std::shared_ptr<SampledForces>& samples, double rate,
                                        const Array& orders) {
    Coordinates checked_coordinates = coordinates_of(coordinates);
    const py::ssize_t size = py::ssize_t(checked_coordinates.size);
    const View blocks = checked(J, "J", size, ANY);
    if (size > 0 && (blocks.columns == 0 || checked_coordinates.size % blocks.columns))
        throw py::value_error("J: shape " + shape_of(J) + "; expected whole blocks");
    if (!(finite(rate, "rate") >= 0)) throw py::value_error("rate: negative");
    const Harmonics harmonics = harmonics_of(waves);
    const py::ssize_t columns = 1 + 2 * py::ssize_t(harmonics.size());
    const py::ssize_t forces = samples ? py::ssize_t(samples->jets[0].columns) : 0;
    const View each = checked(orders, "orders", py::ssize_t(harmonics.size()));
    std::vector<double> turning(each.data, each.data + each.rows);
    if (std::all_of(turning.begin(), turning.end(), [](double order) { return order == 0; }))
        turning.clear();
    else if (forces == 0)
        throw py::value_error("orders: there are no samples of a phase");
    return std::make_shared<SeriesFlow>(std::move(checked_coordinates), harmonics, Matrix(blocks),
                                        Matrix(checked(load, "load", size, columns)),
                                        Matrix(checked(push, "push", size, forces)), samples, rate,
                                        std::move(turning));
}

Started start(const std::shared_ptr<Flow>& flow, const py::object& t, const Array& x) {
    const View state = checked(x, "x", py::ssize_t(2 * flow->coordinates.n));
    Started found{t, flow, nullptr, nullptr};
    const Time at = time_of(t);
    if (const auto series = std::dynamic_pointer_cast<const SeriesFlow>(flow)) {
        found.samples = std::static_pointer_cast<const SampledForces>(series->samples);
        const double now = 0.0;
        found.check(&now, 1);
    }
    found.motion = flow->start(at, state.data);
    return found;
}

Array propagated(const ModalFlow& flow, double s) {
    return to_python(flow.propagated(finite(s, "s")));
}

Array states(const Started& started, const Array& s) {
    const View at = checked(s, "s", ANY);
    started.check(at.data, at.rows);
    Array found({at.rows, started.size()});
    started.motion->states(at.data, at.rows, found.mutable_data());
    return found;
}

Array state(const Started& started, double s) {
    Array found(py::ssize_t(started.size()));
    finite(s, "s");
    started.check(&s, 1);
    started.motion->states(&s, 1, found.mutable_data());
    return found;
}

// The rows of functions that both kinds of motions need: of q, of y, what the latter are rounded
// against, and of (1, cos, sin).
struct Rows {
    Matrix position, seen, reach, waves;

    Rows(const Flow& flow, const Array& q, const Array& y, const Array& rounded,
         const Array& driven) {
        const py::ssize_t size = py::ssize_t(flow.coordinates.size);
        position = Matrix(checked(q, "position", ANY, py::ssize_t(flow.coordinates.n)));
        const py::ssize_t w = py::ssize_t(position.rows);
        seen = Matrix(checked(y, "seen", w, size));
        reach = Matrix(checked(rounded, "reach", w, size));
        waves = Matrix(checked(driven, "waves", w, 1 + 2 * py::ssize_t(flow.harmonics.size())));
    }
};

std::shared_ptr<Guards> modal_guards(const std::shared_ptr<ModalFlow>& flow, const Array& position,
                                     const Array& seen, const Array& reach, const Array& waves) {
    const Rows rows(*flow, position, seen, reach, waves);
    return std::make_shared<ModalGuards>(flow, rows.position, rows.seen, rows.reach, rows.waves);
}

std::shared_ptr<Guards> series_guards(const std::shared_ptr<SeriesFlow>& flow,
                                      const Array& position, const Array& seen, const Array& reach,
                                      const Array& waves, const Array& force) {
    const Rows rows(*flow, position, seen, reach, waves);
    const View pushed =
        checked(force, "force", py::ssize_t(rows.position.rows), py::ssize_t(flow->push.columns));
    return std::make_shared<SeriesGuards>(flow, rows.position, rows.seen, rows.reach, rows.waves,
                                          Matrix(pushed));
}

// What a search knows of each function at s: value, derivatives, a bound on each up to `stop`,
// and what it is rounded against.
py::tuple known(const Guards& guards, const Started& started, double s, double stop) {
    if (!(finite(s, "s") >= 0) || !(finite(stop, "stop") >= s))
        throw py::value_error("s, stop: expected 0 <= s <= stop");
    const std::unique_ptr<Functions> trace = guards.along(started.motion);
    trace->look(s);
    Matrix derivatives(ORDERS, trace->size()), bounds(ORDERS, trace->size());
    std::vector<double> scales;
    for (std::size_t i = 0; i < trace->size(); ++i) {
        scales.push_back(trace->scale(i));
        for (std::size_t k = 0; k < ORDERS; ++k) {
            derivatives(k, i) = trace->derivative(k, i);
            bounds(k, i) = trace->largest(k, i, stop) + (k ? 0.0 : std::abs(trace->constant(i)));
        }
    }
    return py::make_tuple(to_python(derivatives), to_python(bounds), to_python(scales),
                          trace->smooth_until());
}

// The functions along a motion at each of s, in rising order, a row each.
Array values(const Guards& guards, const Started& started, const Array& s) {
    const View at = checked(s, "s", ANY);
    started.check(at.data, at.rows);
    const std::unique_ptr<Functions> trace = guards.along(started.motion);
    Matrix found(at.rows, trace->size());
    {
        const py::gil_scoped_release unlocked;
        for (std::size_t k = 0; k < at.rows; ++k) {
            if (k > 0 && at[k] < at[k - 1]) throw py::value_error("s: expected a rising order");
            trace->look(at[k]);
            for (std::size_t i = 0; i < found.columns; ++i) found(k, i) = trace->derivative(0, i);
        }
    }
    return to_python(found);
}

Hunt hunt(const Guards& guards, const Started& started, double window, double start) {
    if (!(finite(window, "window") > 0) || !(finite(start, "start") >= 0))
        throw py::value_error("window, start: out of range");
    return Hunt(guards.along(started.motion), window, start);
}

py::object first(Hunt& search, double horizon) {
    finite(horizon, "horizon");
    const std::optional<Crossing>* found;
    {
        const py::gil_scoped_release unlocked;
        found = &search.first(horizon);
    }
    if (!*found) return py::none();
    return py::make_tuple((*found)->s, py::tuple(py::cast((*found)->which)));
}

std::shared_ptr<Arena> make_arena(const std::shared_ptr<Guards>& gaps, const Array& M,
                                  const Array& W, const Array& q_r, const Array& length,
                                  const py::tuple& times, double lowest) {
    const py::ssize_t n = py::ssize_t(gaps->flow->coordinates.n), m = py::ssize_t(gaps->w);
    const View rows = checked(W, "W", m, n), gap = checked(q_r, "q_r", m),
               size = checked(length, "length", m);
    auto arena = std::make_shared<Arena>(
        Arena{gaps, Matrix(checked(M, "M", n, n)), {}, 0.0, 0.0, 0.0, finite(lowest, "lowest")});
    double* const each[3] = {&arena->window, &arena->timescale, &arena->shortest};
    for (std::size_t k = 0; k < 3; ++k)
        if (*each[k] = finite(py::cast<double>(times[k]), "times"); !(*each[k] > 0))
            throw py::value_error("times: not positive");
    for (std::size_t i = 0; i < rows.rows; ++i)
        arena->contacts.push_back({{rows.row(i), rows.row(i) + n}, {}, {}, gap[i], size[i]});
    return arena;
}

void learn(Arena& arena, std::size_t contact, const Array& kick, const Array& Z) {
    if (contact >= arena.contacts.size()) throw py::value_error("contact: no such contact");
    const py::ssize_t n = py::ssize_t(arena.M.rows);
    const View by = checked(kick, "kick", n), to = checked(Z, "Z", n);
    arena.contacts[contact].kick.assign(by.data, by.data + n);
    arena.contacts[contact].Z.assign(to.data, to.data + n);
}

// Stamps whose differences are no overflow.
std::int64_t stamp_of(std::int64_t given, const char* name) {
    if (given > INT64_MAX / 4 || given < -(INT64_MAX / 4))
        throw py::value_error(std::string(name) + ": out of range");
    return given;
}

// A part of an instant that is missing from its stamp.
double remainder_of(double given) {
    if (!(std::abs(given) <= 1.0)) throw py::value_error("remainder: out of range");
    return given;
}

Flights fly(const std::shared_ptr<Arena>& arena, std::int64_t stamp, double remainder,
            const Array& x) {
    return Flights(arena, {stamp_of(stamp, "stamp"), remainder_of(remainder)},
                   checked(x, "x", py::ssize_t(2 * arena->M.rows)).data);
}

py::object left_by(const Flights& flights) {
    if (!flights.ended) return py::none();
    return py::make_tuple(flights.crossing->s, py::tuple(py::cast(flights.crossing->which)));
}

// The impacts with stamps up to `limit`, a tuple each, and the crossing that is left to others.
py::tuple advance(Flights& flights, std::int64_t limit, std::size_t most) {
    std::vector<Hit> hits;
    stamp_of(limit, "limit");
    {
        const py::gil_scoped_release unlocked;
        hits = flights.advance(limit, most);
    }
    py::list found;
    for (const Hit& hit : hits)
        found.append(py::make_tuple(hit.instant.stamp, hit.instant.remainder, hit.contact,
                                    hit.energy, to_python(hit.before), to_python(hit.after)));
    return py::make_tuple(found, left_by(flights));
}

}  // namespace

void bind_dynamics(py::module_& module) {
    py::register_exception_translator([](std::exception_ptr thrown) {
        try {
            if (thrown) std::rethrow_exception(thrown);
        } catch (const TooFar& error) {
            const py::object type =
                py::module_::import("impact_observer.errors").attr("DynamicsError");
            PyErr_SetString(type.ptr(), error.what());
        }
    });
    py::class_<Started>(module, "PhaseMotion")
        .def_readonly("t", &Started::t)
        .def("state", &state, py::arg("s"))
        .def("states", &states, py::arg("s"));
    py::class_<Flow, std::shared_ptr<Flow>>(module, "PhaseFlow")
        .def("start", &start, py::arg("t"), py::arg("x"));
    py::class_<ModalFlow, Flow, std::shared_ptr<ModalFlow>>(module, "ModalFlow")
        .def(py::init(&make_modal), py::arg("coordinates"), py::arg("splitting"), py::arg("waves"),
             py::arg("response"), py::arg("load"), py::arg("near"), py::arg("driven"),
             py::arg("energy"), py::arg("small"), py::arg("young"))
        .def("propagated", &propagated, py::arg("s"))
        .def("guards", &modal_guards, py::arg("position"), py::arg("seen"), py::arg("reach"),
             py::arg("waves"));
    py::class_<SampledForces, std::shared_ptr<SampledForces>>(module, "SampledForces")
        .def(py::init(&make_samples), py::arg("time"), py::arg("jets"), py::arg("rounding"),
             py::arg("check"), py::arg("dropped") = 0, py::arg("newest") = INFINITY)
        .def("splice", &splice, py::arg("first"), py::arg("time"), py::arg("jets"),
             py::arg("newest"))
        .def("drop", &drop, py::arg("first"));
    py::class_<SeriesFlow, Flow, std::shared_ptr<SeriesFlow>>(module, "SeriesFlow")
        .def(py::init(&make_series), py::arg("coordinates"), py::arg("J"), py::arg("waves"),
             py::arg("load"), py::arg("push"), py::arg("samples"), py::arg("rate"),
             py::arg("orders"))
        .def("guards", &series_guards, py::arg("position"), py::arg("seen"), py::arg("reach"),
             py::arg("waves"), py::arg("force"));
    py::class_<Guards, std::shared_ptr<Guards>>(module, "Guards")
        .def("known", &known, py::arg("motion"), py::arg("s"), py::arg("stop"))
        .def("values", &values, py::arg("motion"), py::arg("s"));
    py::class_<Hunt>(module, "RootSearch")
        .def(py::init(&hunt), py::arg("guards"), py::arg("motion"), py::arg("window"),
             py::arg("start") = 0.0)
        .def_readonly("looks", &Hunt::looks)
        .def("first", &first, py::arg("horizon"));
    py::class_<Arena, std::shared_ptr<Arena>> arena(module, "Arena");
    arena
        .def(py::init(&make_arena), py::arg("gaps").none(false), py::arg("M"), py::arg("W"),
             py::arg("q_r"), py::arg("length"), py::arg("times"), py::arg("lowest"))
        .def("learn", &learn, py::arg("contact"), py::arg("kick"), py::arg("Z"))
        .def("start", &fly, py::arg("stamp"), py::arg("remainder"), py::arg("x"));
    bind_replicas(arena);
    py::class_<Flights>(module, "Flights")
        .def("advance", &advance, py::arg("limit"), py::arg("most"));
}

}  // namespace kernel
