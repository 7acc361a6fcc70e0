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

// The bindings of the Kalman step.
#include "gaps.hpp"

using namespace kernel;
using namespace kernel::kalman;

namespace {

Vector vector(const Array& a, const char* name, py::ssize_t size) {
    const View v = checked(a, name, size);
    return Vector(v.data, v.data + v.size());
}

Matrix matrix(const Array& a, const char* name, std::size_t rows, std::size_t columns) {
    return Matrix(checked(a, name, py::ssize_t(rows), py::ssize_t(columns)));
}

double positive(double value, const char* name) {
    if (!(value >= 0 && std::isfinite(value)))
        throw py::value_error(std::string(name) + ": expected a finite number, 0 or more");
    return value;
}

FreeMotion motion_of(const Array& lower, const Array& constant, const Array& frequency,
                     const Array& cosine, const Array& sine, double rate, double decay) {
    const View whole = checked(lower, "lower", ANY, ANY);
    const std::size_t n = whole.rows;
    if (n == 0 || whole.columns != 2 * n) throw py::value_error("lower: expected shape (n, 2n)");
    FreeMotion found;
    found.lower = Matrix(whole);
    found.constant = vector(constant, "constant", py::ssize_t(n));
    found.frequency = vector(frequency, "frequency", ANY);
    found.cosine = matrix(cosine, "cosine", found.frequency.size(), n);
    found.sine = matrix(sine, "sine", found.frequency.size(), n);
    found.rate = std::max(positive(rate, "rate"), LEAST);
    found.decay = positive(decay, "decay");
    found.prepare();
    return found;
}

Sizes sizes_of(const Array& modes, const Array& spread, const Array& squares, double timescale) {
    const View whole = checked(modes, "modes", ANY, ANY);
    const std::size_t n = whole.rows;
    return {matrix(modes, "modes", n, n), matrix(spread, "spread", n, n),
            vector(squares, "squares", py::ssize_t(n)), positive(timescale, "timescale")};
}

Parameters parameters_of(const Array& low, const Array& high, const Array& size,
                         std::size_t moving) {
    Parameters found{vector(low, "low", ANY), {}, {}, moving};
    const auto p = py::ssize_t(found.low.size());
    found.high = vector(high, "high", p), found.size = vector(size, "size", p);
    if (moving > found.count()) throw py::value_error("moving: more than there are");
    for (std::size_t j = 0; j < found.count(); ++j)
        if (!(found.size[j] > 0 && found.high[j] - found.low[j] >= 2 * MARGIN * found.size[j]))
            throw py::value_error("low, high, size: expected bounds, and positive sizes");
    return found;
}

Array steps_of(const Parameters& parameters, const Array& theta, const Array& root) {
    const View rows = checked(root, "root", ANY, ANY), at = checked(theta, "theta", ANY);
    if (rows.rows > parameters.count() || at.size() < rows.rows)
        throw py::value_error("theta, root: expected parameters, and no more rows");
    return to_python(parameters.steps(at.data, rows));
}

Array bounded(const Parameters& parameters, const Array& z, const Array& root, std::size_t first) {
    Vector found = vector(z, "z", ANY);
    const View whole = checked(root, "root", py::ssize_t(found.size()), ANY);
    if (first > whole.rows || whole.rows - first < parameters.count())
        throw py::value_error("first: expected that of the parameters");
    parameters.bound(found, whole, first);
    return to_python(found);
}

Family family_of(const std::shared_ptr<FreeMotion>& motion, const Sizes& sizes,
                 const Parameters& parameters, const Array& nominal, const py::sequence& lower,
                 const Array& rate) {
    const std::size_t n = motion->n();
    if (sizes.modes.rows != n) throw py::value_error("sizes: of another system");
    Family found{motion, sizes, parameters, {}, {}, vector(rate, "rate", ANY)};
    found.nominal = vector(nominal, "nominal", py::ssize_t(parameters.count()));
    for (const auto& each : lower)
        found.lower.push_back(matrix(py::cast<Array>(each), "lower", n, 2 * n));
    if (found.rate.size() != found.moving() || parameters.moving != found.moving())
        throw py::value_error("lower, rate: expected one of each parameter of the motion");
    for (const double each : found.rate) positive(each, "rate");
    return found;
}

Impact impact_of(const std::shared_ptr<Family>& family, const Array& w, const Array& kick,
                 double rest, const Array& kicks, const Array& rests, const Array& lags) {
    const std::size_t n = family->given->n(), p = family->count();
    if (!std::isfinite(rest)) throw py::value_error("rest: not finite");
    return {family,
            vector(w, "w", py::ssize_t(n)),
            vector(kick, "kick", py::ssize_t(n)),
            rest,
            matrix(kicks, "kicks", p, n),
            vector(rests, "rests", py::ssize_t(p)),
            vector(lags, "lags", py::ssize_t(p))};
}

Map map_from(const py::object& given, std::size_t k, std::size_t d) {
    const auto both = given.cast<py::tuple>();
    if (both.size() < 2) throw py::value_error("at: expected a value and a linear map");
    const auto value = py::cast<Array>(both[0]), linear = py::cast<Array>(both[1]);
    const View rows =
        checked(linear, "linear", k ? py::ssize_t(k) : ANY, k ? py::ssize_t(d) : ANY);
    return {vector(value, "value", py::ssize_t(rows.rows)), Matrix(rows)};
}

Sensitivity sensitivity_of(const py::function& at, const Array& theta, const Array& steps) {
    const Vector about = vector(theta, "theta", ANY);
    const Vector wide = vector(steps, "steps", py::ssize_t(about.size()));
    for (const double each : wide)
        if (!(each >= 0)) throw py::value_error("steps: expected 0 or more");
    std::size_t k = 0, d = 0;
    const auto map = [&](const Vector& point) {
        Map found = map_from(at(to_python(point)), k, d);
        k = found.linear.rows, d = found.linear.columns;
        return found;
    };
    return {map, about, wide};
}

Array noise_of(const Sensitivity& by, const Array& root, const Array& own) {
    const std::size_t p = by.first.rows;
    const View states = checked(root, "root", p ? py::ssize_t(by.size) : ANY, ANY);
    const View steps = checked(own, "own", py::ssize_t(p), py::ssize_t(states.columns));
    if (states.columns < p) throw py::value_error("root: expected a column of each parameter");
    return to_python(by.noise(states, steps));
}

Array leading_of(const Array& root, std::size_t first, std::size_t count) {
    const View whole = checked(root, "root", ANY, ANY);
    if (count > whole.rows || first > whole.rows - count)
        throw py::value_error("first, count: expected rows of the root");
    return to_python(leading(whole, first, count));
}

// The arrays of states (x, constants, root, differences, ...), kept alive, and views of them.
struct Priors {
    std::vector<Array> kept;
    std::vector<Prior> priors;

