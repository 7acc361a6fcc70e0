// SPDX-License-Identifier: Apache-2.0

// Systems that differ by a few parameters theta, and how these add to the error of a state, to
// second order.
//
// A map F(x, theta) is affine in the state x for every theta. Its derivatives with theta are
// differences over steps about as large as theta may be wrong: where the map is curved they
// average over that distance, and as the deviations fall they become derivatives (Norgaard,
// Poulsen and Ravn, New developments in state estimation for nonlinear systems, 2000). Terms of
// second order are noise whose variance follows from that of state and parameters. So a filter
// never claims more than its linearisation allows, and the noise vanishes with the deviations of
// the parameters.
#pragma once

#include <functional>
#include <memory>

#include "free_motion.hpp"

namespace kernel::kalman {

constexpr double STEP = 1e-6;    // least step of a finite difference, in sizes of its parameter
constexpr double FAR = 0.5;      // largest one, in distances of the parameter from its bounds
constexpr double MARGIN = 1e-3;  // of a parameter of the motion to its bounds, in its sizes
constexpr double MEAN_TOO = 0.8660254037844386;  // root mean square of half a squared variable
constexpr double TAILS = 1.5;  // products of normal variables have heavier tails than noise

// Uncertain parameters; those that change the motion between impacts come first.
struct Parameters {
    Vector low, high, size;        // bounds, and the errors that make a model useless
    std::size_t moving;            // how many change the motion
    std::vector<bool> considered;  // with an error, but not estimated (Schmidt)

    std::size_t count() const { return size.size(); }

    // Whether row i of (first rows, parameters, others) is that of a considered parameter.
    bool is_considered(std::size_t i, std::size_t first) const {
        return i >= first && i - first < considered.size() && considered[i - first];
    }

    bool considers() const {
        return std::any_of(considered.begin(), considered.end(), [](bool each) { return each; });
    }

    // Steps of finite differences by the first ones, about as large as their standard deviations:
    // powers of two, so that hypotheses of similar covariance share the same members. A row of
    // `root` and of the replicas' `differences` each; zero where all is sure.
    Vector steps(const ConstSpan& theta, const MatrixView& root,
                 const MatrixView& differences) const {
        Vector steps(root.rows);
        for (std::size_t j = 0; j < steps.size(); ++j) {
            const double deviation = length(root.row(j));
            if (deviation == 0.0 && length(differences.row(j)) == 0.0) continue;
            double step = std::max(deviation, STEP * size[j]);
            if (j < moving)  // impacts need no bounds of their parameters
                step = std::min(step, FAR * std::min(theta[j] - low[j], high[j] - theta[j]));
            steps[j] = std::exp2(std::floor(std::log2(step)));
        }
        return steps;
    }

    double clamped(std::size_t j, double theta) const {
        const double margin = j < moving ? MARGIN * size[j] : 0.0;
        return std::clamp(theta, low[j] + margin, high[j] - margin);
    }

    // Takes an estimate z back whose parameters, from z[first] on, are beyond their bounds: all
    // else moves to its conditional mean given these (Simon and Chia, Kalman filtering with state
    // equality constraints, 2002). `root` is one of the covariance of z.
    void clamp_estimate(Vector& z, const MatrixView& root, std::size_t first) const {
        Vector change(root.rows);
        for (std::size_t j = 0; j < count(); ++j) {
            if (considered[j]) continue;
            const ConstSpan row = root.row(first + j);
            const double value = z[first + j] + change[first + j];
            const double beyond = clamped(j, value) - value, variance = dot(row, row);
            if (beyond == 0.0 || variance == 0.0) continue;
            for (std::size_t i = 0; i < root.rows; ++i)
                change[i] += dot(root.row(i), row) * (beyond / variance);
        }
        for (std::size_t i = 0; i < root.rows; ++i)
            if (!is_considered(i, first)) z[i] += change[i];
        for (std::size_t j = 0; j < count(); ++j)
            if (!considered[j]) z[first + j] = clamped(j, z[first + j]);
    }
};

// What a unit of a parameter adds to a FreeMotion.
struct MotionChange {
    Matrix lower;
    Vector constant;
    Matrix cosine, sine;
    Vector frequency;
    double rate;  // at most, to the bound of its rates, 1/s

    // Whether it changes forces alone: motions are affine in it, and their differences keep.
    bool is_force() const {
        const auto is_zero = [](const Vector& v) {
            return std::all_of(v.begin(), v.end(), [](double each) { return each == 0.0; });
        };
        return is_zero(lower.data) && is_zero(frequency);
    }
};

// The members of a family. The accelerations are linear in the parameters, or those of considered
// ones are linearised about the given member.
struct Family {
    std::shared_ptr<const FreeMotion> given;
    Sizes sizes;  // of the given member
    Parameters parameters;
    Vector nominal;                     // parameters of the given member
    std::vector<MotionChange> changes;  // by those of the motion

