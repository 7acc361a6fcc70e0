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

// The motion between impacts, while no contact is closed.
#pragma once

#include <limits>

#include "triangular.hpp"

namespace kernel::kalman {

using Vector = std::vector<double>;

constexpr double EPS = std::numeric_limits<double>::epsilon();
constexpr double LEAST = 1e-150;  // standard deviation, or speed, instead of zero

// dx/dt = A x + b(t), x = (q, u):  du/dt = lower x + constant + sum cosine cos + sine sin.
struct FreeMotion {
    Matrix lower;         // -M^-1 (K C), n x 2n
    Vector constant;      // accelerations, n
    Matrix cosine, sine;  // of harmonics, h x n
    Vector frequency;     // h, rad/s
    double rate, decay;   // bound of all rates; of the fastest fading motion; 1/s
    std::vector<std::vector<std::size_t>> filled{};  // columns of each row of lower

    std::size_t n() const { return lower.rows; }
    std::size_t size() const { return 2 * lower.rows; }

    void prepare() {
        filled.assign(n(), {});
        for (std::size_t i = 0; i < n(); ++i)
            for (std::size_t j = 0; j < size(); ++j)
                if (lower(i, j) != 0.0) filled[i].push_back(j);
    }

    // to = A x
    void rates(const double* x, double* to) const {
        for (std::size_t i = 0; i < n(); ++i) {
            double sum = 0.0;
            for (const std::size_t j : filled[i]) sum += lower(i, j) * x[j];
            to[i] = x[n() + i];
            to[n() + i] = sum;
        }
    }

    // to = row A
    void row_rates(const double* row, double* to) const {
        std::fill(to, to + n(), 0.0);
        std::copy(row, row + n(), to + n());
        for (std::size_t i = 0; i < n(); ++i)
            for (const std::size_t j : filled[i]) to[j] += row[n() + i] * lower(i, j);
    }

    Vector rates(const Vector& x) const {
        Vector found(size());
        rates(x.data(), found.data());
        return found;
    }

    Vector row_rates(const Vector& row) const {
        Vector found(size());
        row_rates(row.data(), found.data());
        return found;
    }

    // x += factor times the derivative of order k of b at t
    void force(double t, int k, double factor, Vector& x) const {
        double* u = x.data() + n();
        if (k == 0) add(factor, constant.data(), u, n());
        for (std::size_t i = 0; i < frequency.size(); ++i) {
            const double omega = frequency[i], angle = omega * t;
            const double one = k ? -omega * std::sin(angle) : std::cos(angle);
            const double two = k ? omega * std::cos(angle) : std::sin(angle);
            add(factor * one, cosine.row(i), u, n());
            add(factor * two, sine.row(i), u, n());
        }
    }

    // Taylor's series of what moves by `next`, over s seconds: next(term, to) makes to = A term.
    // Forces from t on are added where they are asked for. each(term) sees all terms.
    template <class Next, class Each>
    void moved(Vector& x, double s, const double* t, Next next, Each each) const {
        const double turns = std::abs(s) * rate;
        if (turns == 0.0) return;
        if (!(turns < 1e9)) return x.assign(x.size(), NAN);  // a deviation has overflowed
        const std::size_t steps = std::size_t(std::ceil(turns)),
                          h_count = t ? frequency.size() : 0;
        const double h = s / double(steps), turn = turns / double(steps);
        Vector term(size()), other(size()), even(h_count), odd(h_count);
        for (std::size_t step = 0; step < steps; ++step) {
            term = x;
            for (std::size_t i = 0; i < h_count; ++i) {
                const double angle = frequency[i] * (*t + double(step) * h);
                even[i] = std::cos(angle), odd[i] = std::sin(angle);
            }
            double size_of_term = 1.0;
            for (int k = 0; size_of_term > EPS / 16; ++k) {
                next(term.data(), other.data());
                double* u = other.data() + n();
                if (t && k == 0) add(1.0, constant.data(), u, n());
                for (std::size_t i = 0; i < h_count; ++i) {  // h^k / k! times derivative k
                    add(even[i], cosine.row(i), u, n());
                    add(odd[i], sine.row(i), u, n());
                    const double by = frequency[i] * h / (k + 1), before = even[i];
                    even[i] = -by * odd[i], odd[i] = by * before;
                }
                for (std::size_t i = 0; i < size(); ++i) {
                    term[i] = other[i] * (h / (k + 1));
                    x[i] += term[i];
                }
                each(term.data());
                size_of_term *= turn / (k + 1);
            }
        }
    }

    template <class Next>
    void moved(Vector& x, double s, const double* t, Next next) const {
        moved(x, s, t, next, [](const double*) {});
    }

    // Phi(s), by Taylor's series over a part of s that is shorter than the fastest rate's inverse,
    // and then by Phi(2h) = Phi(h) Phi(h).
    Matrix transition(double s) const {
        const int doublings = doublings_of(s);
        Matrix found(size(), size());
        for (std::size_t j = 0; j < size(); ++j) {
            const Vector column = moved_by(j, std::ldexp(s, -doublings));
            for (std::size_t i = 0; i < size(); ++i) found(i, j) = column[i];
        }
        for (int turn = 0; turn < doublings; ++turn) found = twice(found);
        return found;
    }