    Priors(const py::sequence& states, const Array& clocks, const Family& family, bool has_clock) {
        const std::size_t count = states.size(), size = family.given->size();
        const View clock = checked(clocks, "clocks", py::ssize_t(has_clock ? count : 0));
        kept.reserve(4 * count);
        for (std::size_t b = 0; b < count; ++b) {
            const auto state = states[b].cast<py::tuple>();
            if (state.size() < 4) throw py::value_error("states: expected tuples of arrays");
            const View x = take(state[0], "x", py::ssize_t(size), 0);
            const View constants = take(state[1], "constants", ANY, 0);
            if (constants.size() < family.count())
                throw py::value_error("constants: expected the parameters first");
            const auto d = py::ssize_t(size + constants.size());
            const View root = take(state[2], "root", d, ANY);
            const View differences = take(state[3], "differences", d, ANY);
            const double deviation =
                has_clock ? clock[b] : std::numeric_limits<double>::infinity();
            if (deviation < 0) throw py::value_error("clocks: expected 0 or more");
            priors.push_back({x, constants, root, differences, deviation});
        }
    }

  private:
    // A vector where columns are 0.
    View take(const py::object& given, const char* name, py::ssize_t rows, py::ssize_t columns) {
        Array array = Array::ensure(given);
        if (!array) {
            PyErr_Clear();
            throw py::value_error(std::string(name) + ": expected an array of numbers");
        }
        kept.push_back(array);
        return columns ? checked(array, name, rows, columns) : checked(array, name, rows);
    }
};

double instant(double t, double flown) {
    if (!std::isfinite(t) || !std::isfinite(flown)) throw py::value_error("t: not finite");
    return t;
}

Array fits(const Impact& impact, double t, const py::sequence& states, const Array& clocks) {
    const Priors given(states, clocks, *impact.family, true);
    instant(t, 0.0);
    Matrix found(given.priors.size(), 3);
    {
        const py::gil_scoped_release released;
        for (std::size_t b = 0; b < given.priors.size(); ++b) {
            const Fit fit = impact.fit(t, given.priors[b]);
            found(b, 0) = fit.density;
            found(b, 1) = fit.normalised;
            found(b, 2) = fit.deviation;
        }
    }
    return to_python(found);
}

Array flat(const Matrix& m) {
    Array found(py::ssize_t(m.data.size()));
    std::copy(m.data.begin(), m.data.end(), found.mutable_data());
    return found;
}

py::tuple state_of(const Posterior& p) {
    return py::make_tuple(flat(p.x), flat(p.constants), to_python(p.root),
                          to_python(p.differences));
}

template <class Step>
py::list stepped(const Priors& given, Step step) {
    std::vector<Posterior> found(given.priors.size());
    {
        const py::gil_scoped_release released;
        for (std::size_t b = 0; b < found.size(); ++b) found[b] = step(given.priors[b]);
    }
    py::list states;
    for (const Posterior& each : found) states.append(state_of(each));
    return states;
}

// What an event says that is certainly an impact; None where it is not.
py::object clear(const Impact& impact, double t, double flown, const py::tuple& state,
                 const Array& clocks, const Array& doubts) {
    const View clock = checked(clocks, "clocks", ANY), by = checked(doubts, "doubts", 5);
    if (clock.size() == 0) throw py::value_error("clocks: expected the state's own first");
    for (std::size_t k = 0; k < clock.size(); ++k) positive(clock[k], "clocks");
    const Priors given(py::make_tuple(state), Array(py::ssize_t(1), clock.data), *impact.family,
                       true);
    instant(t, flown);
    Fit fit;
    const std::optional<Posterior> found =
        impact.clear(t, flown, given.priors[0], clock, {by[0], by[1], by[2], by[3], by[4]}, fit);
    if (!found) return py::none();
    return py::make_tuple(state_of(*found), fit.density, fit.normalised, fit.deviation);
}

py::list posteriors(const Impact& impact, double t, double flown, const py::sequence& states,
                    const Array& clocks) {
    instant(t, flown);
    const Priors given(states, clocks, *impact.family, true);
    return stepped(given, [&](const Prior& prior) { return impact.posterior(t, flown, prior); });
}

py::list missed(const Impact& impact, const Array& t, const py::sequence& states) {
    const Priors given(states, Array(py::ssize_t(0)), *impact.family, false);
    const View at = checked(t, "t", py::ssize_t(given.priors.size()));
    return stepped(given, [&](const Prior& prior) {
        return impact.missed(at[std::size_t(&prior - given.priors.data())], 0.0, prior);
    });
}

py::tuple moved(const FreeMotion& motion, double t, const Array& x, double s) {
    instant(t, s);
    if (!(std::abs(s) * motion.rate <= MOST_STEPS)) throw py::value_error("s: too long");
    const Vector after = motion.flown(t, vector(x, "x", py::ssize_t(motion.size())), s);
    return py::make_tuple(to_python(after), to_python(motion.transition(s)));
}

// A replica s seconds later, moved by `towards` for each unit by which a sample is larger than
// `row x + rest`; and the map of differences from it since they were noted.
py::tuple projected(const FreeMotion& motion, double t, double s, const Array& x, const Array& due,
                    const Array& row, double rest, const Array& towards, double value) {
    instant(t, s);
    if (!(std::abs(s) * motion.rate <= MOST_STEPS)) throw py::value_error("s: too long");
    if (!std::isfinite(rest + value)) throw py::value_error("rest, value: not finite");
    const auto size = py::ssize_t(motion.size());
    const Vector h = vector(row, "row", size), z = vector(towards, "towards", size);
    Vector at = motion.flown(t, vector(x, "x", size), s);
    const double innovation = value - (dot(h.data(), at.data(), h.size()) + rest);
    add(innovation, z.data(), at.data(), at.size());
    const View before = checked(due, "due", size, size);
    const Matrix Phi = motion.transition(s);
    Matrix after(h.size(), h.size());
    for (std::size_t i = 0; i < h.size(); ++i)
        for (std::size_t k = 0; k < h.size(); ++k)
            add(Phi(i, k), before.row(k), after.row(i), h.size());
    Vector seen(h.size());
    for (std::size_t i = 0; i < h.size(); ++i) add(h[i], after.row(i), seen.data(), h.size());
    for (std::size_t i = 0; i < h.size(); ++i) add(-z[i], seen.data(), after.row(i), h.size());
    Matrix state(1, h.size());
    state.data = at;
    return py::make_tuple(flat(state), to_python(after), innovation);
}

Gaps gaps_of(const std::shared_ptr<Family>& family, const Array& W, const Array& rest,
             const Array& rests) {
    const View rows = checked(W, "W", ANY, py::ssize_t(family->given->n()));
    return {family, Matrix(rows), vector(rest, "rest", py::ssize_t(rows.rows)),
            matrix(rests, "rests", family->count(), rows.rows)};
}

double duration_of(const Gaps& gaps, double t, double duration) {
    instant(t, duration);
    if (!(duration >= 0 && duration * gaps.motion->rate < 1e5))
        throw py::value_error("duration: expected 0 or more, and not too many periods");
    return duration;
}

// Flights of states, each from its own instant on.
struct Flights {
    Priors given;
    View t, s, level;

