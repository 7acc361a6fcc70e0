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

// The Kalman step at an impact of one contact, while none is closed.
//
// A plant would be at y at the stamp if it had not hit; it has hit e seconds earlier, at its own
// zero of the gap. Gap and state after the impact are functions of (e, y): affine in y, expanded
// to second order in e. With Phi the flow, w the direction of the contact and k its kick,
//
//     gap             g = w^T q,  q of the state  x = flow(y, -e),      dg/de = -gamma
//     after           y+ = y + kappa_0 g + kappa_1 gamma,   kappa = Phi(e) (k 0; 0 k)
//     derivatives     d kappa/de = A kappa,   d rho/de = -rho A,   rho = (w 0; 0 w) Phi(-e)
//
// and g, gamma as rows of y are rho_0, rho_1. The gap that is left is reversed like its speed. So
// an impact changes a covariance's root by a few products of a column and a row.
#pragma once

#include <limits>

#include "triangular.hpp"

namespace kernel::kalman {

constexpr double EPS = std::numeric_limits<double>::epsilon();
constexpr double LEAST = 1e-150;    // standard deviation, or speed, instead of zero
constexpr double SETTLED = 0.05;    // change by another linearisation, in standard deviations
constexpr double CLOSING = 1e-3;    // least deviation of a closing speed, relative to the speed
constexpr double BACK = 8.0;        // longest flow back, in time constants of fading motion
constexpr double MOST_STEPS = 1e4;  // longest flow, in the inverse of the fastest rate
constexpr int ROUNDS = 6;           // most linearisations of a measurement about its posterior
constexpr std::size_t LARGE = 32;   // least size of a state whose roots may have more columns

using Vector = std::vector<double>;

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

    // Phi(s)
    Matrix transition(double s) const {
        Matrix found(size(), size());
        for (std::size_t j = 0; j < size(); ++j) {
            Vector column(size());
            column[j] = 1.0;
            column = carried(std::move(column), s);
            for (std::size_t i = 0; i < size(); ++i) found(i, j) = column[i];
        }
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
        const int doublings = std::max(0, int(std::ceil(std::log2(std::max(s * rate, 1.0)))));
        const double h = std::ldexp(s, -doublings);
        const auto moved_by = [&](std::size_t i, double after) {
            Vector column(d);
            column[i] = 1.0;
            return carried(std::move(column), after);
        };
        Matrix columns(d, 4 * d), Phi(d, d), root(d, d);
        for (std::size_t k = 0; k < 8; ++k)
            for (std::size_t j = 0; j < n(); ++j) {
                const double node = k < 4 ? nodes[k] : -nodes[k - 4];
                const double size = std::sqrt(weights[k % 4] * h / 2);
                const Vector column = moved_by(n() + j, (1 + node) * h / 2);
                for (std::size_t i = 0; i < d; ++i) columns(i, k * n() + j) = size * column[i];
            }
        for (std::size_t j = 0; doublings && j < d; ++j) {
            const Vector column = moved_by(j, h);
            for (std::size_t i = 0; i < d; ++i) Phi(i, j) = column[i];
        }
        for (int turn = 0;; ++turn) {
            make_triangular(columns);
            for (std::size_t i = 0; i < d; ++i)
                std::copy(columns.row(i), columns.row(i) + d, root.row(i));
            if (turn == doublings) return root;
            columns = Matrix(d, 2 * d);
            Matrix twice(d, d);
            for (std::size_t i = 0; i < d; ++i) {
                for (std::size_t k = 0; k < d; ++k) {
                    add(Phi(i, k), root.row(k), columns.row(i), d);
                    add(Phi(i, k), Phi.row(k), twice.row(i), d);
                }
                std::copy(root.row(i), root.row(i) + d, columns.row(i) + d);
            }
            Phi = std::move(twice);
        }
    }