    // The state s seconds after x at t
    Vector flown(double t, Vector x, double s) const {
        moved(x, s, &t, [&](const double* term, double* to) { rates(term, to); });
        return x;
    }

    // What forces add in s seconds, by the constant and by each harmonic that starts as a cosine
    // and as a sine: (1 + 2h) x 2n.
    Matrix pushed(double s) const {
        Matrix found(1 + 2 * frequency.size(), size());
        FreeMotion one = *this;
        const auto respond = [&](std::size_t k) {
            const Vector x = one.flown(0.0, Vector(size()), s);
            std::copy(x.begin(), x.end(), found.row(k));
        };
        one.frequency = {}, one.cosine = one.sine = Matrix(0, n());
        respond(0);
        one.constant.assign(n(), 0.0), one.cosine = one.sine = Matrix(1, n());
        for (std::size_t i = 0; i < frequency.size(); ++i) {
            one.frequency = {frequency[i]};
            std::copy(cosine.row(i), cosine.row(i) + n(), one.cosine.row(0));
            std::copy(sine.row(i), sine.row(i) + n(), one.sine.row(0));
            respond(1 + 2 * i);
            std::swap(one.cosine, one.sine);
            for (double& each : one.sine.data) each = -each;
            respond(2 + 2 * i);
        }
        return found;
    }

    // Phi(s) x
    Vector carried(Vector x, double s) const {
        moved(x, s, nullptr, [&](const double* term, double* to) { rates(term, to); });
        return x;
    }

    // A square root, 2n x 2n, of what white accelerations add in s >= 0 seconds: the integral of
    // Phi(r) B B^T Phi(r)^T by Gauss and Legendre over a step shorter than the fastest rate's
    // inverse, and then by Q(2h) = Phi(h) Q(h) Phi(h)^T + Q(h).
    Matrix diffusion(double s) const {
        constexpr double nodes[4] = {0.1834346424956498, 0.5255324099163290, 0.7966664774136267,
                                     0.9602898564975363};
        constexpr double weights[4] = {0.3626837833783620, 0.3137066458778873, 0.2223810344533745,
                                       0.1012285362903763};
        const std::size_t d = size();
        const int doublings = doublings_of(s);
        const double h = std::ldexp(s, -doublings);
        Matrix columns(d, 4 * d), Phi = doublings ? transition(h) : Matrix(), root(d, d);
        for (std::size_t k = 0; k < 8; ++k)
            for (std::size_t j = 0; j < n(); ++j) {
                const double node = k < 4 ? nodes[k] : -nodes[k - 4];
                const double size = std::sqrt(weights[k % 4] * h / 2);
                const Vector column = moved_by(n() + j, (1 + node) * h / 2);
                for (std::size_t i = 0; i < d; ++i) columns(i, k * n() + j) = size * column[i];
            }
        for (int turn = 0;; ++turn) {
            make_triangular(columns);
            for (std::size_t i = 0; i < d; ++i)
                std::copy(columns.row(i), columns.row(i) + d, root.row(i));
            if (turn == doublings) return root;
            columns = Matrix(d, 2 * d);
            for (std::size_t i = 0; i < d; ++i) {
                for (std::size_t k = 0; k < d; ++k) add(Phi(i, k), root.row(k), columns.row(i), d);
                std::copy(root.row(i), root.row(i) + d, columns.row(i) + d);
            }
            Phi = twice(Phi);
        }
    }

    // row Phi(s)
    Vector seen(Vector row, double s) const {
        moved(row, s, nullptr, [&](const double* term, double* to) { row_rates(term, to); });
        return row;
    }

  private:
    // How often s is halved until it is shorter than the fastest rate's inverse
    int doublings_of(double s) const {
        const double turns = std::min(std::max(1.0, std::abs(s) * rate), 1e300);
        return int(std::ceil(std::log2(turns)));
    }

    // A column of Phi(s)
    Vector moved_by(std::size_t i, double s) const {
        Vector column(size());
        column[i] = 1.0;
        return carried(std::move(column), s);
    }

    static Matrix twice(const Matrix& Phi) {
        Matrix found(Phi.rows, Phi.rows);
        add_matrix_product(Phi.data.data(), Phi.rows, Phi, found.data.data());
        return found;
    }
};

// What (q, u) is rounded against: the largest that all modes can give; see dynamics.sizes.
struct Sizes {
    Matrix modes, spread;  // n x n each
    Vector squares;        // omega^2 of the modes, n
    double timescale;

    Vector of(const double* x, double s) const {
        const std::size_t n = modes.rows;
        Vector a(n), b(n), found(2 * n);
        for (std::size_t i = 0; i < n; ++i) {
            add(x[i], modes.row(i), a.data(), n);
            add(x[n + i], modes.row(i), b.data(), n);
        }
        for (std::size_t j = 0; j < n; ++j) {
            const double q = std::abs(a[j]), u = std::abs(b[j]), half = std::max(s, 0.0) / 2;
            add(q + (timescale + half) * u, spread.row(j), found.data(), n);
            add(u + half * squares[j] * q, spread.row(j), found.data() + n, n);
        }
        return found;
    }
};

}  // namespace kernel::kalman
