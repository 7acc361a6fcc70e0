// SPDX-License-Identifier: Apache-2.0

// The solution of dy/dt = J y + load (1, cos, sin) + push f(t) by Taylor polynomials over strides,
// exact but for rounding: for sampled forces, and for phases without real pairs of eigenvalues.
#pragma once

#include <functional>

#include "phase.hpp"

namespace kernel {

constexpr std::size_t TERMS = 20;     // of the longest strides: (rate s)^k / k! with rate s = 1
constexpr double NEGLIGIBLE = 1e-18;  // the first term left out, relative to the whole
constexpr std::size_t KEPT = 64;      // of so many strides one is kept, to go back to

constexpr std::size_t JETS = 4;  // a cubic and its derivatives

// Forces at instants, a cubic from each to the next; after the last one it goes on. More may come,
// and old ones be dropped; samples are counted from the very first.
struct SampledForces {
    Vector time;      // s since the epoch, ascending
    Matrix jets;      // the forces from each instant on, and their derivatives, a row each
    double rounding;  // difference of instants that counts as none, s
    std::function<void(double)> check;  // raises an error for instants before the first one
    std::size_t dropped = 0;            // at the front
    double newest = INFINITY;           // from when on they may still change, s
    Vector changes{};                   // the instants from which on they have changed, each time

    std::size_t count() const { return dropped + time.size(); }
    std::size_t forces() const { return jets.columns / JETS; }
    double instant(std::size_t k) const { return time[here(k)]; }
    MatrixView jet(std::size_t k) const { return {jets.row(here(k)).data, JETS, forces()}; }

    // The sample that holds from t on.
    std::size_t index(double t) const {
        const auto after = std::upper_bound(time.begin(), time.end(), t + rounding);
        return dropped + std::size_t(std::max<std::ptrdiff_t>(after - time.begin(), 1)) - 1;
    }

    // Other samples from number `first` on.
    void splice(std::size_t first, const MatrixView& at, const MatrixView& values) {
        changes.push_back(at[0]);
        time.resize(first - dropped);
        jets.data.resize(time.size() * jets.columns);
        time.insert(time.end(), at.data, at.data + at.size());
        jets.data.insert(jets.data.end(), values.data, values.data + values.size());
        jets.rows = time.size();
    }

    // Forget samples before number `first`.
    void drop(std::size_t first) {
        const auto old = std::ptrdiff_t(here(first)), columns = std::ptrdiff_t(jets.columns);
        time.erase(time.begin(), time.begin() + old);
        jets.data.erase(jets.data.begin(), jets.data.begin() + old * columns);
        jets.rows = time.size();
        dropped = first;
    }

  private:
    std::size_t here(std::size_t k) const {
        if (k < dropped || k >= count()) throw std::invalid_argument("samples: not there");
        return k - dropped;
    }
};

// dy/dt = J y + load (1, cos, sin) + push f. In a suitable norm |J^k| <= rate^k.
struct SeriesFlow : PhaseFlow {
    Matrix J;           // blocks below each other, as many columns as one
    Matrix load, push;  // size x (1 + 2h), size x forces
    std::shared_ptr<const SampledForces> samples;  // or none
    double rate;                                   // also of the harmonics, 1/s

    using PhaseFlow::PhaseFlow;
    std::shared_ptr<PhaseMotion> start(const Elapsed& t, const double* x) const override;
    std::shared_ptr<Guards> guards(GuardRows rows) const override;
    std::size_t forces() const override { return push.columns; }

    // dy = J y.
    void turn(const double* y, double* dy) const {
        for (std::size_t i = 0; i < J.rows; ++i)
            dy[i] = dot(J.row(i), y + i / J.columns * J.columns);
    }
};

// A motion at one of its strides. Strides do not depend on what is looked at.
class Walk {
  public:
    std::shared_ptr<const SeriesFlow> flow;
    double begin, end, length;     // s since the start; the last stride has no end
    std::size_t terms, count = 0;  // of the polynomial; strides begun
    Matrix y, waves, force;        // there and their derivatives, a row each

    Walk(std::shared_ptr<const SeriesFlow> of, const Elapsed& t, const double* x)
        : flow(std::move(of)),
          y(TERMS, flow->coordinates.size),
          waves(TERMS, flow->load.columns),
          force(JETS, flow->push.columns),
          t(t.seconds),
          angles(flow->harmonics.angles_at(t)),
          frequency(flow->harmonics.frequency) {
        if (flow->samples) {
            check(0.0);
            first = flow->samples->index(this->t);
            seen = flow->samples->changes.size();
        }
        flow->coordinates.split(x, flow->coordinates.rest(x), y.row(0).data);
        enter();
    }

    // Until when the forces are final, s.
    double last() const { return flow->samples ? flow->samples->newest - t : INFINITY; }

