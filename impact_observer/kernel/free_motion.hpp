// SPDX-License-Identifier: Apache-2.0

// The solution of M du = (-C u - K q + f(t)) dt, dq = u dt between impacts, while no contact is
// closed, by Taylor's series (Baumann and Leine, ENOC 2014, equation (1)).
#pragma once

#include <limits>

#include "triangular.hpp"

namespace kernel::kalman {

constexpr double EPS = std::numeric_limits<double>::epsilon();
constexpr double TINY = 1e-150;  // standard deviation, or speed, instead of zero

struct Ignored {
    void operator()(const ConstSpan&) const {}
};

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

    // A x
    Vector rates(const ConstSpan& x) const {
        Vector derivative(size());
        move(x.data, derivative.data());
        return derivative;
    }

    // row A
    Vector row_rates(const ConstSpan& row) const {
        Vector derivative(size());
        move_row(row.data, derivative.data());
        return derivative;
    }

    // x += factor times the derivative of order k of b at t
    void force(double t, int k, double factor, Vector& x) const {
        double* u = x.data() + n();
        if (k == 0) add_scaled(factor, constant, u);
        for (std::size_t i = 0; i < frequency.size(); ++i) {
            const double omega = frequency[i], angle = omega * t;
            const double one = k ? -omega * std::sin(angle) : std::cos(angle);
            const double two = k ? omega * std::cos(angle) : std::sin(angle);
            add_scaled(factor * one, cosine.row(i), u);
            add_scaled(factor * two, sine.row(i), u);
        }
    }

    // Phi(s), by Taylor's series over a part of s that is shorter than the fastest rate's inverse,
    // and then by Phi(2h) = Phi(h) Phi(h).
    Matrix transition(double s) const {
        const int doublings = doublings_of(s);
        Matrix Phi(size(), size());
        for (std::size_t j = 0; j < size(); ++j)
            set_column(Phi, j, 1.0, moved_by(j, std::ldexp(s, -doublings)));
        for (int turn = 0; turn < doublings; ++turn) Phi = product(Phi, Phi);
        return Phi;
    }

    // The state s seconds after x at t; each(term) sees all terms of Taylor's series
    template <class Each = Ignored>
    Vector state_after(double t, Vector x, double s, Each each = {}) const {
        return moved<&FreeMotion::move>(std::move(x), s, &t, each);
    }

    // Phi(s) x
    Vector transition_times(Vector x, double s) const {
        return moved<&FreeMotion::move>(std::move(x), s, nullptr);
    }

    // row Phi(s)
    Vector row_times_transition(Vector row, double s) const {
        return moved<&FreeMotion::move_row>(std::move(row), s, nullptr);
    }

    // What forces add in s seconds, by the constant and by each harmonic that starts as a cosine
    // and as a sine: (1 + 2h) x 2n.
    Matrix pushed(double s) const {
        Matrix responses(1 + 2 * frequency.size(), size());
        FreeMotion one = *this;
        const auto respond = [&](std::size_t k) {
            add_scaled(1.0, one.state_after(0.0, Vector(size()), s), responses.row(k));
        };
        one.frequency = {}, one.cosine = one.sine = Matrix(0, n());
        respond(0);
        one.constant.assign(n(), 0.0), one.cosine = one.sine = Matrix(1, n());
        for (std::size_t i = 0; i < frequency.size(); ++i) {
            one.frequency = {frequency[i]};
            one.cosine = cosine.part(i, 1), one.sine = sine.part(i, 1);
            respond(1 + 2 * i);
            std::swap(one.cosine, one.sine);
            for (double& each : one.sine.data) each = -each;
            respond(2 + 2 * i);
        }
        return responses;
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
        Matrix columns(d, 4 * d), Phi = doublings ? transition(h) : Matrix();
        for (std::size_t k = 0; k < 8; ++k)
            for (std::size_t j = 0; j < n(); ++j) {
                const double node = k < 4 ? nodes[k] : -nodes[k - 4];
                const double size = std::sqrt(weights[k % 4] * h / 2);
                set_column(columns, k * n() + j, size, moved_by(n() + j, (1 + node) * h / 2));
            }
        for (int turn = 0;; ++turn) {
            const Matrix root = squared(std::move(columns));
            if (turn == doublings) return root;
            columns = resized(product(Phi, root), 2 * d);
            put(root, columns, 0, d);
            Phi = product(Phi, Phi);
        }
    }

