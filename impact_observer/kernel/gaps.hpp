// SPDX-License-Identifier: Apache-2.0

// Intervals in which predicted gaps are negative, while no contact is closed.
//
// The gap g (Baumann and Leine, ENOC 2014, equation (2)) of the plant is never negative. An impact
// was missed if a predicted gap falls below zero by more than its standard deviation explains.
#pragma once

#include "kalman.hpp"

namespace kernel::kalman {

// Where a function of time that is positive at `above` falls through zero on the way to `below`,
// forwards or back; `below` where it does not change its sign. Regula falsi in which an end that
// stays twice in a row counts half (Illinois), and halves where that is slow.
template <class Function>
double falls_at(const Function& value, double above, double below, double enough) {
    double low = above, high = below, at_low = value(low), at_high = value(high);
    if (!(at_low > 0 && 0 > at_high)) return below;
    double before = 0.0;
    for (int turn = 0; std::abs(high - low) > enough * std::abs(high) + 1e-15; ++turn) {
        const auto is_between = [&](double s) {
            return (low < s && s < high) || (high < s && s < low);
        };
        double s = low + (high - low) * (turn < 40 ? at_low / (at_low - at_high) : 0.5);
        if (!is_between(s)) s = low + (high - low) / 2;
        if (!is_between(s)) break;
        const double now = value(s);
        if (now > 0)
            low = s, at_low = now, at_high /= before > 0 ? 2 : 1;
        else
            high = s, at_high = now, at_low /= before < 0 ? 2 : 1;
        if (now == 0) break;
        before = now;
    }
    return high;
}

constexpr double FINE = 6.0;           // samples in the inverse of the fastest rate: 38 a period
constexpr double MOST_SAMPLES = 4096;  // of a flight; in a longer one their distance is larger
constexpr int FINER = 8;               // additional samples in the first interval
constexpr int MOST_INTERVALS = 32;     // of a gap in a flight, which may last for years
constexpr double SHALLOW = 8.0;        // depth of a dip that is rounding, in its deviations

// An interval in which a gap, or another function, is negative. Times are seconds after the start.
struct NegativeInterval {
    std::size_t contact;  // or which function
    double above, below;  // the last sample at which it is positive, the first where it is not
    double deepest;       // where it is deepest
    double depth;         // there, in standard deviations
    double unlikely;      // logarithm of the probability that an error of the estimate is so large
    bool over;            // whether it becomes positive again
    double began;         // where it becomes negative

    auto fields() const {
        return std::tie(contact, above, below, deepest, depth, unlikely, over, began);
    }
};

// A linear function of the state that is measured with noise.
struct LinearMeasurement {
    Vector row;  // by the state, and then by as many constants as it has more numbers
    double rest, value;
    double noise;  // its variance
    double gate;   // innovation from which on it is rejected, in standard deviations
};

// A state after a sample.
struct CorrectedState {
    Posterior state;
    double innovation, normalised;
    double density;  // logarithm of that of the sample, but for a constant