    std::size_t count() const { return nominal.size(); }
    std::size_t moving() const { return changes.size(); }

    std::shared_ptr<const FreeMotion> member(const ConstSpan& theta) const {
        if (std::equal(theta.begin(), theta.begin() + moving(), nominal.begin())) return given;
        const auto member = std::make_shared<FreeMotion>(*given);
        for (std::size_t j = 0; j < moving(); ++j) {
            const double by = theta[j] - nominal[j];
            const MotionChange& change = changes[j];
            add_scaled(by, change.lower.data, member->lower.data);
            add_scaled(by, change.constant, member->constant);
            add_scaled(by, change.cosine.data, member->cosine.data);
            add_scaled(by, change.sine.data, member->sine.data);
            add_scaled(by, change.frequency, member->frequency);
            member->rate += std::abs(by) * change.rate;
        }
        member->prepare();
        return member;
    }

    // What a unit of parameter j adds to the accelerations at a difference of states.
    Vector acceleration_change(std::size_t j, const ConstSpan& difference) const {
        Vector found(given->n());
        for (std::size_t i = 0; i < found.size(); ++i)
            found[i] = dot(changes[j].lower.row(i), difference.data);
        return found;
    }

    // The same at the state x at t.
    Vector acceleration_change(std::size_t j, const ConstSpan& x, double t) const {
        Vector found = acceleration_change(j, x);
        const MotionChange& change = changes[j];
        add_scaled(1.0, change.constant, found);
        for (std::size_t k = 0; k < given->frequency.size(); ++k) {
            const double angle = given->frequency[k] * t, late = change.frequency[k] * t;
            const double one = std::cos(angle), two = std::sin(angle);
            add_scaled(one, change.cosine.row(k), found);
            add_scaled(two, change.sine.row(k), found);
            add_scaled(-late * two, given->cosine.row(k), found);
            add_scaled(late * one, given->sine.row(k), found);
        }
        return found;
    }
};

// An affine map of states, evaluated at one state, and its derivative.
struct AffineMap {
    Vector value;
    Matrix linear;
};

// Turns the columns of `root` until its rows from `first` on are lower triangular in front.
inline Matrix leading(const MatrixView& root, std::size_t first, std::size_t count) {
    Matrix turned = resized(root, std::max(root.columns, count));
    const auto begin = turned.data.begin(), end = begin + (first + count) * turned.columns;
    const auto middle = begin + first * turned.columns;
    std::rotate(begin, middle, end);  // they are on top meanwhile
    for (std::size_t k = 0; k < count; ++k) reflect(turned, k);
    std::rotate(begin, begin + count * turned.columns, end);
    return turned;
}

// How a map of k numbers changes with parameters: central differences about theta, on a grid of
// parameters, `steps` wide. It does not change with those whose step is zero. It is affine in
// those that are `affine` together, and its linear part does not change with them.
struct Sensitivity {
    Matrix first;                     // derivatives of its value, p x k
    std::vector<Matrix> mixed;        // of its linear part, p times k x d
    std::vector<Vector> second;       // second derivatives of its value, p p times k
    std::vector<std::size_t> active;  // parameters with which it changes
    std::size_t size;                 // d

    // `value_of` finds the value of the map alone, which is all that two changes at once need.
    template <class AffineMapOf, class ValueOf>
    Sensitivity(AffineMapOf map_of, ValueOf value_of, const Vector& theta, const Vector& steps,
                std::vector<bool> affine = {}) {
        affine.resize(theta.size());
        const std::size_t p = theta.size();
        Vector near = theta;
        for (std::size_t j = 0; j < p; ++j) {
            if (steps[j] == 0.0) continue;
            near[j] = steps[j] * std::nearbyint(theta[j] / steps[j]);
            active.push_back(j);
        }
        const auto aside = [&](std::size_t j, double one, std::size_t k, double other) {
            Vector values = near;
            values[j] += one * steps[j], values[k] += other * steps[k];
            return values;
        };
        const AffineMap centre = map_of(near);
        const std::size_t k = centre.value.size();
        size = centre.linear.columns;
        first = Matrix(p, k), second.assign(p * p, Vector(k)), mixed.resize(p);
        std::vector<AffineMap> plus(p);
        for (const std::size_t j : active) {
            const Vector here = aside(j, 1.0, j, 0.0);
            plus[j] = affine[j] ? AffineMap{value_of(here), {}} : map_of(here);
        }
        for (const std::size_t j : active) {
            const double h = steps[j];
            for (const std::size_t l : active) {
                if (l == j) break;
                if (affine[j] && affine[l]) continue;
                const Vector both = value_of(aside(j, 1.0, l, 1.0));
                for (std::size_t i = 0; i < k; ++i) {
                    const double crossed =
                        (both[i] - plus[j].value[i]) - (plus[l].value[i] - centre.value[i]);
                    second[j * p + l][i] = second[l * p + j][i] = crossed / (h * steps[l]);
                }
            }
            if (affine[j]) {
                mixed[j] = Matrix(k, size);
                for (std::size_t i = 0; i < k; ++i)
                    first(j, i) = (plus[j].value[i] - centre.value[i]) / h;
                continue;
            }
            const AffineMap minus = map_of(aside(j, -1.0, j, 0.0));
            mixed[j] = plus[j].linear;
            for (std::size_t i = 0; i < mixed[j].data.size(); ++i)
                mixed[j].data[i] = (mixed[j].data[i] - minus.linear.data[i]) / (2 * h);
            for (std::size_t i = 0; i < k; ++i) {
                const double on = plus[j].value[i], back = minus.value[i], here = centre.value[i];
                first(j, i) = (on - back) / (2 * h);
                second[j * p + j][i] = ((on - here) + (back - here)) / (h * h);
            }
        }
        for (std::size_t j = 0; j < p; ++j)
            for (std::size_t l = 0; l < p; ++l)
                add_scaled(theta[l] - near[l], second[l * p + j], first.row(j));
    }

