// Motions of a linear system in its modes: real pairs dy/dt = J y with eigenvalues a +- d.
#pragma once

#include <cmath>

#include "arrays.hpp"
#include "rows.hpp"

namespace kernel {

// What e^{Js} = c + S (J - a) is made of, and e^{as} or, where J does not oscillate, what the slow
// eigenvalue makes: a bound on c, and on S d.
struct Propagated {
    double c, S, decay;
};

// One pair; `slow` is a + d where it does not oscillate (a + d itself would cancel), else a.
struct Pair {
    double a, d, slow;
    bool oscillates;
    double J[4], D[4];  // D = J - a

    // Its exponential is nothing beside any number that a model can bring about.
    bool dead(double s) const { return slow * s < -100.0; }

    // c = e^{as} cosh(ds), S = e^{as} sinh(ds) / d, without cancellation for any d.
    Propagated propagated(double s) const {
        if (oscillates) {
            const double decay = std::exp(a * s);
            return {decay * std::cos(d * s), decay * std::sin(d * s) / d, decay};
        }
        const double decay = std::exp(slow * s), width = 2 * d * s;
        const double ratio = width == 0 ? 1.0 : -std::expm1(-width) / width;
        return {decay * (1 + std::exp(-width)) / 2, decay * s * ratio, decay};
    }

    // A bound on c A + S B at any time, over its decay.
    double amplitude(double A, double B) const {
        if (B == 0) return std::abs(A);
        return oscillates ? std::sqrt(A * A + (B / d) * (B / d))
                          : std::abs(A) + std::abs(B) / (2 * d);
    }
};

// The splitting x = T y of a state (q, u) into n pairs y = (y_1, .., y_n).
class Modes {
  public:
    std::size_t n;
    std::vector<Pair> pairs;

    // T and T^-1, both 2n x 2n; or, where pairs are coordinates and their velocities, the shapes
    // of the modes and what gives their coordinates, n x n.
    Modes(std::vector<Pair> given, const View& T, const View& T_inverse)
        : n(given.size()),
          pairs(std::move(given)),
          forward(T.columns, T.rows),
          backward(T_inverse.columns, T_inverse.rows) {
        for (std::size_t i = 0; i < T.rows; ++i)
            for (std::size_t j = 0; j < T.columns; ++j) {
                forward(j, i) = T(i, j);
                backward(j, i) = T_inverse(i, j);
            }
    }

    bool proportional() const { return forward.rows == n; }

    // x = T y. Terms are added in the order of the pairs, whatever else is computed.
    void state(const double* y, double* x) const {
        std::fill(x, x + 2 * n, 0.0);
        for (std::size_t p = 0; p < n; ++p) {
            if (y[2 * p] == 0 && y[2 * p + 1] == 0) continue;
            for (std::size_t k = 0; k < 2; ++k)
                if (proportional())
                    add(y[2 * p + k], forward.row(p), x + k * n, n);
                else
                    add(y[2 * p + k], forward.row(2 * p + k), x, 2 * n);
        }
    }

    // y = T^-1 x.
    void split(const double* x, double* y) const {
        std::fill(y, y + 2 * n, 0.0);
        if (!proportional()) {
            for (std::size_t i = 0; i < 2 * n; ++i) add(x[i], backward.row(i), y, 2 * n);
            return;
        }
        std::vector<double> part(n);
        for (std::size_t k = 0; k < 2; ++k) {
            std::fill(part.begin(), part.end(), 0.0);
            for (std::size_t i = 0; i < n; ++i) add(x[k * n + i], backward.row(i), part.data(), n);
            for (std::size_t p = 0; p < n; ++p) y[2 * p + k] = part[p];
        }
    }

    // e^{Js} of one pair, row by row.
    void block(std::size_t p, double s, double* e) const {
        const Pair& pair = pairs[p];
        const Propagated by = pair.propagated(s);
        for (std::size_t k = 0; k < 4; ++k) e[k] = (k % 3 == 0 ? by.c : 0.0) + by.S * pair.D[k];
    }

    // T e^{Js} T^-1, for s of any sign.
    Matrix transition(double s) const {
        Matrix found(2 * n, 2 * n);
        double e[4];
        std::vector<double> row(2 * n);
        for (std::size_t p = 0; p < n; ++p) {
            if (pairs[p].dead(s)) continue;
            block(p, s, e);
            for (std::size_t k = 0; k < 4; ++k) {  // e[k] carries y_j to y_i
                const std::size_t i = k / 2, j = k % 2;
                if (e[k] == 0) continue;
                if (proportional()) {
                    for (std::size_t c = 0; c < n; ++c) row[c] = e[k] * backward(c, p);
                    for (std::size_t r = 0; r < n; ++r)
                        add(forward(p, r), row.data(), found.row(i * n + r) + j * n, n);
                } else {
                    for (std::size_t c = 0; c < 2 * n; ++c) row[c] = e[k] * backward(c, 2 * p + j);
                    for (std::size_t r = 0; r < 2 * n; ++r)
                        add(forward(2 * p + i, r), row.data(), found.row(r), 2 * n);
                }
            }
        }
        return found;
    }

  private:
    Matrix forward, backward;  // transposed: T and T^-1 by columns
};

}  // namespace kernel
