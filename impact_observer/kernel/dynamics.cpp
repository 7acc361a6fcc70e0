// Flow, guards and event location for Python.
#include <pybind11/complex.h>
#include <pybind11/stl.h>

#include "bindings.hpp"
#include "flights.hpp"

namespace kernel {

namespace {

using Flags = ArrayOf<bool>;
using Counts = ArrayOf<std::uint64_t>;

Time time_of(const py::object& t) {
    Time found{py::cast<double>(t)};
    if (py::hasattr(t, "remainder")) {
        found.exact = true;
        found.ns = py::cast<std::int64_t>(t.attr("ns"));
        found.remainder = py::cast<double>(t.attr("remainder"));
    }
    if (!std::isfinite(found.seconds) || !std::isfinite(found.remainder))
        throw py::value_error("t: not finite");
    return found;
}

double finite(double value, const char* name) {
    if (!std::isfinite(value)) throw py::value_error(std::string(name) + ": not finite");
    return value;
}

// A motion and its start as Python gave it.
struct Started {
    py::object t;
    std::shared_ptr<const Motion> motion;
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
std::vector<Drive> drives_of(const Flow& flow, const View& load, const Flags& marked) {
    const std::size_t n = flow.modes.n, h = flow.harmonics.size();
    if (marked.ndim() != 2 || std::size_t(marked.shape(0)) != n ||
        std::size_t(marked.shape(1)) != 1 + h)
        throw py::value_error("near, driven: shape " + shape_of(marked) + "; expected (n, 1 + h)");
    std::vector<Drive> found;
    for (std::size_t p = 0; p < n; ++p)
        for (std::size_t k = 0; k <= h; ++k) {
            if (!marked.data()[p * (1 + h) + k]) continue;
            const Pair& pair = flow.modes.pairs[p];
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

std::shared_ptr<Flow> make_flow(const py::tuple& splitting, const py::tuple& waves,
                                const Array& response, const Array& load, const Flags& near,
                                const Flags& all, const Array& energy, double small,
                                double young) {
    const auto part = [](const py::tuple& of, std::size_t k) { return py::cast<Array>(of[k]); };
    const auto pairs =
        pairs_of(part(splitting, 2), part(splitting, 3), py::cast<Flags>(splitting[4]));
    const py::ssize_t n = py::ssize_t(pairs.size());
    const Array T = part(splitting, 0), T_inverse = part(splitting, 1);
    const py::ssize_t size = T.ndim() == 2 && T.shape(0) == n ? n : 2 * n;
    const Harmonics harmonics = harmonics_of(part(waves, 0), py::cast<Counts>(waves[1]));
    const py::ssize_t columns = 1 + 2 * py::ssize_t(harmonics.size());
    auto flow = std::make_shared<Flow>(Flow{
        Modes(pairs, checked(T, "T", size, size), checked(T_inverse, "T_inverse", size, size)),
        harmonics,
        Matrix(checked(response, "response", 2 * n, columns)),
        {},
        {},
        Matrix(checked(energy, "energy", n, 2)),
        finite(small, "small"),
        finite(young, "young")});
    const View loads = checked(load, "load", 2 * n, columns);
    flow->near = drives_of(*flow, loads, near);
    flow->all = drives_of(*flow, loads, all);
    return flow;
}

Started start(const std::shared_ptr<Flow>& flow, const py::object& t, const Array& x) {
    const View state = checked(x, "x", py::ssize_t(2 * flow->modes.n));
    return {t, std::make_shared<Motion>(flow, time_of(t), state.data)};
}

Array transition(const Flow& flow, double s) {
    return to_python(flow.modes.transition(finite(s, "s")));
}

Array state(const Started& started, double s) {
    Array found(py::ssize_t(2 * started.motion->flow->modes.n));
    finite(s, "s");
    started.motion->states(&s, 1, found.mutable_data());
    return found;
}

Array states(const Started& started, const Array& s) {
    const View at = checked(s, "s", ANY);
    const std::size_t size = 2 * started.motion->flow->modes.n;
    Array found({at.rows, size});
    double* rows = found.mutable_data();
    const Motion& motion = *started.motion;
    const py::gil_scoped_release unlocked;
    motion.states(at.data, at.rows, rows);
    return found;
}

std::shared_ptr<Guards> make_guards(const std::shared_ptr<Flow>& flow, const Array& seen,
                                    const Array& reach, const Array& harmonics,
                                    const Array& constant) {
    const py::ssize_t n = py::ssize_t(flow->modes.n), h = py::ssize_t(flow->harmonics.size());
    const View rows = checked(seen, "seen", ANY, 2 * n);
    const py::ssize_t w = py::ssize_t(rows.rows);
    const View waves = checked(harmonics, "harmonics", w, 2 * h),
               level = checked(constant, "constant", w);
    std::vector<Complex> amplitudes(std::size_t(w * h));
    for (std::size_t k = 0; k < amplitudes.size(); ++k) {
        const std::size_t i = k / std::size_t(h), j = k % std::size_t(h);
        amplitudes[k] = {waves(i, j), waves(i, std::size_t(h) + j)};
    }
    return std::make_shared<Guards>(flow, Matrix(rows), Matrix(checked(reach, "reach", w, 2 * n)),
                                    amplitudes, std::vector<double>(level.data, level.data + w));
}

Trace trace(const std::shared_ptr<Guards>& guards, const Started& started, const Array& shift) {
    if (started.motion->flow != guards->flow) throw py::value_error("motion: of another flow");
    const View added = checked(shift, "shift", py::ssize_t(guards->w));
    return Trace(guards, started.motion, {added.data, added.data + added.rows});
}

// What the search knows of each function at s: value, derivatives, a bound on each up to `stop`,
// and what it is rounded against.
py::tuple known(Trace& trace, double s, double stop) {
    if (!(finite(s, "s") >= 0) || !(finite(stop, "stop") >= s))
        throw py::value_error("s, stop: expected 0 <= s <= stop");
    trace.look(s);
    Matrix derivatives(ORDERS, trace.size()), bounds(ORDERS, trace.size());
    std::vector<double> scales;
    for (std::size_t i = 0; i < trace.size(); ++i) {
        scales.push_back(trace.scale(i));
        for (std::size_t k = 0; k < ORDERS; ++k) {
            derivatives(k, i) = trace.derivative(k, i);
            bounds(k, i) = trace.largest(k, i, stop) + (k ? 0.0 : std::abs(trace.constant(i)));
        }
    }
    return py::make_tuple(to_python(derivatives), to_python(bounds), to_python(scales));
}

using Search = Hunt<Trace>;

Search hunt(const Trace& trace, double window, double end, double start) {
    if (!(window > 0) || std::isnan(end) || !(start >= 0))
        throw py::value_error("window, end, start: out of range");
    return Search(trace, window, end, start);
}

py::object first(Search& search, double horizon) {
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
    const py::ssize_t n = py::ssize_t(gaps->flow->modes.n), m = py::ssize_t(gaps->w);
    const View rows = checked(W, "W", m, n), gap = checked(q_r, "q_r", m),
               size = checked(length, "length", m);
    auto arena = std::make_shared<Arena>(Arena{gaps->flow,
                                               gaps,
                                               Matrix(checked(M, "M", n, n)),
                                               {},
                                               0.0,
                                               0.0,
                                               0.0,
                                               finite(lowest, "lowest")});
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

Flights fly(const std::shared_ptr<Arena>& arena, std::int64_t stamp, double remainder,
            const Array& x) {
    return Flights(arena, {stamp_of(stamp, "stamp"), finite(remainder, "remainder")},
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
        flights.advance(limit, most, [&](Hit&& hit) { hits.push_back(std::move(hit)); });
    }
    py::list found;
    for (const Hit& hit : hits)
        found.append(py::make_tuple(hit.instant.stamp, hit.instant.remainder, hit.contact,
                                    hit.energy, to_python(hit.before), to_python(hit.after)));
    return py::make_tuple(found, left_by(flights));
}

// The same of many starts, without the lock: arrays of stamps, remainders, contacts and states
// after, and the crossing that is left, for each row of `x`.
py::list fly_all(const std::shared_ptr<Arena>& arena, std::int64_t stamp, double remainder,
                 const Array& x, std::int64_t limit, std::size_t most) {
    const View starts = checked(x, "x", ANY, py::ssize_t(2 * arena->M.rows));
    const Instant start{stamp_of(stamp, "stamp"), finite(remainder, "remainder")};
    stamp_of(limit, "limit");
    std::vector<std::vector<Hit>> hits(starts.rows);
    std::vector<Flights> flights;
    {
        const py::gil_scoped_release unlocked;
        for (std::size_t k = 0; k < starts.rows; ++k) {
            flights.emplace_back(arena, start, starts.row(k));
            flights.back().advance(limit, most, [&](Hit&& hit) {
                hit.before.clear();
                hits[k].push_back(std::move(hit));
            });
        }
    }
    py::list found;
    for (std::size_t k = 0; k < starts.rows; ++k) {
        std::vector<std::int64_t> stamps, contacts;
        std::vector<double> remainders;
        Matrix after(hits[k].size(), starts.columns);
        for (std::size_t i = 0; i < hits[k].size(); ++i) {
            const Hit& hit = hits[k][i];
            stamps.push_back(hit.instant.stamp);
            remainders.push_back(hit.instant.remainder);
            contacts.push_back(std::int64_t(hit.contact));
            std::copy(hit.after.begin(), hit.after.end(), after.row(i));
        }
        const auto integers = [](const std::vector<std::int64_t>& of) {
            return ArrayOf<std::int64_t>(py::ssize_t(of.size()), of.data());
        };
        found.append(py::make_tuple(integers(stamps), to_python(remainders), integers(contacts),
                                    to_python(after), left_by(flights[k])));
    }
    return found;
}

using Points = ArrayOf<Complex>;

// Divided differences of the exponential on the columns of `points` at each s, (samples, columns).
Points differences(const Points& points, const Array& s) {
    const View at = checked(s, "s", ANY);
    if (points.ndim() != 2 || points.shape(0) < 2 || std::size_t(points.shape(0)) > MOST_POINTS)
        throw py::value_error("points: shape " + shape_of(points) + "; expected (2 to 8, any)");
    const std::size_t count = std::size_t(points.shape(0)), columns = std::size_t(points.shape(1));
    for (std::size_t k = 0; k < count * columns; ++k)
        if (!std::isfinite(std::abs(points.data()[k])))
            throw py::value_error("points: not finite");
    Points found({at.rows, columns});
    Complex column[MOST_POINTS];
    for (std::size_t j = 0; j < columns; ++j) {
        for (std::size_t k = 0; k < count; ++k) column[k] = points.data()[k * columns + j];
        for (std::size_t i = 0; i < at.rows; ++i)
            found.mutable_data()[i * columns + j] = divided(column, count, at[i]);
    }
    return found;
}

}  // namespace

void bind_dynamics(py::module_& module) {
    py::class_<Flow, std::shared_ptr<Flow>>(module, "ModalFlow")
        .def(py::init(&make_flow), py::arg("splitting"), py::arg("waves"), py::arg("response"),
             py::arg("load"), py::arg("near"), py::arg("driven"), py::arg("energy"),
             py::arg("small"), py::arg("young"))
        .def("start", &start, py::arg("t"), py::arg("x"))
        .def("transition", &transition, py::arg("s"));
    py::class_<Started>(module, "ModalMotion")
        .def_readonly("t", &Started::t)
        .def("state", &state, py::arg("s"))
        .def("states", &states, py::arg("s"))
        .def("each", &states, py::arg("s"));
    py::class_<Guards, std::shared_ptr<Guards>>(module, "Guards")
        .def(py::init(&make_guards), py::arg("flow").none(false), py::arg("seen"),
             py::arg("reach"), py::arg("harmonics"), py::arg("constant"))
        .def("trace", &trace, py::arg("motion"), py::arg("shift"));
    py::class_<Trace>(module, "Trace").def("known", &known, py::arg("s"), py::arg("stop"));
    py::class_<Search>(module, "RootSearch")
        .def(py::init(&hunt), py::arg("trace"), py::arg("window"), py::arg("end"),
             py::arg("start") = 0.0)
        .def_readonly("looks", &Search::looks)
        .def("first", &first, py::arg("horizon"));
    py::class_<Arena, std::shared_ptr<Arena>>(module, "Arena")
        .def(py::init(&make_arena), py::arg("gaps").none(false), py::arg("M"), py::arg("W"),
             py::arg("q_r"), py::arg("length"), py::arg("times"), py::arg("lowest"))
        .def("learn", &learn, py::arg("contact"), py::arg("kick"), py::arg("Z"))
        .def("start", &fly, py::arg("stamp"), py::arg("remainder"), py::arg("x"))
        .def("fly_all", &fly_all, py::arg("stamp"), py::arg("remainder"), py::arg("x"),
             py::arg("limit"), py::arg("most"));
    py::class_<Flights>(module, "Flights")
        .def("advance", &advance, py::arg("limit"), py::arg("most"));
    module.def("divided", &differences, py::arg("points"), py::arg("s"));
}

}  // namespace kernel
