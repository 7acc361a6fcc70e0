// SPDX-License-Identifier: Apache-2.0

// The module impact_observer.kernel._kernel, for the filter of impact times: checks arguments and
// calls the headers.
#include <pybind11/functional.h>

#include "arrays.hpp"
#include "gaps.hpp"

using namespace kernel;
using namespace kernel::kalman;

namespace {

// The arrays of a state (x, constants, root, differences, ...).
struct StateArrays {
    Array x, constants, root, differences;
};
using StateList = std::vector<StateArrays>;
using IndexedFunction =
    std::function<double(std::size_t, double)>;  // of a function, and an instant

}  // namespace

namespace pybind11::detail {

template <>
struct type_caster<StateArrays> {
    PYBIND11_TYPE_CASTER(StateArrays, const_name("tuple"));
    bool load(handle given, bool) {
        if (!isinstance<tuple>(given) || len(given) < 4)
            throw value_error("states: expected tuples (x, constants, root, differences)");
        const auto fields = reinterpret_borrow<tuple>(given);
        const char* names[] = {"x", "constants", "root", "differences"};
        Array* const parts[] = {&value.x, &value.constants, &value.root, &value.differences};
        for (std::size_t k = 0; k < 4; ++k)
            if (!(*parts[k] = Array::ensure(fields[k])))
                throw value_error(names[k] + std::string(": expected an array of numbers"));
        return true;
    }
};

}  // namespace pybind11::detail

