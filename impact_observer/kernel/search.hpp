// SPDX-License-Identifier: Apache-2.0

// The first root of several functions of time: no crossing is skipped, as steps use bounds on the
// second and eighth derivatives (Taylor's theorem).
#pragma once

#include <optional>
#include <tuple>
#include <vector>

#include "phase.hpp"

namespace kernel {

constexpr double DEPTH = 7.1e-15;  // that counts as none, relative to a function's scale: 32 eps
constexpr double ZERO = 1e-12;     // value that counts as zero at a crossing, relative to the same
constexpr double ROUNDED = 1e-14;  // from which one more step of Newton's method ends at the root
constexpr double ROOT = 8.8817841970012523e-16;  // relative accuracy of a root: 4 eps
constexpr double FIRST =
    1e-9;  // of a window: steps after a start are never shorter than ROOT of it
constexpr double FALLS = 0.02;  // of a parabola: that is straight enough
constexpr double CLOSE = 1e-6;  // to a root, relative, of a polynomial

using Indices = std::vector<std::size_t>;

struct Crossing {
    double s;
    Indices which;  // all that are zero then

    auto fields() const { return std::tie(s, which); }
};

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

// A search along one motion that goes on where it has stopped. From s, where a function has value
// g and slope v and |g''| <= b from there on, it is above -delta at least until the root of
// g + delta + v h - b h^2 / 2: so far a step may go, the least one of all functions. Nothing can
// be jumped, and near a root the steps converge like Newton's. The steps, and so the crossing, are
// the same for any horizon.
class RootSearch {
  public:
    // Begins at `start`; nothing crosses before. `window` is a time in which the fastest part of
    // motions turns once or twice.
    RootSearch(std::unique_ptr<Functions> along, double window, double start = 0.0)
        : functions(std::move(along)),
          window(window),
          s(start),
          last(start),
          stretch(window),
          values(functions->size(), 0.0),
          before(values) {}

    // The first crossing, if all before `horizon` has to be looked at to find it.
    const std::optional<Crossing>& first(double horizon) {
        const double end = functions->end();
        if ((std::min(horizon, end) - s) * functions->rate() > MOST_STRIDES) throw TooFar(horizon);
        for (const double most = double(looks) + MOST_STRIDES;
             !crossing && s <= horizon && s < end;) {
            if (double(looks) > most) throw TooFar(horizon);  // a function that is rounding only
            step(end);
        }
        if (!crossing && s <= horizon && s == end && is_below()) cross();
        return crossing;
    }

    std::size_t looks = 0;  // instants at which it has looked

    // The functions at an instant.
    Functions& look(double where) {
        if (where != there) functions->look(there = where);
        return *functions;
    }

  private:
    std::unique_ptr<Functions> functions;
    double there = NAN;  // where it has looked last
    double window, s, last, stretch;
    Vector values, before;  // at s and at `last`
    std::optional<Crossing> crossing;

    // Whether one of the functions is below zero at s by more than rounding.
    bool is_below() {
        look(s);
        for (std::size_t i = 0; i < values.size(); ++i)
            if (functions->derivative(0, i) < -DEPTH / 2 * functions->scale(i)) return true;
        return false;
    }

    void step(double end) {
        ++looks;
        look(s);
        const double stop = std::min({s + stretch, functions->smooth_until(), end});
        double h = stop - s;
        bool deep = false;
        for (std::size_t i = 0; i < values.size() && !deep; ++i) {
            values[i] = functions->derivative(0, i);
            const double delta = DEPTH * functions->scale(i);
            if (s == 0) values[i] = std::max(values[i], 0.0);  // below zero by rounding only
            deep = values[i] < -delta / 2;
            if (!deep) h = std::min(h, safe(i, values[i] + delta, h, stop));
        }
        if (deep) return cross();
        before.swap(values);
        last = s;
        stretch = h < stop - s ? std::max(window, 4 * h) : std::max(stretch, 2 * h);
        s += std::max(h, ROOT * std::max(s, FIRST * window));
    }

    // How far one function stays above -delta; no more than `most`.
    double safe(std::size_t i, double value, double most, double stop) {
        const double slope = functions->derivative(1, i);
        const double bend = functions->bound(2, i, stop) * (1 + 1e-9);
        const double root = std::sqrt(slope * slope + 2 * bend * value);
        double h = INFINITY;
        if (slope > 0 && bend > 0) h = (slope + root) / bend;
        if (slope <= 0 && (slope < 0 || bend > 0)) h = root > 0 ? 2 * value / (root - slope) : 0.0;
        if (h >= most) return most;
        if (functions->constant(i) >= functions->bound(0, i, stop)) return most;
        if (slope < 0 && bend * value < FALLS * slope * slope) return h;  // nearly at the root
        return std::min(closely(i, value, h, most, stop), most);
    }