  private:
    // Taylor's series of what moves by `next`, over s seconds: next(term, to) makes to = A term.
    // Forces from t on are added where they are asked for. each(term) sees all terms.
    template <void (FreeMotion::*next)(const double*, double*) const, class Each = Ignored>
    Vector moved(Vector x, double s, const double* t, Each each = {}) const {
        const double turns = std::abs(s) * rate;
        if (turns == 0.0) return x;
        if (!(turns < 1e9)) return Vector(x.size(), NAN);  // a deviation has overflowed
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
                (this->*next)(term.data(), other.data());
                double* u = other.data() + n();
                if (t && k == 0) add_scaled(1.0, constant, u);
                for (std::size_t i = 0; i < h_count; ++i) {  // h^k / k! times derivative k
                    add_scaled(even[i], cosine.row(i), u);
                    add_scaled(odd[i], sine.row(i), u);
                    const double by = frequency[i] * h / (k + 1), before = even[i];
                    even[i] = -by * odd[i], odd[i] = by * before;
                }
                for (std::size_t i = 0; i < size(); ++i) {
                    term[i] = other[i] * (h / (k + 1));
                    x[i] += term[i];
                }
                each(term);
                size_of_term *= turn / (k + 1);
            }
        }
        return x;
    }

    // How often s is halved until it is shorter than the fastest rate's inverse
    int doublings_of(double s) const {
        const double turns = std::min(std::max(1.0, std::abs(s) * rate), 1e300);
        return int(std::ceil(std::log2(turns)));
    }

    // A column of Phi(s)
    Vector moved_by(std::size_t i, double s) const {
        Vector column(size());
        column[i] = 1.0;
        return transition_times(std::move(column), s);
    }

    static void set_column(Matrix& to, std::size_t j, double factor, const Vector& column) {
        for (std::size_t i = 0; i < column.size(); ++i) to(i, j) = factor * column[i];
    }

    // to = A x
    void move(const double* x, double* to) const {
        for (std::size_t i = 0; i < n(); ++i) {
            double sum = 0.0;
            for (const std::size_t j : filled[i]) sum += lower(i, j) * x[j];
            to[i] = x[n() + i];
            to[n() + i] = sum;
        }
    }

    // to = row A
    void move_row(const double* row, double* to) const {
        std::fill(to, to + n(), 0.0);
        std::copy(row, row + n(), to + n());
        for (std::size_t i = 0; i < n(); ++i)
            for (const std::size_t j : filled[i]) to[j] += row[n() + i] * lower(i, j);
    }
};

// What (q, u) is rounded against: the largest that all modes can give; see Scales.sizes.
struct Sizes {
    Matrix modes, spread;  // n x n each
    Vector squares;        // omega^2 of the modes, n
    double timescale;

    Vector rounding_scale(const ConstSpan& x, double s) const {
        const std::size_t n = modes.rows;
        const Vector a = product(x.part(0, n), modes), b = product(x.part(n, n), modes);
        Vector sizes(2 * n);
        for (std::size_t j = 0; j < n; ++j) {
            const double q = std::abs(a[j]), u = std::abs(b[j]), half = std::max(s, 0.0) / 2;
            add_scaled(q + (timescale + half) * u, spread.row(j), &sizes[0]);
            add_scaled(u + half * squares[j] * q, spread.row(j), &sizes[n]);
        }
        return sizes;
    }
};

}  // namespace kernel::kalman
