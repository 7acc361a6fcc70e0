// SPDX-License-Identifier: Apache-2.0

// The module impact_observer.kernel._kernel: flow, guards and event location for Python.
#include <pybind11/functional.h>

#include "arrays.hpp"
#include "doubled.hpp"
#include "flights.hpp"
#include "free_motion.hpp"
#include "guards.hpp"
#include "series.hpp"

namespace pybind11::detail {

// Converts a float, or an Elapsed of stamps.py, which also has nanoseconds and a remainder.
template <>
struct type_caster<kernel::Elapsed> {
    PYBIND11_TYPE_CASTER(kernel::Elapsed, const_name("float"));
    bool load(handle t, bool) {
        make_caster<double> seconds;
        if (!seconds.load(t, true)) return false;
        value.seconds = seconds;
        if (hasattr(t, "remainder")) {
            value.exact = true;
            value.ns = pybind11::cast<std::int64_t>(t.attr("ns"));
            value.remainder = pybind11::cast<double>(t.attr("remainder"));
        }
        kernel::finite(value.seconds + value.remainder, "t");
        return true;
    }
};

// Converts indices of functions to a tuple.
template <>
struct type_caster<kernel::Indices> {
    static constexpr auto name = const_name("tuple");
    static handle cast(const kernel::Indices& which, return_value_policy, handle) {
        tuple indices(which.size());
        for (std::size_t k = 0; k < which.size(); ++k) indices[k] = which[k];
        return indices.release();
    }
};

}  // namespace pybind11::detail

using namespace kernel;

