// SPDX-License-Identifier: Apache-2.0

// The solution of dx/dt = A x + b(t) in closed form, by real pairs of eigenvalues of A, under
// harmonics and a constant force.
#pragma once

#include <array>

#include "divided.hpp"
#include "phase.hpp"

namespace kernel {

// A real pair dy/dt = J y with eigenvalues a +- d: what e^{Js} = c + S (J - a) is made of, and
// e^{as} or, where J does not oscillate, what the slow eigenvalue makes: a bound on c, and on S d.
struct PairExponential {
    double c, S, decay;
};

// `slow` is a + d where it does not oscillate (a + d itself would cancel), else a.
struct Pair {
    double a, d, slow;
    bool oscillates;
    double J[4], D[4];  // D = J - a

    Pair(double a, double d, double slow, bool oscillates, const double* block)
        : a(a), d(d), slow(slow), oscillates(oscillates) {
        for (std::size_t k = 0; k < 4; ++k) J[k] = block[k], D[k] = J[k] - (k % 3 ? 0.0 : a);
    }

    // c = e^{as} cosh(ds), S = e^{as} sinh(ds) / d, without cancellation for any d; zero where
    // they are nothing beside any number that a model can bring about.
    PairExponential propagated(double s) const {
        const double decay = std::exp(slow * s), width = 2 * d * s;
        if (slow * s < -100.0) return {0.0, 0.0, 0.0};
        if (oscillates) return {decay * std::cos(d * s), decay * std::sin(d * s) / d, decay};
        const double ratio = width == 0 ? 1.0 : -std::expm1(-width) / width;
        return {decay * (1 + std::exp(-width)) / 2, decay * s * ratio, decay};
    }

    // y = e^{Js} z of z and D z, beside each other.
    PairExponential carry(double s, const double* z, double* y) const {
        const PairExponential by = propagated(s);
        for (std::size_t k = 0; k < 2; ++k) y[k] = by.c * z[k] + by.S * z[2 + k];
        return by;
    }

    // A bound on c A + S B at any time, over its decay.
    double amplitude(double A, double B) const {
        if (B == 0) return std::abs(A);
        return oscillates ? std::sqrt(A * A + (B / d) * (B / d))
                          : std::abs(A) + std::abs(B) / (2 * d);
    }
};

// A pair and a load Re(beta e^{mu t}) that drives it, answered from the motion's start on by
// (exp[l1, mu] + exp[l1, l2, mu] (J - l1)) beta.
struct DrivenPair {
    std::size_t pair, harmonic;                // 0 is the constant
    Complex one, two, mu, beta[2], turned[2];  // turned = (J - l1) beta

    DrivenPair(std::size_t p, const Pair& pair, std::size_t k, Complex mu, Complex first,
               Complex second)
        : pair(p),
          harmonic(k),
          one(pair.oscillates ? Complex(pair.a, pair.d) : Complex(pair.slow)),
          two(pair.oscillates ? std::conj(one) : Complex(2 * pair.a - pair.slow)),
          mu(mu),
          beta{first, second} {
        for (std::size_t i = 0; i < 2; ++i)
            turned[i] =
                pair.D[2 * i] * first + pair.D[2 * i + 1] * second + (pair.a - one) * beta[i];
    }

    // exp[l1, mu] and exp[l1, l2, mu] at s.
    std::array<Complex, 2> answers(double s) const {
        return {divided(one, mu, s), divided(one, two, mu, s)};
    }
};

// A phase that falls into pairs.
struct ModalFlow : PhaseFlow {
    std::vector<Pair> pairs;
    Matrix response;  // steady, in pairs: 2r x (1 + 2h), for (1, cos, sin)
    Matrix energy;    // weights of a pair's squares in twice the energy, r x 2
    double small;     // root of twice the energy below which a motion is young at its start
    double young;     // how long, s
    std::vector<DrivenPair> near{}, all{};  // loads near resonance; and all loads

    using PhaseFlow::PhaseFlow;
    std::shared_ptr<PhaseMotion> start(const Elapsed& t, const double* x) const override;
    std::shared_ptr<Guards> guards(GuardRows rows) const override;

    // The loads, 2r x (1 + 2h), of those pairs and harmonics that are marked, r x (1 + h).
    std::vector<DrivenPair> drives(const MatrixView& load,
                                   const MatrixViewOf<bool>& marked) const {
        std::vector<DrivenPair> drives;
        const std::size_t h = harmonics.size();
        for (std::size_t p = 0; p < pairs.size(); ++p)
            for (std::size_t k = 0; k <= h; ++k) {
                const auto beta = [&](std::size_t i) {
                    return Complex(load(i, k), k ? -load(i, k + h) : 0.0);
                };
                const Complex mu(0.0, k ? harmonics.frequency[k - 1] : 0.0);
                if (marked(p, k))
                    drives.emplace_back(p, pairs[p], k, mu, beta(2 * p), beta(2 * p + 1));
            }
        return drives;
    }