    Flights(const Gaps& gaps, const Array& starts, const Array& durations,
            const py::sequence& states, const Array& levels)
        : given(states, Array(py::ssize_t(0)), *gaps.family, false),
          t(checked(starts, "t", py::ssize_t(given.priors.size()))),
          s(checked(durations, "duration", py::ssize_t(given.priors.size()))),
          level(checked(levels, "levels", py::ssize_t(given.priors.size()))) {
        for (std::size_t b = 0; b < size(); ++b) duration_of(gaps, t[b], s[b]);
    }

    std::size_t size() const { return given.priors.size(); }

    // How many from b on share its flight.
    std::size_t alike(std::size_t b) const {
        std::size_t end = b;
        while (end < size() && t[end] == t[b] && s[end] == s[b]) ++end;
        return end - b;
    }
};

py::list list_of(const std::vector<Dip>& dips) {
    py::list found;
    for (const Dip& d : dips)
        found.append(py::make_tuple(d.contact, d.above, d.below, d.deepest, d.depth, d.unlikely,
                                    d.over, d.began));
    return found;
}

py::list dips(const Gaps& gaps, const Array& starts, const Array& durations,
              const py::sequence& states, const Array& levels) {
    const Flights flights(gaps, starts, durations, states, levels);
    std::vector<std::vector<Dip>> found(flights.size());
    {
        const py::gil_scoped_release released;
        const bool is_shared = gaps.family->moving() == 0;
        Gaps::Grid grid{};
        for (std::size_t b = 0; b < found.size(); ++b) {
            const Gaps own = gaps.of(flights.given.priors[b]);
            const bool is_same = b > 0 && flights.t[b] == grid.t && flights.s[b] == grid.duration;
            if (!(is_shared && is_same))
                grid = own.grid(flights.t[b], flights.s[b], is_shared ? flights.alike(b) : 1);
            found[b] = own.dips(grid, flights.given.priors[b], flights.level[b]);
        }
    }
    py::list each_state;
    for (const auto& some : found) each_state.append(list_of(some));
    return each_state;
}

py::list dips_along(const Array& s, const Array& values, const py::function& value,
                    const py::function& rounding, const py::function& deviation) {
    const Vector at = vector(s, "s", ANY);
    const View rows = checked(values, "values", py::ssize_t(at.size()), ANY);
    std::vector<Dip> found;
    for (std::size_t j = 0; j < rows.columns; ++j) {
        Vector own(at.size());
        for (std::size_t k = 0; k < own.size(); ++k) own[k] = rows(k, j);
        const auto of = [&](const py::function& function) {
            return [&, j](double t) { return function(j, t).template cast<double>(); };
        };
        const auto near = [&](std::size_t, double t) { return of(value)(t); };
        add_dips(found, j, at, std::move(own), near, of(rounding), of(deviation));
    }
    in_order(found);
    return list_of(found);
}

py::list flown(const Gaps& gaps, const Array& starts, const Array& durations,
               const py::sequence& states, const Array& levels, double declared) {
    const Flights flights(gaps, starts, durations, states, levels);
    positive(declared, "declared");
    Gaps::Flight flight{-1.0, {}, {}};
    return stepped(flights.given, [&](const Prior& prior) {
        const auto b = std::size_t(&prior - flights.given.priors.data());
        const double t = flights.t[b], s = flights.s[b];
        if (s != flight.s) flight = {s, {}, {}};
        const Gaps own = gaps.of(prior);
        const Vector x =
            own.motion->flown(t, Vector(prior.x.data, prior.x.data + prior.x.rows), s);
        const double level = s > 0 ? std::hypot(declared, flights.level[b]) : 0.0;
        return own.after(t, prior, x, level, flight);
    });
}

double root_between(const py::function& function, double above, double below) {
    const auto value = [&](double s) { return function(s).cast<double>(); };
    return falls_at(value, above, below, 4 * EPS);
}

Sample sample_of(Vector row, double rest, double value, double noise, double gate) {
    if (!(noise > 0 && gate > 0 && std::isfinite(noise) && std::isfinite(rest + value)))
        throw py::value_error("noise, gate: expected positive numbers; rest, value: finite ones");
    return {std::move(row), rest, value, noise, gate};
}

py::tuple tuple_of(const Followed& found) {
    const Posterior& state = found.state;
    return py::make_tuple(flat(state.x), flat(state.constants), to_python(state.root),
                          to_python(state.differences), found.innovation, found.normalised,
                          found.density, found.residual);
}

py::tuple measured(const Array& x, const Array& constants, const Array& root,
                   const Array& differences, const Array& row, double rest, double value,
                   double noise, double gate) {
    const Vector about = vector(x, "x", ANY), beside = vector(constants, "constants", ANY);
    const auto d = py::ssize_t(about.size() + beside.size());
    Posterior prior{Matrix(1, about.size()), Matrix(1, beside.size()),
                    Matrix(checked(root, "root", d, ANY)),
                    Matrix(checked(differences, "differences", d, ANY))};
    prior.x.data = about, prior.constants.data = beside;
    const Vector by = vector(row, "row", ANY);
    if (by.size() < about.size() || by.size() > prior.root.rows)
        throw py::value_error("row: expected a number of each of the state, and of constants");
    return tuple_of(Gaps::updated(sample_of(by, rest, value, noise, gate), std::move(prior)));
}

py::object followed(const Gaps& gaps, double t, double s, const py::sequence& states,
                    const Array& levels, double declared, const Array& row, double rest,
                    double value, double noise, double gate, bool searches) {
    duration_of(gaps, t, s);
    if (gaps.family->count()) throw py::value_error("states: not with parameters");
    const Priors given(states, Array(py::ssize_t(0)), *gaps.family, false);
    const View level = checked(levels, "levels", py::ssize_t(given.priors.size()));
    const Sample sample =
        sample_of(vector(row, "row", py::ssize_t(gaps.motion->size())), rest, value, noise, gate);
    positive(declared, "declared");
    std::vector<Followed> found;
    {
        const py::gil_scoped_release released;
        found = gaps.followed(t, s, given.priors, level, declared, sample, searches);
    }
    if (found.size() < given.priors.size()) return py::none();
    py::list each_state;
    for (const Followed& each : found) each_state.append(tuple_of(each));
    return each_state;
}

double root_of(const Gaps& gaps, double t, const py::tuple& state, double level,
               std::size_t contact, double above, double below, double depth) {
    const Priors given(py::make_tuple(state), Array(py::ssize_t(0)), *gaps.family, false);
    if (contact >= gaps.W.rows) throw py::value_error("contact: there is none of this number");
    if (!(above <= below && std::isfinite(depth) && level >= 0 && std::isfinite(level)))
        throw py::value_error("above, below, depth, level: expected finite numbers in order");
    duration_of(gaps, t, above);
    duration_of(gaps, t, below);
    const py::gil_scoped_release released;
    return gaps.of(given.priors[0]).root(t, given.priors[0], level, contact, above, below, depth);
}

// The largest d^T metric d between two of the columns, or one of them and zero; NaN where the
// numbers overflow.
double largest_distance(const Array& columns, const Array& metric) {
    const View given = checked(columns, "columns", ANY, ANY);
    const std::size_t size = given.rows, count = given.columns;
    const View weights = checked(metric, "metric", py::ssize_t(size), py::ssize_t(size));
    Matrix one(count + 1, size), seen(count + 1, size);  // the last one is zero
    for (std::size_t k = 0; k < count; ++k)
        for (std::size_t i = 0; i < size; ++i) {
            one(k, i) = given(i, k);
            add(given(i, k), weights.row(i), seen.row(k), size);
        }
    double found = 0.0;
    for (std::size_t k = 0; k <= count; ++k)
        for (std::size_t j = 0; j < k; ++j) {
            double square = 0.0;
            for (std::size_t i = 0; i < size; ++i)
                square += (one(k, i) - one(j, i)) * (seen(k, i) - seen(j, i));
            if (!(square <= found)) found = square;
        }
    return found;
}

Array rates_of(const FreeMotion& motion, double t, const Array& x) {
    instant(t, 0.0);
    Vector found = motion.rates(vector(x, "x", py::ssize_t(motion.size())));
    motion.force(t, 0, 1.0, found);
    return to_python(found);
}

Array member_rates(const Family& family, double t, const Array& x, const Array& theta) {
    const Vector at = vector(theta, "theta", py::ssize_t(family.count()));
    return rates_of(*family.at(at.data()), t, x);
}

Array diffusion(const FreeMotion& motion, double s) {
    if (!(s >= 0 && s * motion.rate < 1e15))
        throw py::value_error("s: expected 0 or more, not long");
    const py::gil_scoped_release released;
    Matrix found = motion.diffusion(s);
    const py::gil_scoped_acquire acquired;
    return to_python(found);
}

}  // namespace