    // row Phi(s)
    Vector seen(Vector row, double s) const {
        moved(row, s, nullptr, [&](const double* term, double* to) { row_rates(term, to); });
        return row;
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

// An estimate, and a root of its covariance: constants are not moved by any flight; the last of
// them, if any, is by how much stamps are late.
struct Prior {
    View x, constants, root, differences;
    double clock;  // standard deviation of the stamp, s
};

struct Posterior {
    Matrix x, constants, root, differences;
};

// An impact as it was predicted.
struct Fit {
    double density;     // logarithm of that of its instant, 1/s
    double normalised;  // innovation, in standard deviations
    double deviation;   // of the innovation, m
};

// Logarithm of the probability that a standard normal variable is below x.
inline double log_normal(double x) {
    if (x > -20.0) return std::log(std::erfc(-x / std::sqrt(2.0)) / 2);
    const double r = 1.0 / (x * x);  // an asymptotic series
    return -x * x / 2 - std::log(-x) - 0.9189385332046727 +
           std::log1p(r * (-1.0 + r * (3.0 + r * (-15.0 + r * 105.0))));
}

// An impact of one contact.
class Impact {
  public:
    FreeMotion motion;
    Sizes sizes;
    Vector w, kick;  // u+ = u + kick gamma, n each
    double rest;     // gap at rest, m

    Fit fit(double t, const Prior& prior) const {
        Fit found;
        corrected(t, prior, 1, found);
        return found;
    }

    Posterior posterior(double t, double flown, const Prior& prior) const {
        Fit fit;
        return jumped(t, flown, corrected(t, prior, ROUNDS, fit));
    }

    // The posterior where the impact was not reported: it is at the zero of the estimate's own
    // gap, near t, and measures nothing. The prior has an infinite clock.
    Posterior missed(double t, double flown, const Prior& prior) const {
        Joint joint = joint_of(prior, false);
        const Place at = place(t, 0.0, vector(prior.x));
        const Vector row = seen_by(at.rho[0], joint.root), speeds = seen_by(at.rho[1], joint.root);
        double deviation = length(row), late = -at.g;
        // Near grazing the acceleration decides the instant: s = sqrt(2 g / a), not g / gamma.
        const double falling = std::sqrt(std::abs(at.a) * (deviation + std::abs(late)));
        const double slope = std::max({-at.gamma, falling, LEAST});
        deviation /= slope;
        joint.z[0] = late / slope;
        double* own = joint.root.row(0);
        for (std::size_t j = 0; j < row.size(); ++j) own[j] = -row[j] / slope;
        own[0] = deviation * length(speeds) / slope + at.a / slope * deviation * deviation / 2;
        const Vector others = seen_by(at.rho[0], joint.differences);
        for (std::size_t j = 0; j < others.size(); ++j)
            joint.differences(0, j) = -others[j] / slope;
        reflect(joint.root, 0);
        return jumped(t, flown, joint);
    }

  private:
    // (e, x, constants): e is by how much the impact is earlier than its stamp. The first row of
    // the root is zero but for its first entry.
    struct Joint {
        Vector z;
        Matrix root, differences;
    };

    // Gap and jump, expanded about an instant and a state.
    struct Place {
        double g, gamma, a, jerk;  // the gap and its derivatives by time
        Vector rho[3];             // g, gamma and w^T A (A x)_u as rows of y
    };

    static Vector vector(const View& v) { return Vector(v.data, v.data + v.size()); }
    static double length(const Vector& v) { return std::sqrt(dot(v.data(), v.data(), v.size())); }

    // Without a stamp e is left to be zero.
    static Joint joint_of(const Prior& p, bool has_stamp = true) {
        const std::size_t d = p.root.rows, c = p.root.columns, size = p.x.size();
        const bool has_offset = has_stamp && p.constants.size() > 0;
        Joint found{Vector(1 + d), Matrix(1 + d, 1 + c), Matrix(1 + d, p.differences.columns)};
        std::copy(p.x.data, p.x.data + size, found.z.begin() + 1);
        std::copy(p.constants.data, p.constants.data + d - size, found.z.begin() + 1 + size);
        for (std::size_t i = 0; i < d; ++i) {
            std::copy(p.root.row(i), p.root.row(i) + c, found.root.row(1 + i) + 1);
            std::copy(p.differences.row(i), p.differences.row(i) + p.differences.columns,
                      found.differences.row(1 + i));
        }
        if (has_stamp) found.root(0, 0) = p.clock;
        if (has_offset) {
            found.z[0] = found.z[d];
            std::copy(found.root.row(d) + 1, found.root.row(d) + 1 + c, found.root.row(0) + 1);
            std::copy(found.differences.row(d), found.differences.row(d) + p.differences.columns,
                      found.differences.row(0));
            reflect(found.root, 0);
        }
        return found;
    }

    // row times the rows of the state in a joint matrix
    static Vector seen_by(const Vector& row, const Matrix& joint) {
        Vector found(joint.columns);
        for (std::size_t i = 0; i < row.size(); ++i)
            if (row[i] != 0.0) add(row[i], joint.row(1 + i), found.data(), joint.columns);
        return found;
    }

    Place place(double t, double e, const Vector& y) const {
        const std::size_t n = motion.n();
        Place found;
        const Vector x = motion.flown(t, y, -e);
        Vector first = motion.rates(x);
        motion.force(t - e, 0, 1.0, first);
        Vector second = motion.rates(first);
        motion.force(t - e, 1, 1.0, second);
        found.g = dot(w.data(), x.data(), n) + rest;
        found.gamma = dot(w.data(), x.data() + n, n);
        found.a = dot(w.data(), first.data() + n, n);
        found.jerk = dot(w.data(), second.data() + n, n);
        Vector of_gap(2 * n), of_speed(2 * n);
        std::copy(w.begin(), w.end(), of_gap.begin());
        std::copy(w.begin(), w.end(), of_speed.begin() + n);
        found.rho[0] = motion.seen(of_gap, -e);
        found.rho[1] = motion.seen(of_speed, -e);
        found.rho[2] = motion.row_rates(found.rho[1]);
        return found;
    }

    // Mean and deviation of e D x + E e^2 / 2, linearised about its best estimate. D x of the
    // columns of a root is `row`, whose first column is that of e.
    static double nonlinear(const Vector& row, double deviation, double E, double& mean) {
        mean = deviation * row[0] + E * deviation * deviation / 2;
        double squares = 2 * mean * mean;
        for (std::size_t j = 1; j < row.size(); ++j)
            squares += deviation * row[j] * deviation * row[j];
        return std::sqrt(squares);
    }

    // e, not so far back that a fading motion grows to rounding.
    double within(double e) const {
        const double fading = motion.decay > 0 ? BACK / motion.decay : MOST_STEPS / motion.rate;
        const double far = std::min(fading, MOST_STEPS / motion.rate);
        return std::clamp(e, -far, far);
    }

    // Instant and state just before the impact, corrected by it: an iterated filter, linearised
    // about its own posterior until that changes next to nothing.
    Joint corrected(double t, const Prior& given, int rounds, Fit& fit) const {
        const Joint prior = joint_of(given);
        const std::size_t d = prior.z.size(), c = prior.root.columns, size = motion.size();
        const Vector y(prior.z.begin() + 1, prior.z.begin() + 1 + size);
        const Vector scale = sizes.of(y.data(), 0.0);
        double rounded = std::abs(rest);
        for (std::size_t i = 0; i < motion.n(); ++i) rounded += std::abs(w[i]) * scale[i];
        rounded = 4 * EPS * rounded + LEAST;

        Vector about = y;
        double e = within(prior.z[0]);
        Joint found = prior;
        for (int turn = 0; turn < rounds; ++turn) {
            const Place at = place(t, e, about);
            Vector speeds = seen_by(at.rho[1], found.root);
            const double slope = -at.gamma;
            double mean, after;
            const double bent = nonlinear(negative(speeds), found.root(0, 0), at.a, mean);
            double value = at.g + slope * (prior.z[0] - e) + mean;
            for (std::size_t i = 0; i < size; ++i) value += at.rho[0][i] * (y[i] - about[i]);
            Matrix joint(1 + d, 1 + c);
            joint(0, 0) = std::hypot(bent, rounded);
            const Vector seen = seen_by(at.rho[0], prior.root);
            for (std::size_t j = 0; j < c; ++j) joint(0, 1 + j) = seen[j];
            joint(0, 1) += slope * prior.root(0, 0);
            for (std::size_t i = 0; i < d; ++i)
                std::copy(prior.root.row(i), prior.root.row(i) + c, joint.row(1 + i) + 1);
            reflect(joint, 0);
            const double white = -value / joint(0, 0);
            if (turn == 0) {
                const double spread = length(seen_by(at.rho[1], prior.root));
                fit = {density(white, std::abs(joint(0, 0)), slope, spread),
                       std::copysign(white, -value), std::abs(joint(0, 0))};
                if (rounds == 1) return found;
            }
            reflect(joint, 1);
            for (std::size_t i = 0; i < d; ++i) {
                found.z[i] = prior.z[i] + joint(1 + i, 0) * white;
                std::copy(joint.row(1 + i) + 1, joint.row(1 + i) + 1 + c, found.root.row(i));
            }
            const double by = found.z[0] - e, clear = found.root(0, 0);
            double change = at.a * by / 2;
            for (std::size_t i = 0; i < size; ++i)
                change -= at.rho[1][i] * (found.z[1 + i] - about[i]);
            after = nonlinear(negative(seen_by(at.rho[1], found.root)), clear, at.a, mean);
            const double enough = SETTLED * std::hypot(std::hypot(slope * clear, bent), rounded);
            if (std::abs(by * change) + std::abs(bent - after) <= enough || turn + 1 == rounds) {
                Vector others = seen_by(at.rho[0], prior.differences);
                add(slope, prior.differences.row(0), others.data(), others.size());
                for (std::size_t i = 0; i < d; ++i)
                    add(-joint(1 + i, 0) / joint(0, 0), others.data(), found.differences.row(i),
                        others.size());
                break;
            }
            e = within(found.z[0]);
            about.assign(found.z.begin() + 1, found.z.begin() + 1 + size);
        }
        return found;
    }

    // The state after the impact, at the stamp: saltation.
    Posterior jumped(double t, double flown, const Joint& joint) const {
        const std::size_t n = motion.n(), size = 2 * n, c = joint.root.columns;
        const std::size_t d = joint.root.rows - 1, others = joint.differences.columns;
        const double e = within(joint.z[0]), late = joint.z[0] - e;
        const Vector y(joint.z.begin() + 1, joint.z.begin() + 1 + size);
        const Place at = place(t, e, y);
        Vector kappa[2] = {Vector(size), Vector(size)};
        for (std::size_t i = 0; i < n; ++i) kappa[0][i] = kappa[1][n + i] = kick[i];
        for (Vector& each : kappa) each = motion.carried(each, e);
        const Vector once[2] = {motion.rates(kappa[0]), motion.rates(kappa[1])};
        const Vector twice[2] = {motion.rates(once[0]), motion.rates(once[1])};

        // y+ = x + first e + 1/2 E e^2, and its mean over the error of e
        const double deviation = joint.root(0, 0);
        Vector row[3];
        for (int k = 0; k < 3; ++k) row[k] = seen_by(at.rho[k], joint.root);
        Matrix x(1, size), bent(3, std::max<std::size_t>(c, 3)), root;
        Vector first(size), mean(size);
        for (std::size_t i = 0; i < size; ++i) {
            const double across = once[1][i] - kappa[0][i];
            first[i] = once[0][i] * at.g + across * at.gamma - kappa[1][i] * at.a;
            const double E = twice[0][i] * at.g + (twice[1][i] - 2 * once[0][i]) * at.gamma +
                             (kappa[0][i] - 2 * once[1][i]) * at.a + kappa[1][i] * at.jerk;
            const double D = once[0][i] * row[0][0] + across * row[1][0] - kappa[1][i] * row[2][0];
            mean[i] = deviation * (D + E * deviation / 2);
            x(0, i) = y[i] + kappa[0][i] * at.g + kappa[1][i] * at.gamma + mean[i] +
                      late * (first[i] + E * late / 2);
        }
        // Noise of the product of both errors: three rows of D, turned into three columns.
        for (std::size_t k = 0; k < 3; ++k)
            for (std::size_t j = 1; j < c; ++j) bent(k, j) = deviation * row[k][j];
        make_triangular(bent);

        const Vector rounding = sizes.of(x.row(0), flown);
        const std::size_t more = c + 4;
        const bool is_final = size < LARGE || 2 * more > 3 * size;
        root = Matrix(d, std::max(d, more + (is_final ? size : 0)));
        for (std::size_t i = 0; i < size; ++i) {
            double* to = root.row(i);
            std::copy(joint.root.row(1 + i), joint.root.row(1 + i) + c, to);
            add(kappa[0][i], row[0].data(), to, c);
            add(kappa[1][i], row[1].data(), to, c);
            to[0] += first[i] * deviation;
            to[c] = std::sqrt(2.0) * mean[i];
            for (std::size_t k = 0; k < 3; ++k)
                to[c + 1 + k] = once[0][i] * bent(0, k) + (once[1][i] - kappa[0][i]) * bent(1, k) -
                                kappa[1][i] * bent(2, k);
        }
        for (std::size_t i = size; i < d; ++i)
            std::copy(joint.root.row(1 + i), joint.root.row(1 + i) + c, root.row(i));
        if (is_final) {  // with the rounding of as many impacts as have added columns
            const double events = c > size ? 1 + double(c - size) / 5 : 1.0;
            for (std::size_t i = 0; i < size; ++i)
                root(i, more + i) = EPS * std::sqrt(events) * rounding[i];
            make_triangular(root);
        }

        Posterior found{std::move(x), Matrix(1, d - size), Matrix(), Matrix(d, others)};
        std::copy(joint.z.begin() + 1 + size, joint.z.end(), found.constants.row(0));
        const Vector gaps = seen_by(at.rho[0], joint.differences);
        const Vector speeds = seen_by(at.rho[1], joint.differences);
        for (std::size_t i = 0; i < d; ++i) {
            double* to = found.differences.row(i);
            std::copy(joint.differences.row(1 + i), joint.differences.row(1 + i) + others, to);
            if (i >= size) continue;
            add(kappa[0][i], gaps.data(), to, others);
            add(kappa[1][i], speeds.data(), to, others);
            add(first[i], joint.differences.row(0), to, others);
        }
        if (is_final) {
            Matrix square(d, d);
            for (std::size_t i = 0; i < d; ++i)
                std::copy(root.row(i), root.row(i) + d, square.row(i));
            root = std::move(square);
        }
        found.root = std::move(root);
        return found;
    }

    // Logarithm of the density of the instant at which a gap goes through zero from above, 1/s.
    static double density(double white, double deviation, double slope, double spread) {
        const double closing = std::max({spread, CLOSING * std::abs(slope), LEAST});
        return std::log(std::hypot(slope, spread) + LEAST) - white * white / 2 -
               std::log(deviation) - 0.9189385332046727 + log_normal(slope / closing);
    }

    static Vector negative(Vector row) {
        for (double& each : row) each = -each;
        return row;
    }
};

}  // namespace kernel::kalman