    // Noise of second order that the parameters add to `linear root`, where `root`, d x c, and
    // `own`, p x c and lower triangular in front, are the root of states and parameters.
    Matrix noise(const MatrixView& root, const MatrixView& own) const {
        const std::size_t p = first.rows, k = first.columns, d = root.rows;
        // Columns in which the parameters are zero: turned, d of them hold as much as all.
        const std::size_t rest = root.columns - p, left = std::min(rest, d), c = p + left;
        Matrix turned(d, rest);
        for (std::size_t m = 0; m < d; ++m)
            add_scaled(1.0, root.row(m).part(p, rest), turned.row(m));
        if (rest > d) make_triangular(turned);
        std::vector<Matrix> across(p);  // mixed derivatives, by columns of `own`
        for (std::size_t a = 0; a < p; ++a)
            for (const std::size_t j : active) {
                if (j < a || own(j, a) == 0.0) continue;
                if (across[a].rows == 0) across[a] = Matrix(k, c);
                for (std::size_t i = 0; i < k; ++i)
                    for (std::size_t m = 0; m < d; ++m) {
                        const double by = own(j, a) * mixed[j](i, m);
                        add_scaled(by, root.row(m).part(0, p), across[a].row(i));
                        add_scaled(by, turned.row(m).part(0, left), &across[a](i, p));
                    }
            }
        const auto moves = [&](std::size_t a) { return across[a].rows > 0; };
        const auto mixes = [&](std::size_t a, std::size_t i, std::size_t b) {
            return moves(a) ? across[a](i, b) : 0.0;
        };
        const auto curved = [&](std::size_t a, std::size_t b, std::size_t i) {
            double sum = 0.0;
            for (const std::size_t j : active)
                for (const std::size_t l : active)
                    if (j >= a && l >= b) sum += own(j, a) * second[j * p + l][i] * own(l, b);
            return sum;
        };
        std::size_t columns = 0;
        for (std::size_t a = 0; a < p; ++a) {
            if (moves(a)) columns += left + 1;
            for (std::size_t b = 0; b < a; ++b) columns += moves(a) || moves(b);
        }
        Matrix noise(k, columns);
        for (std::size_t i = 0; i < k; ++i) {
            double* to = noise.row(i).data;
            for (std::size_t a = 0; a < p; ++a) {
                if (moves(a)) {
                    for (std::size_t j = p; j < c; ++j) *to++ = TAILS * across[a](i, j);
                    *to++ = TAILS * MEAN_TOO * (curved(a, a, i) + 2 * across[a](i, a));
                }
                for (std::size_t b = 0; b < a; ++b)
                    if (moves(a) || moves(b))
                        *to++ = TAILS * (curved(a, b, i) + mixes(a, i, b) + mixes(b, i, a));
            }
        }
        return noise;
    }
};

// How a map of each member changes with the parameters of the motion, about theta.
template <class ValueOf, class LinearOf>
Sensitivity by_motion(const Family& family, const Vector& theta, const Vector& steps,
                      ValueOf value_of, LinearOf linear_of) {
    std::vector<bool> forces;
    for (const MotionChange& each : family.changes) forces.push_back(each.is_force());
    const auto map_of = [&](const Vector& other) {
        const auto member = family.member(other);
        return AffineMap{value_of(*member), linear_of(*member)};
    };
    return {map_of, [&](const Vector& other) { return value_of(*family.member(other)); }, theta,
            steps, forces};
}

// The same of the state s seconds after x at t.
inline Sensitivity by_motion(const Family& family, const Vector& theta, const Vector& steps,
                             double t, const Vector& x, double s) {
    return by_motion(
        family, theta, steps,
        [&](const FreeMotion& member) { return member.state_after(t, x, s); },
        [&](const FreeMotion& member) { return member.transition(s); });
}

}  // namespace kernel::kalman