    auto fields() const {
        return std::tuple_cat(state.fields(), std::tie(innovation, normalised, density));
    }
};

// Adds the minima between samples of a function that are, or may be, below zero. `near` evaluates
// the function; its first argument is the index of the sample before.
template <class Near>
void add_minima(Vector& s, Vector& values, const Near& near) {
    Vector more_s, more;
    std::vector<std::size_t> where;
    for (std::size_t k = 1; k + 1 < s.size(); ++k) {
        const double falls = values[k] - values[k - 1], rises = values[k + 1] - values[k];
        if (!(falls <= 0 && rises >= 0)) continue;
        const double h = s[k] - s[k - 1], next = s[k + 1] - s[k];
        const double bend = std::max((rises / next - falls / h) / (h + next), 1e-15);
        const double slope = falls / h + bend * h;  // of the parabola, in the middle
        if (!(values[k] - slope * slope / (4 * bend) <= values[k] / 2)) continue;
        const double at = std::clamp(s[k] - slope / (2 * bend), s[k - 1], s[k + 1]);
        const std::size_t from = at < s[k] ? k - 1 : k;
        where.push_back(from + 1), more_s.push_back(at), more.push_back(near(from, at));
    }
    for (std::size_t i = where.size(); i-- > 0;) {
        s.insert(s.begin() + std::ptrdiff_t(where[i]), more_s[i]);
        values.insert(values.begin() + std::ptrdiff_t(where[i]), more[i]);
    }
}

// Adds the first negative intervals of a function with these values at the samples s, without
// their `began`. `rounding` and `deviation` are of its value at an instant.
template <class Near, class Rounding, class Deviation>
void add_negative_intervals(std::vector<NegativeInterval>& intervals, std::size_t which, Vector s,
                            Vector values, const Near& near, const Rounding& rounding,
                            const Deviation& deviation) {
    add_minima(s, values, near);
    int count = 0;
    for (std::size_t k = 0; k < s.size() && count < MOST_INTERVALS; ++k) {
        if (!(values[k] < 0)) continue;
        const std::size_t first = k;
        std::size_t lowest = k;
        for (; k < s.size() && values[k] < 0; ++k)
            if (values[k] < values[lowest]) lowest = k;
        // A function that rises from the start: the jump there was a little early.
        const double depth = -values[lowest] + (first ? 0.0 : std::min(values[0], 0.0));
        const double rounded = rounding(s[lowest]);
        if (depth <= SHALLOW * rounded) continue;
        const double deep = -values[lowest] / std::hypot(deviation(s[lowest]), rounded);
        intervals.push_back({which, s[first ? first - 1 : 0], s[first], s[lowest], deep,
                             log_normal(-deep), k < s.size(), 0.0});
        ++count;
    }
}

// Sorts intervals by their roots: the samples may be too far apart to order them.
inline void in_order(std::vector<NegativeInterval>& intervals) {
    std::stable_sort(
        intervals.begin(), intervals.end(),
        [](const NegativeInterval& a, const NegativeInterval& b) { return a.began < b.began; });
}

// A state and its flight: t, s, and the level of white accelerations, m/s^1.5.
struct FlyingState {
    Prior prior;
    double t, s, level;
};

class Gaps {
  public:
    std::shared_ptr<const Family> family;
    Matrix W;      // a row each contact, m x n
    Vector rest;   // gaps at rest, m
    Matrix rests;  // what a unit of each parameter adds to them, p x m
    std::shared_ptr<const FreeMotion> motion = family->given;

    // The gaps of the member with the parameters of this state.
    Gaps member_gaps(const Prior& prior) const {
        Gaps member = *this;
        member.motion = family->member(prior.constants);
        for (std::size_t j = 0; j < family->count(); ++j)
            add_scaled(prior.constants[j] - family->nominal[j], rests.row(j), member.rest);
        return member;
    }

    // Steps of a flight, for many states.
    struct Grid {
        double t, duration;
        std::size_t count = 0;
        Matrix step, pushed;  // one step of a difference, and what forces add in each
    };

    // `states` say how many of them will share it.
    Grid grid(double t, double duration, std::size_t states) const {
        const double wanted = std::ceil(duration * FINE / family->sizes.timescale);
        const auto count = std::size_t(std::min(std::max(wanted, 4.0), MOST_SAMPLES));
        Grid grid{t, duration, count, {}, {}};
        const std::size_t size = motion->size();
        if (size > 2 * LARGE || size > count * states) return grid;
        const double h = duration / double(count);
        grid.step = motion->transition(h), grid.pushed = Matrix(count, size);
        const Matrix parts = motion->pushed(h);
        for (std::size_t k = 0; k < count; ++k) {
            const double at = t + duration * (double(k) / double(count));
            add_scaled(1.0, parts.row(0), grid.pushed.row(k));
            for (std::size_t i = 0; i < motion->frequency.size(); ++i) {
                const double angle = motion->frequency[i] * at;
                add_scaled(std::cos(angle), parts.row(1 + 2 * i), grid.pushed.row(k));
                add_scaled(std::sin(angle), parts.row(2 + 2 * i), grid.pushed.row(k));
            }
        }
        return grid;
    }

    // The first negative intervals of each gap on a grid, in the order in which they begin.
    // `level` is that of white accelerations, m/s^1.5.
    std::vector<NegativeInterval> negative_intervals(const Grid& grid, const Prior& prior,
                                                     double level) const {
        const double t = grid.t;
        std::vector<NegativeInterval> intervals;
        if (!(grid.duration > 0)) return intervals;
        const SampledFlight samples = sampled(grid, prior.x);
        for (std::size_t j = 0; j < W.rows; ++j) {
            Vector values(samples.s.size());
            for (std::size_t k = 0; k < values.size(); ++k) values[k] = gap(j, samples.x.row(k));
            const auto near = [&](std::size_t from, double at) {
                const double s = samples.s[from];
                return gap(j, motion->state_after(t + s, samples.x.row(from), at - s));
            };
            const auto rounding = [&](double s) {
                const Vector scale = family->sizes.rounding_scale(prior.x, 0.0);
                double size = std::abs(rest[j]);
                for (std::size_t i = 0; i < motion->n(); ++i) size += std::abs(W(j, i)) * scale[i];
                return (64 * EPS + EPS * (t + s) / family->sizes.timescale) * size;
            };
            const auto spread_at = [&](double s) { return deviation(t, j, s, prior, level); };
            add_negative_intervals(intervals, j, samples.s, std::move(values), near, rounding,
                                   spread_at);
        }
        for (NegativeInterval& dip : intervals)
            dip.began = root(t, prior, level, dip.contact, dip.above, dip.below, 0.0);
        in_order(intervals);
        return intervals;
    }