namespace {

double positive(double value, const char* name) {
    if (!(finite(value, name) >= 0)) throw py::value_error(std::string(name) + ": negative");
    return value;
}

FreeMotion motion_of(const Array& lower, const Array& constant, const Array& frequency,
                     const Array& cosine, const Array& sine, double rate, double decay) {
    const MatrixView whole = checked(lower, "lower", ANY, ANY);
    const std::size_t n = whole.rows;
    expect(n > 0 && whole.columns == 2 * n, "lower: expected shape (n, 2n)");
    const MatrixView omega = checked(frequency, "frequency", ANY);
    FreeMotion motion{whole,
                      checked(constant, "constant", n),
                      checked(cosine, "cosine", omega.size(), n),
                      checked(sine, "sine", omega.size(), n),
                      omega,
                      std::max(positive(rate, "rate"), TINY),
                      positive(decay, "decay")};
    motion.prepare();
    return motion;
}

Sizes sizes_of(const Array& modes, const Array& spread, const Array& squares, double timescale) {
    const std::size_t n = checked(squares, "squares", ANY).size();
    return {checked(modes, "modes", n, n), checked(spread, "spread", n, n),
            checked(squares, "squares", n), positive(timescale, "timescale")};
}

Parameters parameters_of(const Array& low, const Array& high, const Array& size,
                         std::size_t moving, const std::vector<bool>& considered) {
    const std::size_t p = checked(low, "low", ANY).size();
    Parameters parameters{checked(low, "low", p), checked(high, "high", p),
                          checked(size, "size", p), moving, considered};
    expect(moving <= p, "moving: more than there are");
    expect(considered.size() == p, "considered: expected one of each parameter");
    for (std::size_t j = 0; j < p; ++j)
        expect(parameters.size[j] > 0 &&
                   parameters.high[j] - parameters.low[j] >= 2 * MARGIN * parameters.size[j],
               "low, high, size: expected bounds, and positive sizes");
    return parameters;
}

Vector steps(const Parameters& parameters, const Array& theta, const Array& root,
             const Array& differences) {
    const MatrixView rows = checked(root, "root", ANY, ANY), at = checked(theta, "theta", ANY);
    expect(rows.rows <= parameters.count() && at.size() >= rows.rows,
           "theta, root: expected parameters, and no more rows");
    return parameters.steps(at, rows, checked(differences, "differences", rows.rows, ANY));
}

// An estimate z with its parameters, from z[first] on, within their bounds; `root` is one of the
// covariance of z.
Vector bounded(const Parameters& parameters, const Array& z, const Array& root,
               std::size_t first) {
    Vector estimate = checked(z, "z", ANY);
    const MatrixView whole = checked(root, "root", estimate.size(), ANY);
    expect(first <= whole.rows && whole.rows - first >= parameters.count(),
           "first: expected that of the parameters");
    parameters.clamp_estimate(estimate, whole, first);
    return estimate;
}

Family family_of(const std::shared_ptr<FreeMotion>& motion, const Sizes& sizes,
                 const Parameters& parameters, const Array& nominal,
                 const std::vector<MotionChange>& changes) {
    expect(sizes.modes.rows == motion->n(), "sizes: of another system");
    expect(changes.size() == parameters.moving, "changes: expected one of each parameter");
    for (const MotionChange& each : changes)
        expect(each.constant.size() == motion->n() &&
                   each.frequency.size() == motion->frequency.size(),
               "changes: of another system");
    return {motion, sizes, parameters, checked(nominal, "nominal", parameters.count()), changes};
}

MotionChange motion_change_of(const Array& lower, const Array& constant, const Array& frequency,
                              const Array& cosine, const Array& sine, double rate) {
    const MatrixView omega = checked(frequency, "frequency", ANY);
    const std::size_t n = checked(constant, "constant", ANY).size(), h = omega.size();
    return {checked(lower, "lower", n, 2 * n),
            checked(constant, "constant", n),
            checked(cosine, "cosine", h, n),
            checked(sine, "sine", h, n),
            omega,
            positive(rate, "rate")};
}

Impact impact_of(const std::shared_ptr<Family>& family, const Array& w, const Array& kick,
                 double rest, const Array& kicks, const Array& rests, const Array& lags) {
    const std::size_t n = family->given->n(), p = family->count();
    return {family,
            checked(w, "w", n),
            checked(kick, "kick", n),
            finite(rest, "rest"),
            checked(kicks, "kicks", p, n),
            checked(rests, "rests", p),
            checked(lags, "lags", p)};
}

Gaps gaps_of(const std::shared_ptr<Family>& family, const Array& W, const Array& rest,
             const Array& rests) {
    const MatrixView rows = checked(W, "W", ANY, family->given->n());
    return {family, rows, checked(rest, "rest", rows.rows),
            checked(rests, "rests", family->count(), rows.rows)};
}

// A map at some parameters: a value, k numbers, and a linear map, k x d.
AffineMap map_at(const py::function& function, const Vector& theta, std::size_t k, std::size_t d) {
    const auto both = function(theta).cast<py::tuple>();
    expect(both.size() >= 2, "at: expected a value and a linear map");
    const auto value = py::cast<Array>(both[0]), linear = py::cast<Array>(both[1]);
    const MatrixView rows = checked(linear, "linear", k, d);
    return {checked(value, "value", rows.rows), rows};
}

Sensitivity sensitivity_of(const py::function& function, const Array& theta, const Array& steps) {
    const MatrixView about = checked(theta, "theta", ANY),
                     wide = checked(steps, "steps", about.size());
    for (std::size_t j = 0; j < wide.size(); ++j) positive(wide[j], "steps");
    std::size_t k = ANY, d = ANY;
    const auto map = [&](const Vector& point) {
        AffineMap image = map_at(function, point, k, d);
        k = image.linear.rows, d = image.linear.columns;
        return image;
    };
    return {map, [&](const Vector& point) { return map(point).value; }, about, wide};
}

Matrix noise(const Sensitivity& by, const Array& root, const Array& own) {
    const std::size_t p = by.first.rows;
    const MatrixView states = checked(root, "root", p ? by.size : ANY, ANY);
    expect(states.columns >= p, "root: expected a column of each parameter");
    return by.noise(states, checked(own, "own", p, states.columns));
}

Matrix leading_of(const Array& root, std::size_t first, std::size_t count) {
    const MatrixView whole = checked(root, "root", ANY, ANY);
    expect(count <= whole.rows && first <= whole.rows - count,
           "first, count: expected rows of the root");
    return leading(whole, first, count);
}

Prior prior_of(const StateArrays& state, const Family& family) {
    const std::size_t size = family.given->size();
    const MatrixView constants = checked(state.constants, "constants", ANY);
    const std::size_t d = size + constants.size();
    expect(constants.size() >= family.count(), "constants: expected the parameters first");
    return {checked(state.x, "x", size), constants, checked(state.root, "root", d, ANY),
            checked(state.differences, "differences", d, ANY), INFINITY};
}

std::vector<Prior> priors_of(const StateList& states, const Family& family) {
    std::vector<Prior> priors;
    for (const StateArrays& each : states) priors.push_back(prior_of(each, family));
    return priors;
}

std::vector<Prior> priors_of(const StateList& states, const Family& family, const Array& clocks) {
    std::vector<Prior> priors = priors_of(states, family);
    const MatrixView deviations = checked(clocks, "clocks", priors.size());
    for (std::size_t b = 0; b < priors.size(); ++b)
        priors[b].clock = positive(deviations[b], "clocks");
    return priors;
}

// For each state: logarithm of the density of the instant, 1/s; innovation, in standard
// deviations; and its standard deviation, m.
Matrix fits(const Impact& impact, double t, const StateList& states, const Array& clocks) {
    finite(t, "t");
    const auto priors = priors_of(states, *impact.family, clocks);
    Matrix rows(priors.size(), 3);
    for (std::size_t b = 0; b < priors.size(); ++b) {
        const Fit fit = impact.fit(t, priors[b]);
        rows(b, 0) = fit.density, rows(b, 1) = fit.normalised, rows(b, 2) = fit.deviation;
    }
    return rows;
}

// The states after the impact, at its stamp t.
std::vector<Posterior> posteriors(const Impact& impact, double t, double flown,
                                  const StateList& states, const Array& clocks) {
    finite(t + flown, "t, flown");
    std::vector<Posterior> after;
    for (const Prior& prior : priors_of(states, *impact.family, clocks))
        after.push_back(impact.posterior(t, flown, prior));
    return after;
}

// The states after an impact that was not reported; each is near its zero t of the gap.
std::vector<Posterior> missed(const Impact& impact, const Array& t, const StateList& states) {
    const MatrixView at = checked(t, "t", states.size());
    std::vector<Posterior> after;
    for (const Prior& prior : priors_of(states, *impact.family))
        after.push_back(impact.missed(at[after.size()], 0.0, prior));
    return after;
}

// The state s seconds after x at t, and its derivative by x: for short times.
std::pair<Vector, Matrix> moved(const FreeMotion& motion, double t, const Array& x, double s) {
    expect(std::abs(s) * motion.rate <= MOST_STEPS, "s: too long");
    return {motion.state_after(finite(t, "t"), checked(x, "x", motion.size()), s),
            motion.transition(s)};
}

double duration_of(const Gaps& gaps, double t, double duration) {
    finite(t, "t");
    expect(duration >= 0 && duration * gaps.motion->rate < 1e5,
           "duration: expected 0 or more, and not too many periods");
    return duration;
}

// States, each with its own flight: from when on, how long, and the level of its accelerations.
std::vector<FlyingState> flights_of(const Gaps& gaps, const Array& t, const Array& s,
                                    const StateList& states, const Array& levels) {
    const MatrixView starts = checked(t, "t", states.size()),
                     lasting = checked(s, "s", states.size());
    const MatrixView level = checked(levels, "levels", states.size());
    std::vector<FlyingState> flights;
    for (std::size_t b = 0; b < states.size(); ++b)
        flights.push_back({prior_of(states[b], *gaps.family), starts[b],
                           duration_of(gaps, starts[b], lasting[b]), level[b]});
    return flights;
}

// Where gaps are negative, for each state from its own t on.
std::vector<std::vector<NegativeInterval>> negative_intervals(const Gaps& gaps, const Array& t,
                                                              const Array& duration,
                                                              const StateList& states,
                                                              const Array& levels) {
    return gaps.negative_intervals(flights_of(gaps, t, duration, states, levels));
}

// Each state s seconds after its t, with white accelerations.
std::vector<Posterior> states_after_flights(const Gaps& gaps, const Array& t, const Array& s,
                                            const StateList& states, const Array& levels,
                                            double declared) {
    return gaps.fly(flights_of(gaps, t, s, states, levels), positive(declared, "declared"));
}

// Where functions of time are negative, of their values at the samples s, and of what the last
// arguments find for a function and an instant.
std::vector<NegativeInterval> dips_along(const Array& s, const Array& values,
                                         const IndexedFunction& value,
                                         const IndexedFunction& rounding,
                                         const IndexedFunction& deviation) {
    const Vector at = checked(s, "s", ANY);
    const Matrix rows = transposed(checked(values, "values", at.size(), ANY));
    std::vector<NegativeInterval> intervals;
    for (std::size_t j = 0; j < rows.rows; ++j) {
        const auto indexed = [j](const IndexedFunction& place) {
            return [&place, j](double t) { return place(j, t); };
        };
        const auto near = [&](std::size_t, double t) { return value(j, t); };
        add_negative_intervals(intervals, j, at, rows.row(j), near, indexed(rounding),
                               indexed(deviation));
    }
    for (NegativeInterval& dip : intervals)
        dip.began = falls_at([&](double t) { return value(dip.contact, t); }, dip.above, dip.below,
                             4 * EPS);
    in_order(intervals);
    return intervals;
}

// Where a function of time falls through zero, between instants where it is above and below; the
// latter where it does not.
double root_between(const std::function<double(double)>& function, double above, double below) {
    return falls_at(function, above, below, 4 * EPS);
}

LinearMeasurement sample_of(const Array& row, std::size_t size, double rest, double value,
                            double noise, double gate) {
    expect(noise > 0 && gate > 0, "noise, gate: expected positive numbers");
    return {checked(row, "row", size), finite(rest, "rest"), finite(value, "value"),
            finite(noise, "noise"), gate};
}

// A state corrected by a sample.
CorrectedState measured(const Array& x, const Array& constants, const Array& root,
                        const Array& differences, const Array& row, double rest, double value,
                        double noise, double gate, const Parameters& parameters) {
    const MatrixView about = checked(x, "x", ANY), beside = checked(constants, "constants", ANY);
    const std::size_t d = about.size() + beside.size();
    LinearMeasurement sample = sample_of(row, ANY, rest, value, noise, gate);
    expect(sample.row.size() >= about.size() && sample.row.size() <= d,
           "row: expected a number of each of the state, and of constants");
    return Gaps::updated(sample,
                         {about, beside, checked(root, "root", d, ANY),
                          checked(differences, "differences", d, ANY)},
                         parameters);
}

// States s seconds after t, corrected by a sample then. None where a gap is negative.
std::optional<std::vector<CorrectedState>> followed(const Gaps& gaps, double t, double s,
                                                    const StateList& states, const Array& levels,
                                                    double declared, const Array& row, double rest,
                                                    double value, double noise, double gate,
                                                    bool searches) {
    expect(gaps.family->count() == 0, "states: not with parameters");
    const LinearMeasurement sample = sample_of(row, gaps.motion->size(), rest, value, noise, gate);
    return gaps.followed(t, duration_of(gaps, t, s), priors_of(states, *gaps.family),
                         checked(levels, "levels", states.size()), positive(declared, "declared"),
                         sample, searches);
}

// Where a gap plus depth deviations falls through zero, s.
double root(const Gaps& gaps, double t, const StateArrays& state, double level,
            std::size_t contact, double above, double below, double depth) {
    expect(contact < gaps.W.rows, "contact: there is none of this number");
    expect(above <= below, "above, below: expected in order");
    duration_of(gaps, t, above), duration_of(gaps, t, below);
    const Prior prior = prior_of(state, *gaps.family);
    return gaps.member_gaps(prior).root(t, prior, positive(level, "level"), contact, above, below,
                                        finite(depth, "depth"));
}

// x^T metric x; and the largest d^T metric d between two of the columns, or one of them and zero.
// NaN where the numbers overflow.
std::pair<double, double> sizes_by(const Array& metric, const Array& x, const Array& columns) {
    const MatrixView given = checked(columns, "columns", ANY, ANY);
    const std::size_t size = given.rows, count = given.columns;
    const MatrixView weights = checked(metric, "metric", size, size),
                     state = checked(x, "x", size);
    Matrix one(count + 1, size), seen(count + 1, size);  // the last one is zero
    for (std::size_t k = 0; k < count; ++k)
        for (std::size_t i = 0; i < size; ++i) {
            one(k, i) = given(i, k);
            add_scaled(given(i, k), weights.row(i), seen.row(k));
        }
    double own = 0.0, largest = 0.0;
    for (std::size_t i = 0; i < size; ++i) own += state[i] * dot(weights.row(i), state);
    for (std::size_t k = 0; k <= count; ++k)
        for (std::size_t j = 0; j < k; ++j) {
            double square = 0.0;
            for (std::size_t i = 0; i < size; ++i)
                square += (one(k, i) - one(j, i)) * (seen(k, i) - seen(j, i));
            if (!(square <= largest)) largest = square;
        }
    return {own, largest};
}

// dx/dt of a state x at t.
Vector rates(const FreeMotion& motion, double t, const Array& x) {
    Vector derivative = motion.rates(checked(x, "x", motion.size()));
    motion.force(finite(t, "t"), 0, 1.0, derivative);
    return derivative;
}

// dx/dt of the member with the parameters theta.
Vector member_rates(const Family& family, double t, const Array& x, const Array& theta) {
    return rates(*family.member(checked(theta, "theta", family.count())), t, x);
}

// A square root of what white accelerations of 1 m/s^1.5 add in s seconds.
Matrix diffusion(const FreeMotion& motion, double s) {
    expect(s >= 0 && s * motion.rate < 1e15, "s: expected 0 or more, not long");
    return motion.diffusion(s);
}

}  // namespace