    // The same by a Taylor polynomial of order 8 with bounded remainder: up to its root, if its
    // Bernstein coefficients show that there is none before. `least` is safe in any case.
    double closely(std::size_t i, double value, double least, double most, double stop) {
        const double fast = functions->bound(8, i, stop);
        // Where the remainder has grown to what the acceleration makes.
        if (fast > 0)
            most = std::min(most, std::pow(20160 * functions->bound(2, i, stop) / fast, 1. / 6));
        double taylor[ORDERS] = {value}, factor = 1.0;  // powers of h / most
        for (std::size_t k = 1; k < ORDERS; ++k) {
            factor *= most / double(k);
            taylor[k] = factor * (k + 1 < ORDERS ? functions->derivative(k, i) : -fast);
        }
        for (double h = before_root(taylor, least / most); h * most > least; h /= 2)
            if (lowest(taylor, h) >= 0) return h * most;
        return least;
    }

    static double polynomial(const double* c, double x) {
        double sum = c[ORDERS - 1];
        for (std::size_t k = ORDERS - 1; k-- > 0;) sum = c[k] + sum * x;
        return sum;
    }

    // Just before a root between `least` and 1, if it finds one.
    static double before_root(const double* taylor, double least) {
        double low = std::max(least, 1e-9), high = low;
        do {
            if (!(high < 1)) return 1;
            high = std::min(2 * high, 1.0);
        } while (polynomial(taylor, high) >= 0);
        const auto negated = [&](double x) { return -polynomial(taylor, x); };
        return falls_at(negated, high, low, CLOSE);
    }

    // The least Bernstein coefficient of a polynomial on [0, h].
    static double lowest(const double* taylor, double h) {
        // b_i = sum_j binomial(i, j) / binomial(8, j) h^j taylor_j: sums as in Pascal's triangle
        constexpr double part[ORDERS] = {1,       1. / 8,  1. / 28, 1. / 56, 1. / 70,
                                         1. / 56, 1. / 28, 1. / 8,  1};
        double sums[ORDERS], power = 1.0;
        for (std::size_t k = 0; k < ORDERS; ++k, power *= h) sums[k] = taylor[k] * power * part[k];
        double least = sums[0];
        for (std::size_t i = 1; i < ORDERS; ++i) {
            for (std::size_t j = 0; j + i < ORDERS; ++j) sums[j] += sums[j + 1];
            least = std::min(least, sums[0]);
        }
        return least;
    }

    // One of the functions is below zero at s by more than rounding: the first root before it.
    void cross() {
        Crossing first{INFINITY, {}};
        std::size_t earliest = 0;
        for (std::size_t i = 0; i < functions->size(); ++i) {
            if (value_at(i, s) >= -DEPTH / 2 * functions->scale(i)) continue;
            const double x = root(i);
            if (x < first.s) first.s = x, earliest = i;
        }
        look(first.s);
        for (std::size_t i = 0; i < functions->size(); ++i)
            if (i == earliest || functions->derivative(0, i) <= ZERO * functions->scale(i))
                first.which.push_back(i);
        crossing = first;
    }

    double value_at(std::size_t i, double where) { return look(where).derivative(0, i); }

    // The last root of one function before s, by Newton's method between points of both signs.
    double root(std::size_t i) {
        double low = last, high = s, back = ROOT * s;
        if (!(before[i] > 0)) {
            // What was below zero by rounding raised no suspicion: the root lies before.
            for (low = s; value_at(i, low) < 0; back *= 4) {
                if (low == 0) return 0.0;
                high = low;
                low = std::max(s - back, 0.0);
            }
        }
        double x = high, step = high - low;
        for (int k = 0; k < 1100 && high - low > ROOT * high; ++k) {
            const double value = value_at(i, x), slope = functions->derivative(1, i);
            const bool rounded = std::abs(value) <= ROUNDED * functions->scale(i);
            (value < 0 ? high : low) = x;
            double next = x - value / slope;
            const bool newton = low <= next && next <= high && slope < 0 &&
                                (rounded || std::abs(next - x) <= step / 2);
            if (!newton) next = low + (high - low) / 2;
            step = std::abs(next - x);
            x = next;
            if (newton && (rounded || step <= ROOT * x)) return x;
        }
        return x;
    }
};

}  // namespace kernel