    // The negative intervals of many states. Neighbours with equal t and s share one grid.
    std::vector<std::vector<NegativeInterval>> negative_intervals(
        const std::vector<FlyingState>& states) const {
        std::vector<std::vector<NegativeInterval>> intervals;
        Grid shared{};
        for (std::size_t b = 0; b < states.size(); ++b) {
            const auto& [prior, t, s, level] = states[b];
            const Gaps own = member_gaps(prior);
            std::size_t end = b;
            while (end < states.size() && states[end].t == t && states[end].s == s) ++end;
            const bool is_shared = family->moving() == 0;
            if (!is_shared || b == 0 || t != shared.t || s != shared.duration)
                shared = own.grid(t, s, is_shared ? end - b : 1);
            intervals.push_back(own.negative_intervals(shared, prior, level));
        }
        return intervals;
    }

    // Where a gap plus `depth` deviations falls through zero between `above` and `below`, s.
    double root(double t, const Prior& prior, double level, std::size_t j, double above,
                double below, double depth) const {
        const Vector start = motion->state_after(t, prior.x, above);
        const bool is_short = depth > 0 && !(level > 0 || family->count());
        const Vector row = is_short ? motion->row_times_transition(direction(j), above) : Vector();
        const auto sigma = [&](double s) {
            return is_short
                       ? length(product(motion->row_times_transition(row, s - above), prior.root))
                       : deviation(t, j, s, prior, level);
        };
        const auto value = [&](double s) {
            const Vector x = motion->state_after(t + above, start, s - above);
            return gap(j, x) + (depth > 0 ? depth * sigma(s) : 0.0);
        };
        return falls_at(value, above, below, depth > 0 ? 1e-13 : 4 * EPS);
    }

    // States s seconds later, corrected by a sample then. None where a gap is negative then, or,
    // if that is searched, on the way. White accelerations, m/s^1.5, have the `declared` level
    // beside that of each state.
    std::optional<std::vector<CorrectedState>> followed(double t, double s,
                                                        const std::vector<Prior>& priors,
                                                        const MatrixView& levels, double declared,
                                                        const LinearMeasurement& sample,
                                                        bool searches) const {
        std::vector<CorrectedState> corrected;
        Grid steps;
        FlightTransition flight{s, {}, {}};
        for (std::size_t b = 0; b < priors.size(); ++b) {
            const Prior& prior = priors[b];
            Vector x = prior.x;
            const bool is_far = moves_far(t, s, x);
            for (std::size_t j = 0; j < W.rows; ++j)
                if (!(gap(j, x) >= 0)) return std::nullopt;
            if (searches && !is_far) {
                if (steps.count == 0) steps = grid(t, s, priors.size());
                if (!negative_intervals(steps, prior, levels[b]).empty()) return std::nullopt;
            }
            const double level = std::hypot(declared, levels[b]);
            corrected.push_back(updated(sample, state_after_flight(t, prior, x, level, flight),
                                        family->parameters));
        }
        return corrected;
    }

    // Each state after its flight, with white accelerations of its level beside those declared.
    std::vector<Posterior> fly(const std::vector<FlyingState>& states, double declared) const {
        std::vector<Posterior> later;
        FlightTransition flight{-1.0, {}, {}};
        for (const auto& [prior, t, s, level] : states) {
            if (s != flight.s) flight = {s, {}, {}};
            const Gaps own = member_gaps(prior);
            later.push_back(
                own.state_after_flight(t, prior, own.motion->state_after(t, prior.x, s),
                                       s > 0 ? std::hypot(declared, level) : 0.0, flight));
        }
        return later;
    }

    // What states share that fly for s seconds.
    struct FlightTransition {
        double s;
        Matrix Phi, diffused;  // made when they are first needed
    };