namespace {

using Flags = ArrayOf<bool>;
// T, T^-1, what is held, Q, the offset, and whether coordinates and velocities are side by side.
using CoordinateArrays = std::tuple<Array, Array, Array, Array, Array, bool>;
using PairArrays =
    std::tuple<Array, Array, Flags>;  // J; a, d and the slow one; whether it oscillates
using HarmonicArrays = std::tuple<Array, ArrayOf<std::uint64_t>>;  // frequencies, and their turns

Coordinates coordinates_of(const CoordinateArrays& frame) {
    const auto& [T, inverse, held, Q, offset, paired] = frame;
    const MatrixView forward = checked(T, "T", ANY, ANY);
    expect(paired || (forward.rows % 2 == 0 && forward.columns % 2 == 0), "T: not even");
    const std::size_t n = forward.rows / (paired ? 1 : 2);
    const std::size_t rest = held.size() ? n : 0, seen = Q.size() ? n : 0;
    return {forward,
            checked(inverse, "T_inverse", forward.columns, forward.rows),
            checked(held, "held", rest, rest),
            checked(Q, "Q", seen, seen),
            checked(offset, "offset", seen),
            paired};
}

Harmonics harmonics_of(const HarmonicArrays& waves) {
    const MatrixView frequency = checked(std::get<0>(waves), "frequency", ANY);
    const auto turns = checked(std::get<1>(waves), "turns", frequency.size(), 2);
    Harmonics harmonics{frequency, {}};
    for (std::size_t k = 0; k < harmonics.size(); ++k)
        harmonics.turns.push_back(Turns(turns(k, 0)) << 64 | turns(k, 1));
    return harmonics;
}

std::shared_ptr<ModalFlow> make_modal(const CoordinateArrays& frame, const PairArrays& blocks,
                                      const HarmonicArrays& waves, const Array& response,
                                      const Array& load, const Flags& near, const Flags& driven,
                                      const Array& energy, double small, double young) {
    const MatrixView J = checked(std::get<0>(blocks), "J", ANY, 4);
    const std::size_t r = J.rows;
    const MatrixView rates = checked(std::get<1>(blocks), "rates", r, 3);
    const auto oscillates = checked(std::get<2>(blocks), "oscillates", r);
    const Harmonics harmonics = harmonics_of(waves);
    const std::size_t h = harmonics.size();
    auto flow = std::make_shared<ModalFlow>(coordinates_of(frame), harmonics);
    expect(flow->coordinates.size == 2 * r, "T: expected twice as many coordinates as pairs");
    for (std::size_t p = 0; p < r; ++p)
        flow->pairs.emplace_back(rates(p, 0), rates(p, 1), rates(p, 2), oscillates[p],
                                 J.row(p).data);
    flow->response = checked(response, "response", 2 * r, 1 + 2 * h);
    flow->energy = checked(energy, "energy", r, 2);
    flow->small = finite(small, "small"), flow->young = finite(young, "young");
    const MatrixView loads = checked(load, "load", 2 * r, 1 + 2 * h);
    flow->near = flow->drives(loads, checked(near, "near", r, 1 + h));
    flow->all = flow->drives(loads, checked(driven, "driven", r, 1 + h));
    return flow;
}

MatrixView ascending(const Array& time, double after) {
    const MatrixView at = checked(time, "time", ANY);
    expect(at.size() > 0, "time: expected a sample at least");
    for (std::size_t i = 0; i < at.size(); after = at[i++])
        expect(at[i] > after, "time: does not ascend");
    return at;
}

SampledForces make_samples(const Array& time, const Array& jets, double rounding,
                           const std::function<void(double)>& check, std::size_t dropped,
                           double newest) {
    const MatrixView at = ascending(time, -INFINITY),
                     values = checked(jets, "jets", at.size(), ANY);
    expect(values.columns % JETS == 0, "jets: expected derivatives 0 to 3");
    return {at, values, finite(rounding, "rounding"), check, dropped, newest};
}

// Other samples from number `first` on, and none to change before `newest`.
void splice(SampledForces& samples, std::size_t first, const Array& time, const Array& jets,
            double newest) {
    expect(first >= samples.dropped && first <= samples.count(), "first: no such sample");
    const MatrixView at =
        ascending(time, first > samples.dropped ? samples.instant(first - 1) : -INFINITY);
    samples.splice(first, at, checked(jets, "jets", at.size(), samples.jets.columns));
    samples.newest = newest;
}

std::shared_ptr<SeriesFlow> make_series(const CoordinateArrays& frame, const Array& J,
                                        const HarmonicArrays& waves, const Array& load,
                                        const Array& push,
                                        const std::shared_ptr<SampledForces>& samples,
                                        double rate) {
    const Harmonics harmonics = harmonics_of(waves);
    auto flow = std::make_shared<SeriesFlow>(coordinates_of(frame), harmonics);
    const std::size_t size = flow->coordinates.size, h = harmonics.size();
    flow->J = checked(J, "J", size, ANY);
    expect(size == 0 || (flow->J.columns > 0 && size % flow->J.columns == 0),
           "J: expected whole blocks");
    expect(finite(rate, "rate") >= 0, "rate: negative");
    flow->load = checked(load, "load", size, 1 + 2 * h);
    flow->push = checked(push, "push", size, samples ? samples->forces() : 0);
    flow->samples = samples, flow->rate = rate;
    return flow;
}

std::shared_ptr<PhaseMotion> start(const PhaseFlow& flow, const Elapsed& t, const Array& x) {
    return flow.start(t, checked(x, "x", 2 * flow.coordinates.n).data);
}

Matrix states(const PhaseMotion& motion, const Array& s) {
    const MatrixView at = checked(s, "s", ANY);
    Matrix rows(at.size(), 2 * motion.flow->coordinates.n);
    motion.states(at.data, at.size(), rows.data.data());
    return rows;
}

Vector state(const PhaseMotion& motion, double s) {
    Vector x(2 * motion.flow->coordinates.n);
    finite(s, "s");
    motion.states(&s, 1, x.data());
    return x;
}

std::shared_ptr<Guards> guards(const PhaseFlow& flow, const Array& position, const Array& seen,
                               const Array& reach, const Array& waves, const Array& force) {
    const MatrixView rows = checked(position, "position", ANY, flow.coordinates.n);
    const std::size_t w = rows.rows, size = flow.coordinates.size;
    return flow.guards({rows, checked(seen, "seen", w, size), checked(reach, "reach", w, size),
                        checked(waves, "waves", w, 1 + 2 * flow.harmonics.size()),
                        checked(force, "force", w, flow.forces())});
}

// Values, derivatives, their bounds up to `stop` and scales of all functions at s, as the search
// uses them.
std::tuple<Matrix, Matrix, Vector, double> known(const Guards& guards,
                                                 const std::shared_ptr<PhaseMotion>& motion,
                                                 double s, double stop) {
    expect(finite(s, "s") >= 0 && finite(stop, "stop") >= s, "s, stop: expected 0 <= s <= stop");
    const std::unique_ptr<Functions> trace = guards.along(motion);
    trace->look(s);
    Matrix derivatives(ORDERS, trace->size()), bounds(derivatives);
    Vector scales;
    for (std::size_t i = 0; i < trace->size(); ++i) {
        scales.push_back(trace->scale(i));
        for (std::size_t k = 0; k < ORDERS; ++k) {
            derivatives(k, i) = trace->derivative(k, i);
            bounds(k, i) = trace->bound(k, i, stop) + (k ? 0.0 : std::abs(trace->constant(i)));
        }
    }
    return {derivatives, bounds, scales, trace->smooth_until()};
}

// The functions along a motion at each of s, in rising order, a row each.
Matrix values(const Guards& guards, const std::shared_ptr<PhaseMotion>& motion, const Array& s) {
    const MatrixView at = checked(s, "s", ANY);
    expect(std::is_sorted(at.data, at.data + at.size()), "s: expected a rising order");
    const std::unique_ptr<Functions> trace = guards.along(motion);
    Matrix rows(at.size(), trace->size());
    for (std::size_t k = 0; k < at.size(); ++k) {
        trace->look(at[k]);
        for (std::size_t i = 0; i < rows.columns; ++i) rows(k, i) = trace->derivative(0, i);
    }
    return rows;
}

RootSearch make_search(const Guards& guards, const std::shared_ptr<PhaseMotion>& motion,
                       double window, double start) {
    expect(finite(window, "window") > 0 && finite(start, "start") >= 0,
           "window, start: out of range");
    return RootSearch(guards.along(motion), window, start);
}

std::optional<Crossing> first(RootSearch& search, double horizon) {
    return search.first(finite(horizon, "horizon"));
}

std::shared_ptr<Arena> make_arena(const std::shared_ptr<Guards>& gaps, const Array& M,
                                  const Array& W, const Array& q_r, const Array& length,
                                  double window, double timescale, double shortest,
                                  double lowest) {
    const std::size_t n = gaps->flow->coordinates.n, m = gaps->size();
    const MatrixView rows = checked(W, "W", m, n), gap = checked(q_r, "q_r", m),
                     size = checked(length, "length", m);
    for (const double each : {window, timescale, shortest})
        expect(finite(each, "times") > 0, "times: not positive");
    Arena arena{gaps,     checked(M, "M", n, n),   {}, window, timescale,
                shortest, finite(lowest, "lowest")};
    for (std::size_t i = 0; i < m; ++i)
        arena.contacts.push_back({rows.row(i), {}, {}, gap[i], size[i]});
    return std::make_shared<Arena>(std::move(arena));
}

void learn(Arena& arena, std::size_t contact, const Array& kick, const Array& Z) {
    expect(contact < arena.contacts.size(), "contact: no such contact");
    const std::size_t n = arena.M.rows;
    const MatrixView by = checked(kick, "kick", n), to = checked(Z, "Z", n);
    arena.contacts[contact].kick = by;
    arena.contacts[contact].Z = to;
}

// Whether the difference of two such stamps fits into 64 bits.
bool is_near(std::int64_t stamp) { return std::abs(stamp / 2) <= INT64_MAX / 8; }

Flights fly(const std::shared_ptr<Arena>& arena, std::int64_t stamp, double remainder,
            const Array& x) {
    expect(is_near(stamp) && std::abs(remainder) <= 1.0, "stamp, remainder: out of range");
    return Flights(arena, {stamp, remainder}, checked(x, "x", 2 * arena->M.rows).data);
}

// The impacts with stamps up to `limit`, and the crossing that is left to others.
std::pair<std::vector<Hit>, std::optional<Crossing>> advance(Flights& flights, std::int64_t limit,
                                                             std::size_t most) {
    expect(is_near(limit), "limit: out of range");
    std::vector<Hit> hits = flights.advance(limit, most);
    return {std::move(hits), flights.ended ? flights.crossing : std::nullopt};
}

// A replica after an impact of one contact with these numbers, and its differences from others.
std::pair<Vector, Matrix> one_impact(const Array& w, double q_r, const Array& kick, const Array& Z,
                                     const Array& x, const Array& differences) {
    const MatrixView row = checked(w, "w", ANY);
    const std::size_t n = row.size();
    const ContactJump stop{row, checked(kick, "kick", n), checked(Z, "Z", n), finite(q_r, "q_r"),
                           0.0};
    std::pair<Vector, Matrix> jumped(checked(x, "x", 2 * n),
                                     checked(differences, "differences", 2 * n, ANY));
    stop.strike(jumped.first, jumped.second);
    return jumped;
}

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
    py::register_exception_translator([](std::exception_ptr thrown) {
        try {
            if (thrown) std::rethrow_exception(thrown);
        } catch (const TooFar& error) {
            const py::object type =
                py::module_::import("impact_observer.errors").attr("DynamicsError");
            PyErr_SetString(type.ptr(), error.what());
        }
    });
    const auto motion = "motion"_a.none(false);
    py::class_<PhaseMotion, std::shared_ptr<PhaseMotion>>(module, "PhaseMotion")
        .def_property_readonly("t", [](const PhaseMotion& motion) { return motion.t.seconds; })
        .def("state", &state, "s"_a)
        .def("states", &states, "s"_a);
    py::class_<PhaseFlow, std::shared_ptr<PhaseFlow>>(module, "PhaseFlow")
        .def("start", &start, "t"_a, "x"_a)
        .def("guards", &guards, "position"_a, "seen"_a, "reach"_a, "waves"_a, "force"_a);
    py::class_<ModalFlow, PhaseFlow, std::shared_ptr<ModalFlow>>(module, "ModalFlow")
        .def(py::init(&make_modal), "coordinates"_a, "splitting"_a, "waves"_a, "response"_a,
             "load"_a, "near"_a, "driven"_a, "energy"_a, "small"_a, "young"_a)
        .def(
            "propagated",
            [](const ModalFlow& flow, double s) { return flow.propagated(finite(s, "s")); },
            "s"_a);
    py::class_<SampledForces, std::shared_ptr<SampledForces>>(module, "SampledForces")
        .def(py::init(&make_samples), "time"_a, "jets"_a, "rounding"_a, "check"_a.none(false),
             "dropped"_a = 0, "newest"_a = INFINITY)
        .def("splice", &splice, "first"_a, "time"_a, "jets"_a, "newest"_a)
        .def("drop", &SampledForces::drop, "first"_a);
    py::class_<SeriesFlow, PhaseFlow, std::shared_ptr<SeriesFlow>>(module, "SeriesFlow")
        .def(py::init(&make_series), "coordinates"_a, "J"_a, "waves"_a, "load"_a, "push"_a,
             "samples"_a, "rate"_a);
    py::class_<Guards, std::shared_ptr<Guards>>(module, "Guards")
        .def("known", &known, motion, "s"_a, "stop"_a)
        .def("values", &values, motion, "s"_a, Released());
    py::class_<RootSearch>(module, "RootSearch")
        .def(py::init(&make_search), "guards"_a, motion, "window"_a, "start"_a = 0.0)
        .def_readonly("looks", &RootSearch::looks)
        .def("first", &first, "horizon"_a, Released());
    py::class_<Arena, std::shared_ptr<Arena>>(module, "Arena")
        .def(py::init(&make_arena), "gaps"_a.none(false), "M"_a, "W"_a, "q_r"_a, "length"_a,
             "window"_a, "timescale"_a, "shortest"_a, "lowest"_a)
        .def("learn", &learn, "contact"_a, "kick"_a, "Z"_a)
        .def("start", &fly, "stamp"_a, "remainder"_a, "x"_a);
    module.def("product", &checked_product, "A"_a, "B"_a);
    module.def("dots", &checked_dots, "X"_a, "Y"_a);
    module.def("difference", &checked_difference, "Y"_a, "Z"_a, "factors"_a);
    module.def("one_impact", &one_impact, "w"_a, "q_r"_a, "kick"_a, "Z"_a, "x"_a, "differences"_a);
    py::class_<Flights>(module, "Flights")
        .def("advance", &advance, "limit"_a, "most"_a, Released());
}