PYBIND11_MODULE(_kernel, module) {
    module.attr("SOURCES") = KERNEL_CHECKSUM;  // setup.py: of the files it was compiled from
    module.attr("TINY") = TINY;
    module.attr("SETTLED") = SETTLED;
    module.attr("CLOSING") = CLOSING;
    module.attr("BACK") = BACK;
    module.attr("MOST_STEPS") = MOST_STEPS;
    module.attr("SLOWEST") = SLOWEST;
    module.attr("TIME_SHARE") = TIME_SHARE;
    module.attr("ROUNDS") = ROUNDS;
    module.attr("FINE") = FINE;
    module.attr("FINER") = FINER;
    module.attr("MOST_SAMPLES") = int(MOST_SAMPLES);
    const auto family = "family"_a.none(false);
    module.def("log_mean_positive", &log_mean_positive, "mean"_a, "deviation"_a);
    module.def("leading", &leading_of, "root"_a, "first"_a, "count"_a);
    module.def("dips_along", &dips_along, "s"_a, "values"_a, "value"_a, "rounding"_a,
               "deviation"_a);
    module.def("falls_at", &root_between, "function"_a, "above"_a, "below"_a);
    module.def("measured", &measured, "x"_a, "constants"_a, "root"_a, "differences"_a, "row"_a,
               "rest"_a, "value"_a, "noise"_a, "gate"_a, "parameters"_a);
    module.def("sizes_by", &sizes_by, "metric"_a, "x"_a, "columns"_a);
    py::class_<FreeMotion, std::shared_ptr<FreeMotion>>(module, "FreeMotion")
        .def(py::init(&motion_of), "lower"_a, "constant"_a, "frequency"_a, "cosine"_a, "sine"_a,
             "rate"_a, "decay"_a)
        .def("rates", &rates, "t"_a, "x"_a)
        .def("diffusion", &diffusion, "s"_a, Released())
        .def("moved", &moved, "t"_a, "x"_a, "s"_a);
    py::class_<Sizes>(module, "Sizes")
        .def(py::init(&sizes_of), "modes"_a, "spread"_a, "squares"_a, "timescale"_a);
    py::class_<Parameters>(module, "Parameters")
        .def(py::init(&parameters_of), "low"_a, "high"_a, "size"_a, "moving"_a, "considered"_a)
        .def("steps", &steps, "theta"_a, "root"_a, "differences"_a)
        .def("bounded", &bounded, "z"_a, "root"_a, "first"_a);
    py::class_<MotionChange>(module, "MotionChange")
        .def(py::init(&motion_change_of), "lower"_a, "constant"_a, "frequency"_a, "cosine"_a,
             "sine"_a, "rate"_a);
    py::class_<Family, std::shared_ptr<Family>>(module, "Family")
        .def(py::init(&family_of), "motion"_a.none(false), "sizes"_a, "parameters"_a, "nominal"_a,
             "changes"_a)
        .def("rates", &member_rates, "t"_a, "x"_a, "theta"_a);
    py::class_<Sensitivity>(module, "Sensitivity")
        .def(py::init(&sensitivity_of), "at"_a, "theta"_a, "steps"_a)
        .def_property_readonly("first", [](const Sensitivity& by) { return by.first; })
        .def("noise", &noise, "root"_a, "own"_a);
    py::class_<Impact>(module, "Impact")
        .def(py::init(&impact_of), family, "w"_a, "kick"_a, "rest"_a, "kicks"_a, "rests"_a,
             "lags"_a)
        .def("fits", &fits, "t"_a, "states"_a, "clocks"_a, Released())
        .def("posteriors", &posteriors, "t"_a, "flown"_a, "states"_a, "clocks"_a, Released())
        .def("missed", &missed, "t"_a, "states"_a, Released());
    py::class_<Gaps>(module, "Gaps")
        .def(py::init(&gaps_of), family, "W"_a, "rest"_a, "rests"_a)
        .def("dips", &negative_intervals, "t"_a, "duration"_a, "states"_a, "levels"_a, Released())
        .def("flown", &states_after_flights, "t"_a, "s"_a, "states"_a, "levels"_a, "declared"_a,
             Released())
        .def("followed", &followed, "t"_a, "s"_a, "states"_a, "levels"_a, "declared"_a, "row"_a,
             "rest"_a, "value"_a, "noise"_a, "gate"_a, "searches"_a.noconvert(), Released())
        .def("root", &root, "t"_a, "state"_a, "level"_a, "contact"_a, "above"_a, "below"_a,
             "depth"_a = 0.0, Released());
}