    // Goes to the stride that contains s.
    void go(double s) {
        check(s);
        if (flow->samples && seen < flow->samples->changes.size()) refresh();
        if (s < begin) {
            const auto after = std::upper_bound(kept.begin(), kept.end(), s,
                                                [](double at, const Kept& k) { return at < k.s; });
            restore(*(after == kept.begin() ? after : after - 1));
        }
        if ((s - begin) * flow->rate > MOST_STRIDES) throw TooFar(s);
        while (s >= end) {
            const Vector next = value(length);
            std::copy(next.begin(), next.end(), y.row(0).data);
            ++stride, ++passed;
            if (stride == strides) ++interval, stride = 0;
            enter();
        }
    }

    // y `s` seconds after the begin.
    Vector value(double s) const {
        Vector y_later(y.columns);
        taylor(y.part(0, terms), s, y_later.data());
        return y_later;
    }

  private:
    struct Kept {
        double s;
        std::size_t interval, passed;
        double stride;
        Vector y;
    };

    double t;
    Vector angles, frequency;  // at the start; of the present stride, rad/s
    std::size_t first = 0, interval = 0, passed = 0;
    double stride = 0, strides = INFINITY;  // in the interval between two samples
    std::vector<Kept> kept;
    std::size_t seen = 0;  // changes of the samples

    void check(double s) const {
        if (flow->samples && t + s < flow->samples->time.front()) flow->samples->check(t + s);
    }

    void restore(const Kept& from) {
        interval = from.interval, stride = from.stride, passed = from.passed;
        std::copy(from.y.begin(), from.y.end(), y.row(0).data);
        enter();
    }

    // Goes back to before the samples that have changed meanwhile.
    void refresh() {
        const Vector& changes = flow->samples->changes;
        const double from =
            *std::min_element(changes.begin() + std::ptrdiff_t(seen), changes.end()) - t;
        seen = changes.size();
        while (kept.size() > 1 && kept.back().s > from) kept.pop_back();
        if (begin >= from) restore(Kept(kept.back()));
    }

    // Where an interval begins.
    double knot(std::size_t k) const {
        return k == 0 ? 0.0 : flow->samples->instant(first + k) - t;
    }

    // Begins the stride with y: where it lies, and all derivatives.
    void enter() {
        const double from = knot(interval), rate = flow->rate;
        if (flow->samples && first + interval + 1 < flow->samples->count()) {
            const double whole = knot(interval + 1) - from;
            strides = std::max(std::ceil(whole * rate), 1.0);
            begin = from + whole * (stride / strides);
            end = stride + 1 < strides ? from + whole * ((stride + 1) / strides) : from + whole;
        } else {
            strides = INFINITY;
            begin = from + (rate > 0 ? stride / rate : 0.0);
            end = rate > 0 ? from + (stride + 1) / rate : INFINITY;
        }
        length = end < INFINITY ? end - begin : 0.0;
        if (passed % KEPT == 0 && (kept.empty() || kept.back().s < begin))
            kept.push_back({begin, interval, passed, stride, y.row(0)});
        double left_out = 1.0;
        for (terms = 1; terms < TERMS && (terms <= ORDERS || left_out > NEGLIGIBLE); ++terms)
            left_out *= rate * length / double(terms);
        drive(begin - from);
        for (std::size_t k = 0; k + 1 < terms; ++k) {
            const Span<double> next = y.row(k + 1);
            flow->turn(y.row(k).data, next.data);
            for (std::size_t i = 0; i < y.columns; ++i) {
                if (k == 0 || waves.columns > 1) next[i] += dot(flow->load.row(i), waves.row(k));
                if (k < JETS) next[i] += dot(flow->push.row(i), force.row(k));
            }
        }
        ++count;
    }

    // Waves and forces at the begin, `s` seconds into the interval, and their derivatives.
    void drive(double s) {
        flow->harmonics.waves(angles, begin, waves.row(0).data);
        if (flow->samples) push(s);
        const std::size_t h = flow->harmonics.size();
        for (std::size_t k = 0; k + 1 < terms; ++k)
            for (std::size_t j = 0; j < h; ++j) {
                waves(k + 1, 1 + j) = -frequency[j] * waves(k, 1 + h + j);
                waves(k + 1, 1 + h + j) = frequency[j] * waves(k, 1 + j);
            }
    }

    void push(double s) {
        const MatrixView jet = flow->samples->jet(first + interval);
        if (interval == 0) s += t - flow->samples->instant(first);
        for (std::size_t k = 0; k < JETS; ++k) taylor(jet.part(k, JETS - k), s, force.row(k).data);
    }
};

class SeriesMotion : public PhaseMotion {
  public:
    const Walk begun;  // from its start, for somebody else

    SeriesMotion(const std::shared_ptr<const SeriesFlow>& of, const Elapsed& t, const double* x)
        : PhaseMotion(of, t, x), begun(of, t, x), walk(begun) {}

    void states(const double* s, std::size_t count, double* rows) const override {
        for (std::size_t i = 0; i < count; ++i, rows += 2 * flow->coordinates.n) {
            walk.go(s[i]);
            flow->coordinates.states(walk.value(s[i] - walk.begin).data(), 1, rest, rows);
        }
    }