    // A state after a flight from t on to x, with white accelerations of this level.
    Posterior state_after_flight(double t, const Prior& prior, const Vector& x, double level,
                                 FlightTransition& flight) const {
        const bool is_own = family->moving() > 0;
        if (is_own || flight.Phi.rows == 0) flight.Phi = motion->transition(flight.s);
        Posterior later{x, prior.constants, {}, with_moved_state(flight.Phi, prior.differences)};
        later.root = is_own ? with_parameters(t, prior, flight, later.differences)
                            : with_moved_state(flight.Phi, prior.root);
        if (level > 0 && flight.diffused.rows == 0)
            flight.diffused = family->given->diffusion(flight.s);
        if (level > 0 || is_own)
            later.root = with_noise(later.root, level > 0 ? flight.diffused : Matrix(), level);
        return later;
    }

    // The scalar update of a root, unless the gate rejects the sample (Potter; Bierman,
    // Factorization methods for discrete sequential estimation, 1977, chapter II).
    static CorrectedState updated(const LinearMeasurement& sample, Posterior prior,
                                  const Parameters& parameters) {
        CorrectedState corrected{std::move(prior), 0, 0, 0};
        auto& [x, constants, root, differences] = corrected.state;
        const std::size_t size = x.size();
        const Vector columns = product(sample.row, root),
                     others = product(sample.row, differences);
        const double spread = dot(columns, columns);
        const double variance = spread + sample.noise;
        corrected.innovation = sample.value - (dot(x, sample.row) + sample.rest);
        corrected.normalised = std::abs(corrected.innovation) / std::sqrt(variance);
        const double least = std::min(corrected.normalised, sample.gate);
        corrected.density = -(least * least + std::log(variance)) / 2;
        if (!(corrected.normalised > sample.gate)) {
            const double shrink = variance + std::sqrt(variance * sample.noise);
            const bool considers = parameters.considers();
            if (considers) root = resized(root, root.columns + 1);
            for (std::size_t i = 0; i < root.rows; ++i) {
                const double towards = dot(root.row(i).part(0, columns.size()), columns);
                add_scaled(-towards / shrink, columns, root.row(i).data);
                if (parameters.is_considered(i, size)) {  // it keeps its value and its error
                    root(i, columns.size()) = towards / std::sqrt(variance);
                    continue;
                }
                const double change = towards / variance * corrected.innovation;
                (i < size ? x[i] : constants[i - size]) += change;
                add_scaled(-towards / variance, others, differences.row(i));
            }
            if (considers) root = squared(std::move(root));
        }
        return corrected;
    }

  private:
    // Takes x s seconds on from t. Whether no gap can have vanished on the way, as not even all
    // terms of Taylor's series together reach so far.
    bool moves_far(double t, double s, Vector& x) const {
        Vector left(W.rows);
        for (std::size_t j = 0; j < W.rows; ++j) left[j] = gap(j, x);
        x = motion->state_after(t, std::move(x), s, [&](const ConstSpan& term) {
            for (std::size_t j = 0; j < W.rows; ++j)
                left[j] -= (1 + 1e-9) * std::abs(dot(W.row(j), term.data));
        });
        return std::abs(s) * motion->rate <= 1.0 &&
               std::all_of(left.begin(), left.end(), [](double each) { return each > 0; });
    }

    // Errors after a flight; the rows after those of the state stay.
    static Matrix with_moved_state(const Matrix& Phi, const MatrixView& errors) {
        Matrix later = errors;
        std::fill_n(later.data.begin(), Phi.rows * errors.columns, 0.0);
        add_product(Phi, errors.part(0, Phi.rows), later.data.data());
        return later;
    }

    // A root of what white accelerations add to a covariance: lower triangular.
    static Matrix with_noise(const Matrix& root, const Matrix& diffused, double level) {
        const std::size_t d = root.rows, c = root.columns;
        Matrix whole = resized(root, std::max(d, c + diffused.columns));
        for (std::size_t i = 0; i < diffused.rows; ++i)
            add_scaled(level, diffused.row(i), whole.row(i).data + c);
        return squared(std::move(whole));
    }

    struct SampledFlight {
        Vector s;
        Matrix x;  // a state each row
    };

    double gap(std::size_t j, const ConstSpan& x) const { return dot(W.row(j), x.data) + rest[j]; }