void bind_estimation(py::module_& module) {
    py::class_<FreeMotion, std::shared_ptr<FreeMotion>>(
        module, "FreeMotion", "Motion between impacts: du/dt = lower x + forces.")
        .def(py::init(&motion_of), py::arg("lower"), py::arg("constant"), py::arg("frequency"),
             py::arg("cosine"), py::arg("sine"), py::arg("rate"), py::arg("decay"))
        .def("rates", &rates_of, py::arg("t"), py::arg("x"), "dx/dt of a state x at t.")
        .def("diffusion", &diffusion, py::arg("s"),
             "A square root of what white accelerations of 1 m/s^1.5 add in s seconds.")
        .def("projected", &projected, py::arg("t"), py::arg("s"), py::arg("x"), py::arg("due"),
             py::arg("row"), py::arg("rest"), py::arg("towards"), py::arg("value"),
             "A replica s seconds after t, moved towards a sample; the map of differences, and the"
             "\ninnovation.")
        .def("moved", &moved, py::arg("t"), py::arg("x"), py::arg("s"),
             "The state s seconds after x at t, and its derivative by x: for short times.");
    py::class_<Sizes>(module, "Sizes", "What states are rounded against; see dynamics.sizes.")
        .def(py::init(&sizes_of), py::arg("modes"), py::arg("spread"), py::arg("squares"),
             py::arg("timescale"));
    py::class_<Parameters>(module, "Parameters", "Parameters that are estimated.")
        .def(py::init(&parameters_of), py::arg("low"), py::arg("high"), py::arg("size"),
             py::arg("moving"))
        .def("steps", &steps_of, py::arg("theta"), py::arg("root"),
             "Steps of finite differences by the first parameters, a row of root each.")
        .def("bounded", &bounded, py::arg("z"), py::arg("root"), py::arg("first"),
             "An estimate z with its parameters, from z[first] on, within their bounds; all else\n"
             "moves to its conditional mean. root is one of the covariance of z.");
    py::class_<Family, std::shared_ptr<Family>>(
        module, "Family", "Systems whose accelerations are linear in parameters.")
        .def(py::init(&family_of), py::arg("motion"), py::arg("sizes"), py::arg("parameters"),
             py::arg("nominal"), py::arg("lower"), py::arg("rate"))
        .def("rates", &member_rates, py::arg("t"), py::arg("x"), py::arg("theta"),
             "dx/dt of a state x at t, of the member with the parameters theta.");
    py::class_<Sensitivity>(module, "Sensitivity", "How a map changes with parameters.")
        .def(py::init(&sensitivity_of), py::arg("at"), py::arg("theta"), py::arg("steps"))
        .def_property_readonly(
            "first", [](const Sensitivity& by) { return to_python(by.first); },
            "Derivatives of its value, shape (p, k).")
        .def("noise", &noise_of, py::arg("root"), py::arg("own"),
             "What parameters add in second order to the error of a state, (k, any).");
    module.def("leading", &leading_of, py::arg("root"), py::arg("first"), py::arg("count"),
               "The same covariance's root with count rows lower triangular in front.");
    py::class_<Impact>(module, "Impact", "An impact of one contact while none is closed.")
        .def(py::init(&impact_of), py::arg("family"), py::arg("w"), py::arg("kick"),
             py::arg("rest"), py::arg("kicks"), py::arg("rests"), py::arg("lags"))
        .def("fits", &fits, py::arg("t"), py::arg("states"), py::arg("clocks"),
             "For each state: logarithm of the density of the instant, 1/s; innovation, in "
             "standard\n"
             "deviations; and its standard deviation, m: shape (states, 3).")
        .def("posteriors", &posteriors, py::arg("t"), py::arg("flown"), py::arg("states"),
             py::arg("clocks"), "The states after the impact, at its stamp t.")
        .def("clear", &clear, py::arg("t"), py::arg("flown"), py::arg("state"), py::arg("clocks"),
             py::arg("doubts"),
             "The state after an event that can be nothing else, and how it fits; else None.\n"
             "clocks has the state's own first; doubts: see Doubts in kalman.hpp.")
        .def("missed", &missed, py::arg("t"), py::arg("states"),
             "The same where it was not reported, each near its zero t of the gap.");
    module.def("dips_along", &dips_along, py::arg("s"), py::arg("values"), py::arg("value"),
               py::arg("rounding"), py::arg("deviation"),
               "Where functions of time are negative, as Gaps.dips but for where that began: of\n"
               "their values at the samples s, and of what the last arguments find for (j, s).");
    module.def("falls_at", &root_between, py::arg("function"), py::arg("above"), py::arg("below"),
               "Where a function of time falls through zero, between instants where it is above\n"
               "and below; the latter where it does not.");
    module.def("measured", &measured, py::arg("x"), py::arg("constants"), py::arg("root"),
               py::arg("differences"), py::arg("row"), py::arg("rest"), py::arg("value"),
               py::arg("noise"), py::arg("gate"),
               "A state corrected by a sample; see Gaps.followed.");
    module.def("largest_distance", &largest_distance, py::arg("columns"), py::arg("metric"),
               "The largest d^T metric d between two columns, or one of them and zero.");
    py::class_<Gaps>(module, "Gaps", "Predicted gaps while no contact is closed.")
        .def(py::init(&gaps_of), py::arg("family"), py::arg("W"), py::arg("rest"),
             py::arg("rests"))
        .def("dips", &dips, py::arg("t"), py::arg("duration"), py::arg("states"),
             py::arg("levels"),
             "Where gaps are negative, for each state from its own t on: contact, above, below,\n"
             "deepest, depth, unlikely, over, began; see Dip in gaps.hpp.")
        .def("flown", &flown, py::arg("t"), py::arg("s"), py::arg("states"), py::arg("levels"),
             py::arg("declared"), "Each state s seconds after its t, with white accelerations.")
        .def("followed", &followed, py::arg("t"), py::arg("s"), py::arg("states"),
             py::arg("levels"), py::arg("declared"), py::arg("row"), py::arg("rest"),
             py::arg("value"), py::arg("noise"), py::arg("gate"), py::arg("searches").noconvert(),
             "States s seconds after t, corrected by a sample then: x, constants, root,\n"
             "differences, innovation, normalised, density, residual. None where a gap is "
             "negative.")
        .def("root", &root_of, py::arg("t"), py::arg("state"), py::arg("level"),
             py::arg("contact"), py::arg("above"), py::arg("below"), py::arg("depth") = 0.0,
             "Where a gap plus depth deviations falls through zero, s.");
}