  private:
    mutable Walk walk;
};

inline std::shared_ptr<PhaseMotion> SeriesFlow::start(const Elapsed& t, const double* x) const {
    return std::make_shared<SeriesMotion>(self<SeriesFlow>(), t, x);
}

class SeriesGuards : public Guards {
  public:
    using Guards::Guards;

  private:
    std::unique_ptr<Functions> functions(std::shared_ptr<const PhaseMotion> motion,
                                         Vector shift) const override;
};

class SeriesFunctions : public Functions {
  public:
    SeriesFunctions(std::shared_ptr<const Guards> of, const Walk& begun, Vector shift)
        : guards(std::move(of)),
          rows(guards->rows),
          walk(begun),
          added(std::move(shift)),
          there(TERMS, guards->size()),
          here(there),
          scales(guards->size()) {
        enter();
    }

    std::size_t size() const override { return scales.size(); }
    double smooth_until() const override { return walk.end; }
    double end() const override { return walk.last(); }
    double rate() const override { return walk.flow->rate; }
    double derivative(std::size_t order, std::size_t i) const override { return here(order, i); }
    double constant(std::size_t i) const override { return rows.waves(i, 0) + added[i]; }
    double scale(std::size_t i) override { return scales[i]; }

    void look(double to) override {
        const std::size_t before = walk.count;
        walk.go(s = to);
        if (walk.count != before) enter();
        for (std::size_t k = 0; k < walk.terms; ++k)
            taylor(there.part(k, walk.terms - k), s - walk.begin, here.row(k).data);
    }

    double bound(std::size_t order, std::size_t i, double stop) override {
        const double h = std::min(stop, walk.end) - s, rate = walk.flow->rate;
        double bound = 0.0, factor = 1.0;
        for (std::size_t k = order; k < walk.terms; ++k) {
            bound += factor * std::abs(here(k, i) - (k == 0 ? constant(i) : 0.0));
            factor *= h / double(k + 1 - order);
        }
        double left_out = scales[i] * std::exp(1.0);  // all terms from walk.terms on
        for (std::size_t k = 0; k < walk.terms; ++k)
            left_out *= k < order ? rate : rate * walk.length / double(k + 1 - order);
        return bound + left_out;
    }

  private:
    std::shared_ptr<const Guards> guards;
    const GuardRows& rows;
    Walk walk;
    Vector added;
    Matrix there, here;  // the functions at the begin of the stride and at s, with derivatives
    Vector scales;
    double s = 0.0;

    // The functions of a stride, and how large what they are made of is within the time scale, but
    // not longer than since the start; what grows faster than an acceleration, within the stride.
    void enter() {
        const double rate = walk.flow->rate, ended = walk.begin + walk.length;
        const double h = rate > 0 ? std::min(1 / rate, ended) : ended;
        for (std::size_t i = 0; i < size(); ++i) {
            const ConstSpan reach = rows.reach.row(i);
            for (std::size_t k = 0; k < walk.terms; ++k)
                there(k, i) = dot(rows.seen.row(i), walk.y.row(k)) +
                              dot(rows.waves.row(i), walk.waves.row(k)) +
                              (k < JETS ? dot(rows.force.row(i), walk.force.row(k)) : 0);
            there(0, i) += added[i];
            scales[i] = std::abs(constant(i));
            for (std::size_t j = 0; j < walk.y.columns; ++j) {
                double size = 0.0, factor = 1.0;
                for (std::size_t k = 0; k < walk.terms; ++k) {
                    if (k == 3) factor = std::pow(walk.length, 3) / 6;
                    size += factor * std::abs(walk.y(k, j));
                    factor *= (k < 3 ? h : walk.length) / double(k + 1);
                }
                scales[i] += reach[j] * size;
            }
            for (std::size_t j = 1; j < walk.waves.columns; ++j)
                scales[i] += std::abs(rows.waves(i, j));
            for (std::size_t j = 0; j < walk.force.columns; ++j) {
                double size = 0.0, factor = 1.0;
                for (std::size_t k = 0; k < JETS; ++k) {
                    size += factor * std::abs(walk.force(k, j));
                    factor *= walk.length / double(k + 1);
                }
                scales[i] += std::abs(rows.force(i, j)) * size;
            }
        }
    }
};

inline std::unique_ptr<Functions> SeriesGuards::functions(
    std::shared_ptr<const PhaseMotion> motion, Vector shift) const {
    const Walk& begun = static_cast<const SeriesMotion&>(*motion).begun;
    return std::make_unique<SeriesFunctions>(shared_from_this(), begun, std::move(shift));
}

inline std::shared_ptr<Guards> SeriesFlow::guards(GuardRows rows) const {
    return std::make_shared<SeriesGuards>(self<SeriesFlow>(), std::move(rows));
}

}  // namespace kernel