    // Samples of a flight; a flight after an impact may be short.
    SampledFlight sampled(const Grid& grid, const Vector& start) const {
        const std::size_t last = grid.count + FINER, size = start.size();
        SampledFlight samples{Vector(last + 1), Matrix(last + 1, size)};
        add_scaled(1.0, start, samples.x.row(0));
        const double first = grid.duration / double(grid.count);
        for (std::size_t k = 1; k <= last; ++k) {
            const bool is_finer = k <= FINER, is_first = k == FINER + 1;
            samples.s[k] = is_finer ? std::ldexp(first, 3 * (int(k) - FINER - 1))
                                    : grid.duration * (double(k - FINER) / double(grid.count));
            const ConstSpan from = samples.x.row(is_first ? 0 : k - 1);
            const Span<double> to = samples.x.row(k);
            if (is_finer || grid.step.rows == 0) {
                const double s = is_first ? 0.0 : samples.s[k - 1];
                add_scaled(1.0, motion->state_after(grid.t + s, from, samples.s[k] - s), to);
            } else {
                for (std::size_t i = 0; i < size; ++i)
                    to[i] = grid.pushed(k - FINER - 1, i) + dot(grid.step.row(i), from);
            }
        }
        return samples;
    }

    // The root of a covariance after a flight from t on; `differences` get what the parameters of
    // the motion add.
    Matrix with_parameters(double t, const Prior& prior, const FlightTransition& flight,
                           Matrix& differences) const {
        const std::size_t size = motion->size(), q = family->moving();
        const Matrix whole = leading(prior.root, size, q);
        const MatrixView state = whole.part(0, size), own = whole.part(size, q);
        const Sensitivity by =
            by_motion(*family, theta_of(prior), steps_of(prior, own), t, prior.x, flight.s);
        const Matrix noise = by.noise(state, own);
        Matrix root = resized(with_moved_state(flight.Phi, whole), whole.columns + noise.columns);
        put(noise, root, 0, whole.columns);
        for (std::size_t i = 0; i < size; ++i)
            for (std::size_t j = 0; j < q; ++j) {
                add_scaled(by.first(j, i), own.row(j), root.row(i).data);
                add_scaled(by.first(j, i), prior.differences.row(size + j), differences.row(i));
            }
        return root;
    }

    // The parameters of the motion, and steps of differences where their errors have the root
    // `own`.
    Vector theta_of(const Prior& prior) const {
        return ConstSpan(prior.constants).part(0, family->moving());
    }
    Vector steps_of(const Prior& prior, const MatrixView& own) const {
        return family->parameters.steps(theta_of(prior), own,
                                        prior.differences.part(motion->size(), own.rows));
    }

    // Standard deviation of gap j after s seconds; white accelerations add the integral of the
    // squares of w^T Phi(r)_u, here by Simpson's rule.
    double deviation(double t, std::size_t j, double s, const Prior& prior, double level) const {
        const std::size_t n = motion->n();
        Vector row = direction(j);
        double added = 0.0;
        if (level > 0) {
            const double wanted = std::ceil(s * FINE / family->sizes.timescale / 2);
            const double count = 2 * std::clamp(wanted, 1.0, MOST_SAMPLES / 2), h = s / count;
            for (double k = 0; k < count; ++k) {
                row = motion->row_times_transition(std::move(row), h);
                const double weight = k + 1 == count ? 1 : std::fmod(k, 2) == 0 ? 4 : 2;
                added += weight * dot(ConstSpan(row).part(n, n), &row[n]) * h / 3;
            }
        } else {
            row = motion->row_times_transition(std::move(row), s);
        }
        for (std::size_t k = 0; k < family->count(); ++k) row.push_back(rests(k, j));
        const double own = family->moving() ? spread_with_parameters(t, j, s, prior, row)
                                            : length(product(row, prior.root));
        return std::hypot(own, level * std::sqrt(added));
    }

    // Standard deviation of gap j after s seconds, `row` of states and parameters before, with
    // what the parameters of the motion add.
    double spread_with_parameters(double t, std::size_t j, double s, const Prior& prior,
                                  Vector row) const {
        const std::size_t size = motion->size(), q = family->moving();
        const Matrix whole = leading(prior.root, size, q);
        const MatrixView own = whole.part(size, q);
        const Vector seen = direction(j);
        const Sensitivity by = by_motion(
            *family, theta_of(prior), steps_of(prior, own),
            [&](const FreeMotion& other) {
                return Vector{dot(seen, other.state_after(t, prior.x, s))};
            },
            [&](const FreeMotion& other) {
                return Matrix(MatrixView{other.row_times_transition(seen, s).data(), 1, size});
            });
        for (std::size_t k = 0; k < q; ++k) row[size + k] += by.first(k, 0);
        const Matrix noise = by.noise(whole.part(0, size), own);
        return std::hypot(length(product(row, whole)), length(noise.data));
    }

    // Gap j as a function of states
    Vector direction(std::size_t j) const {
        Vector row(motion->size());
        std::copy(W.row(j).begin(), W.row(j).end(), row.begin());
        return row;
    }
};

}  // namespace kernel::kalman