    // T e^{Js}, transposed, for s of any sign.
    Matrix propagated(double s) const {
        Vector carried(4 * pairs.size());  // of each pair e^{Js}
        for (std::size_t p = 0; p < pairs.size(); ++p) {
            const PairExponential by = pairs[p].propagated(s);
            for (std::size_t k = 0; k < 4; ++k)
                carried[4 * p + k] = (k % 3 == 0 ? by.c : 0.0) + by.S * pairs[p].D[k];
        }
        return coordinates.transposed_transition(carried);
    }
};

// One motion, from a state x at t on. A young one, small against the steady response that it has
// not had time to reach, is answered from its start on for a while.
class ModalMotion : public PhaseMotion {
  public:
    std::shared_ptr<const ModalFlow> modal;
    Vector angles;  // of the harmonics at the start
    bool young;

    ModalMotion(std::shared_ptr<const ModalFlow> of, const Elapsed& t, const double* x)
        : PhaseMotion(of, t, x), modal(std::move(of)), angles(flow->harmonics.angles_at(t)) {
        Vector y(flow->coordinates.size), now(modal->response.columns);
        flow->coordinates.split(x, rest, y.data());
        double squares = 0.0;
        for (std::size_t k = 0; k < y.size(); ++k) squares += modal->energy.data[k] * y[k] * y[k];
        young = std::sqrt(squares) < modal->small;
        if (young) from_start = with_deviator(y);
        add_steady(0.0, -1.0, y.data(), now);
        beside_steady = with_deviator(y);
    }

    bool is_young(double s) const { return young && s < modal->young; }

    // The pairs that go on freely, without what is answered or steady: z and D z.
    const Vector& free(bool early) const { return early ? from_start : beside_steady; }

    // e^{i angle} of what drives, at the start.
    Complex phase(std::size_t harmonic) const {
        return harmonic == 0 ? Complex(1.0) : std::polar(1.0, angles[harmonic - 1]);
    }

    void states(const double* s, std::size_t count, double* rows) const override {
        const std::size_t size = flow->coordinates.size, at_once = 64;  // shapes are read once
        Vector y(std::min(count, at_once) * size), now(modal->response.columns);
        for (std::size_t first = 0; first < count; first += at_once) {
            const std::size_t some = std::min(at_once, count - first);
            for (std::size_t i = 0; i < some; ++i) pairs(s[first + i], &y[i * size], now);
            flow->coordinates.states(y.data(), some, rest, rows + first * 2 * flow->coordinates.n);
        }
    }

  private:
    Vector from_start, beside_steady;  // four numbers a pair: z, D z

    // All pairs at s; `now` is room for 1 + 2h numbers.
    void pairs(double s, double* y, Vector& now) const {
        const bool early = is_young(s);
        const Vector& z = free(early);
        for (std::size_t p = 0; p < modal->pairs.size(); ++p)
            modal->pairs[p].carry(s, &z[4 * p], y + 2 * p);
        for (const DrivenPair& drive : early ? modal->all : modal->near) {
            const auto [one, two] = drive.answers(s);
            const Complex turn = phase(drive.harmonic);
            for (std::size_t k = 0; k < 2; ++k)
                y[2 * drive.pair + k] +=
                    ((one * drive.beta[k] + two * drive.turned[k]) * turn).real();
        }
        if (!early) add_steady(s, 1.0, y, now);
    }

    Vector with_deviator(const Vector& y) const {
        Vector z;
        for (std::size_t p = 0; 2 * p < y.size(); ++p) {
            const double *D = modal->pairs[p].D, one = y[2 * p], two = y[2 * p + 1];
            for (const double each : {one, two, D[0] * one + D[1] * two, D[2] * one + D[3] * two})
                z.push_back(each);
        }
        return z;
    }

    // y += factor times the steady response at s.
    void add_steady(double s, double factor, double* y, Vector& now) const {
        flow->harmonics.waves(angles, s, now.data());
        for (std::size_t k = 0; k < modal->response.rows; ++k)
            y[k] += factor * dot(modal->response.row(k), now);
    }
};

inline std::shared_ptr<PhaseMotion> ModalFlow::start(const Elapsed& t, const double* x) const {
    return std::make_shared<ModalMotion>(self<ModalFlow>(), t, x);
}

}  // namespace kernel
