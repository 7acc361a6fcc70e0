// SPDX-License-Identifier: Apache-2.0

// The Kalman step at an impact of one contact, while none is closed.
//
// A plant would be at y at the stamp if it had not hit; it has hit e seconds earlier, at its own
// zero of the gap. Gap and state after the impact are functions of (e, y): affine in y, expanded
// to second order in e. With Phi the flow, w the direction of the contact and k its kick,
//
//     gap             g = w^T q + rest,  q of the state  x = flow(y, -e),      dg/de = -gamma
//     after           y+ = y + kappa_0 g + kappa_1 gamma,   kappa = Phi(e) (k 0; 0 k)
//     derivatives     d kappa/de = A kappa,   d rho/de = -rho A,   rho = (w 0; 0 w) Phi(-e)
//
// and g, gamma as rows of y are rho_0, rho_1. The gap that is left is reversed like its speed. So
// an impact changes a covariance's root by a few products of a column and a row.
//
// Parameters theta of the model are estimated with the state: each hypothesis is a system of its
// own. Those that are considered have an error, but keep their values. Where velocities jump a
// time tau after the onset, kappa_1 = Phi(e) (1 - tau A) (0; k).
#pragma once

#include <array>
#include <optional>

#include "family.hpp"

namespace kernel::kalman {

constexpr double SETTLED = 0.05;    // change by another linearisation, in standard deviations
constexpr double CLOSING = 1e-3;    // least deviation of a closing speed, relative to the speed
constexpr double BACK = 8.0;        // longest flow back, in time constants of fading motion
constexpr double MOST_STEPS = 1e4;  // longest flow, in the inverse of the fastest rate
constexpr double SLOWEST = 1e-6;    // least of that rate, 1/s
constexpr double TIME_SHARE = 0.1;  // share of the rounding of t in the rounding of a state
constexpr int ROUNDS = 6;           // most linearisations of a measurement about its posterior
constexpr std::size_t LARGE = 32;   // least size of a state whose roots may have more columns

// An estimate, and a root of its covariance. Constants are not moved by any flight: parameters,
// and then, if there is one more, by how much stamps are late.
struct Prior {
    MatrixView x, constants, root, differences;
    double clock;  // standard deviation of the stamp, s
};

struct Posterior {
    Vector x, constants;
    Matrix root, differences;

    auto fields() const { return std::tie(x, constants, root, differences); }
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

// Logarithm of the mean of max(v, 0) for a normal variable v.
inline double log_mean_positive(double mean, double deviation) {
    const double sigma = std::max({deviation, CLOSING * std::abs(mean), TINY}), z = mean / sigma;
    const double log_density = -z * z / 2 - 0.9189385332046727;
    if (z > -20.0)
        return std::log(sigma) +
               std::log(std::exp(log_density) + z * std::erfc(-z / std::sqrt(2.0)) / 2);
    const double r = 1.0 / (z * z);  // an asymptotic series
    return std::log(sigma) + log_density + std::log(r) +
           std::log1p(r * (-3.0 + r * (15.0 + r * (-105.0 + r * 945.0))));
}

// An impact of one contact.
class Impact {
  public:
    std::shared_ptr<const Family> family;
    Vector w, kick;  // u+ = u + kick gamma, n each
    double rest;     // gap at rest, m
    Matrix kicks;    // what a unit of each parameter adds to the kick, p x n
    Vector rests;    // to the gap, p
    Vector lags;     // and to the time after the onset at which velocities jump, p

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
    // gap, near t, and measures nothing. The clock of the prior is not used.
    Posterior missed(double t, double flown, const Prior& prior) const {
        Joint joint = joint_of(prior, false);
        const Law law = law_of(prior.constants);
        const Place at = place(law, t, 0.0, ConstSpan(joint.z).part(1, joint.z.size() - 1));
        const Vector row = seen_by(at.rho[0], joint.root), speeds = seen_by(at.rho[1], joint.root);
        double deviation = length(row), late = -at.g;
        // Near grazing the acceleration decides the instant: s = sqrt(2 g / a), not g / gamma.
        const double falling = std::sqrt(std::abs(at.a) * (deviation + std::abs(late)));
        // A gap that stands still tells no instant: its error stays one that can be followed.
        const double least = (deviation + std::abs(late)) / farthest();
        const double slope = std::max({-at.gamma, falling, least, TINY});
        deviation /= slope;
        joint.z[0] = late / slope;
        const Span<double> own = joint.root.row(0);
        for (std::size_t j = 0; j < row.size(); ++j) own[j] = -row[j] / slope;
        own[0] =
            within(deviation * length(speeds) / slope + at.a / slope * deviation * deviation / 2);
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

    // The impact of one member.
    struct Law {
        std::shared_ptr<const FreeMotion> motion;
        Vector kick;
        double rest, lag;
    };

    // Gap and jump, expanded about an instant and a state.
    struct Place {
        double g, gamma, a, jerk;  // the gap and its derivatives by time
        Vector rho[3];             // g, gamma and its rate w^T (A x)_u as rows of y and theta
    };

    Law law_of(const ConstSpan& theta) const { return law_of(theta, family->member(theta)); }

    Law law_of(const ConstSpan& theta, std::shared_ptr<const FreeMotion> motion) const {
        Law found{std::move(motion), kick, rest, 0.0};
        for (std::size_t j = 0; j < family->count(); ++j) {
            const double by = theta[j] - family->nominal[j];
            add_scaled(by, kicks.row(j), found.kick);
            found.rest += by * rests[j], found.lag += by * lags[j];
        }
        return found;
    }

    // Without a stamp e is left to be zero.
    Joint joint_of(const Prior& p, bool has_stamp = true) const {
        const std::size_t d = p.root.rows;
        Joint found{Vector(1 + d), {1 + d, 1 + p.root.columns}, {1 + d, p.differences.columns}};
        auto to = found.z.begin() + 1;
        for (const ConstSpan& part : {ConstSpan(p.x), ConstSpan(p.constants)})
            to = std::copy(part.begin(), part.end(), to);
        put(p.root, found.root, 1, 1);
        put(p.differences, found.differences, 1, 0);
        if (has_stamp) found.root(0, 0) = p.clock;
        if (has_stamp && p.constants.size() > family->count()) {  // with an offset
            found.z[0] = found.z[d];
            put(p.root.part(d - 1, 1), found.root, 0, 1);
            put(p.differences.part(d - 1, 1), found.differences, 0, 0);
            reflect(found.root, 0);
        }
        return found;
    }

    // row times the rows of the state in a joint matrix
    static Vector seen_by(const Vector& row, const Matrix& joint) {
        return product(row, joint.part(1, row.size()));
    }

    Place place(const Law& law, double t, double e, const ConstSpan& y) const {
        const FreeMotion& motion = *law.motion;
        const std::size_t n = motion.n();
        const Vector x = motion.state_after(t, y.part(0, 2 * n), -e);
        Vector first = motion.rates(x);
        motion.force(t - e, 0, 1.0, first);
        Vector second = motion.rates(first);
        motion.force(t - e, 1, 1.0, second);
        Vector of_gap(2 * n), of_speed(2 * n);
        std::copy(w.begin(), w.end(), of_gap.begin());
        std::copy(w.begin(), w.end(), of_speed.begin() + n);
        Place found{dot(w, x.data()) + law.rest,
                    dot(w, &x[n]),
                    dot(w, &first[n]),
                    dot(w, &second[n]),
                    {motion.row_times_transition(std::move(of_gap), -e),
                     motion.row_times_transition(std::move(of_speed), -e),
                     {}}};
        found.rho[2] = motion.row_rates(found.rho[1]);
        for (Vector& row : found.rho) row.resize(2 * n + family->count());
        std::copy(rests.begin(), rests.end(), found.rho[0].begin() + 2 * n);
        for (std::size_t j = 0; j < family->moving(); ++j)  // of first order in e
            found.rho[1][2 * n + j] = -e * dot(w, family->acceleration_change(j, x, t - e));
        return found;
    }

    // Mean and deviation of e D x + E e^2 / 2, linearised about its best estimate. The first
    // column of the root is that of e.
    static double nonlinear(const Place& at, const Matrix& root, double& mean) {
        const Vector D = seen_by(at.rho[1], root);
        const double deviation = root(0, 0);
        mean = -deviation * D[0] + at.a * deviation * deviation / 2;
        double squares = 2 * mean * mean;
        for (std::size_t j = 1; j < D.size(); ++j) squares += deviation * D[j] * deviation * D[j];
        return std::sqrt(squares);
    }

    // Longest time between an impact and its stamp over which a state is followed, s: a motion
    // that fades grows going back, and is rounding after some time constants.
    double farthest() const {
        const FreeMotion& motion = *family->given;
        const double longest = MOST_STEPS / std::max(motion.rate, SLOWEST);
        return motion.decay > 0 ? std::min(BACK / motion.decay, longest) : longest;
    }

    double within(double e) const { return std::clamp(e, -farthest(), farthest()); }

    // Instant and state just before the impact, corrected by it: an iterated filter, linearised
    // about its own posterior until that changes next to nothing.
    Joint corrected(double t, const Prior& given, int rounds, Fit& fit) const {
        const Joint prior = joint_of(given);
        const std::size_t d = prior.z.size();
        const std::size_t size = given.x.size() + family->count();  // of (y, theta)
        const ConstSpan y = ConstSpan(prior.z).part(1, size);
        const Vector scale = family->sizes.rounding_scale(y, 0.0);
        Law law = law_of(given.constants);
        double rounded = std::abs(law.rest);
        for (std::size_t i = 0; i < w.size(); ++i) rounded += std::abs(w[i]) * scale[i];
        rounded = 4 * EPS * rounded + TINY;

        Vector about = y;
        double e = within(prior.z[0]);
        Joint found = prior;
        const Parameters& parameters = family->parameters;
        const std::size_t beside = 1 + given.x.size();  // the parameters' first row
        if (parameters.considers()) found.root = resized(prior.root, prior.root.columns + 1);
        for (int turn = 0; turn < rounds; ++turn) {
            const Place at = place(law, t, e, about);
            const double slope = -at.gamma;
            double mean;
            const double bent = nonlinear(at, found.root, mean);
            double value = at.g + slope * (prior.z[0] - e) + mean;
            for (std::size_t i = 0; i < size; ++i) value += at.rho[0][i] * (y[i] - about[i]);
            Matrix joint(1 + d, 1 + prior.root.columns);
            joint(0, 0) = std::hypot(bent, rounded);
            const Vector seen = seen_by(at.rho[0], prior.root);
            std::copy(seen.begin(), seen.end(), &joint(0, 1));
            joint(0, 1) += slope * prior.root(0, 0);
            put(prior.root, joint, 1, 1);
            reflect(joint, 0);
            const double white = -value / joint(0, 0);
            if (turn == 0) {
                // the closing speed -gamma + a e, given that the gap is zero
                Vector closing = joint.row(1);
                for (double& each : closing) each *= at.a;
                for (std::size_t i = 0; i < size; ++i)
                    add_scaled(-at.rho[1][i], joint.row(2 + i), closing);
                const double mean_given = slope + closing[0] * white;
                closing[0] = 0.0;
                fit = {density(white, std::abs(joint(0, 0)), mean_given, length(closing)),
                       std::copysign(white, -value), std::abs(joint(0, 0))};
                if (rounds == 1) return found;
            }
            reflect(joint, 1);
            for (std::size_t i = 0; i < d; ++i) {
                std::copy(&joint(1 + i, 1), joint.row(1 + i).end(), found.root.row(i).data);
                // Joint gain (Schmidt): a considered parameter keeps its value and its error.
                if (parameters.is_considered(i, beside))
                    found.root(i, prior.root.columns) = joint(1 + i, 0);
                else
                    found.z[i] = prior.z[i] + joint(1 + i, 0) * white;
            }
            const double by = found.z[0] - e, clear = found.root(0, 0);
            double change = at.a * by / 2;
            for (std::size_t i = 0; i < size; ++i)
                change -= at.rho[1][i] * (found.z[1 + i] - about[i]);
            const double after = nonlinear(at, found.root, mean);
            const double enough = SETTLED * std::hypot(std::hypot(slope * clear, bent), rounded);
            if (family->count()) parameters.clamp_estimate(found.z, found.root, beside);
            if (std::abs(by * change) + std::abs(bent - after) <= enough || turn + 1 == rounds) {
                Vector others = seen_by(at.rho[0], prior.differences);
                add_scaled(slope, prior.differences.row(0), others);
                for (std::size_t i = 0; i < d; ++i)
                    if (!parameters.is_considered(i, beside))
                        add_scaled(-joint(1 + i, 0) / joint(0, 0), others,
                                   found.differences.row(i));
                break;
            }
            e = within(found.z[0]);
            about = ConstSpan(found.z).part(1, size);
            if (family->count())
                law = law_of(ConstSpan(about).part(given.x.size(), family->count()));
        }
        return found;
    }

    // How the state y+ changes with parameters of the jump. `at` is the place of (e, y). The
    // linear part is that of (g, gamma). Of parameters that are known, or do not change the jump,
    // nothing is asked.
    Sensitivity jump_by(const Law& law, const Place& at, double e, const Vector& theta,
                        const MatrixView& own, const MatrixView& others) const {
        const std::size_t size = 2 * w.size();
        const auto jumped = [&](const Vector& other) {
            const Law its = law_of(other, law.motion);
            const std::array<Vector, 2> kappa = kicked(its, *family->given, e);
            AffineMap found{Vector(size), Matrix(size, 2)};
            add_scaled(at.g + its.rest - law.rest, kappa[0], found.value);
            add_scaled(at.gamma, kappa[1], found.value);
            for (std::size_t i = 0; i < size; ++i)
                found.linear(i, 0) = kappa[0][i], found.linear(i, 1) = kappa[1][i];
            return found;
        };
        Vector steps = family->parameters.steps(theta, own, others);
        for (std::size_t j = 0; j < steps.size(); ++j)
            if (!rests[j] && !lags[j] && length(kicks.row(j)) == 0.0) steps[j] = 0.0;
        const auto value = [&](const Vector& other) { return jumped(other).value; };
        return {jumped, value, theta, steps};
    }

    // kappa of a law, of which a lag is multiplied by the damping of one of the members.
    std::array<Vector, 2> kicked(const Law& law, const FreeMotion& damped, double e) const {
        const std::size_t n = w.size();
        std::array<Vector, 2> kappa = {Vector(2 * n), Vector(2 * n)};
        std::copy(law.kick.begin(), law.kick.end(), kappa[0].begin());
        std::copy(law.kick.begin(), law.kick.end(), kappa[1].begin() + n);
        add_scaled(-law.lag, damped.rates(kappa[1]), kappa[1]);
        for (Vector& each : kappa) each = law.motion->transition_times(std::move(each), e);
        return kappa;
    }

    // The state after the impact, at the stamp: saltation.
    Posterior jumped(double t, double flown, const Joint& joint) const {
        const std::size_t n = w.size(), size = 2 * n, c = joint.root.columns, p = family->count();
        const std::size_t d = joint.root.rows - 1;
        const double e = within(joint.z[0]), late = joint.z[0] - e;
        const ConstSpan y = ConstSpan(joint.z).part(1, d), theta = y.part(size, p);
        const Law law = law_of(theta);
        const FreeMotion& motion = *law.motion;
        const Place at = place(law, t, e, y);
        const std::array<Vector, 2> kappa = kicked(law, motion, e);
        const Vector once[2] = {motion.rates(kappa[0]), motion.rates(kappa[1])};
        const Vector twice[2] = {motion.rates(once[0]), motion.rates(once[1])};

        // y+ = x + first e + 1/2 E e^2, and its mean over the error of e
        const double deviation = joint.root(0, 0);
        Vector row[3], x(size), first(size), mean(size);
        for (int k = 0; k < 3; ++k) row[k] = seen_by(at.rho[k], joint.root);
        for (std::size_t i = 0; i < size; ++i) {
            const double across = once[1][i] - kappa[0][i];
            first[i] = once[0][i] * at.g + across * at.gamma - kappa[1][i] * at.a;
            const double E = twice[0][i] * at.g + (twice[1][i] - 2 * once[0][i]) * at.gamma +
                             (kappa[0][i] - 2 * once[1][i]) * at.a + kappa[1][i] * at.jerk;
            const double D = once[0][i] * row[0][0] + across * row[1][0] - kappa[1][i] * row[2][0];
            mean[i] = deviation * (D + E * deviation / 2);
            x[i] = y[i] + kappa[0][i] * at.g + kappa[1][i] * at.gamma + mean[i] +
                   late * (first[i] + E * late / 2);
        }
        // Noise of the product of both errors: three rows of D, turned into three columns.
        Matrix bent(3, std::max<std::size_t>(c, 3));
        for (std::size_t k = 0; k < 3; ++k)
            for (std::size_t j = 1; j < c; ++j) bent(k, j) = deviation * row[k][j];
        make_triangular(bent);

        Matrix by_theta, curved;  // p x size: of y+ but for the gap's part in g; and noise
        if (p) {
            // The noise depends on the root: take one that is unique.
            const Matrix whole = leading(squared(joint.root), 1 + size, p);
            const MatrixView own = whole.part(1 + size, p);
            Sensitivity by = jump_by(law, at, e, theta, own, joint.differences.part(1 + size, p));
            Matrix seen(2, whole.columns);
            for (std::size_t k = 0; k < 2; ++k)
                add_product({at.rho[k].data(), 1, size}, whole.part(1, size), seen.row(k).data);
            curved = by.noise(seen, own);
            Vector jump(size);
            add_scaled(at.g, kappa[0], jump);
            add_scaled(at.gamma, kappa[1], jump);
            for (std::size_t j = 0; j < p; ++j) add_scaled(-rests[j], kappa[0], by.first.row(j));
            for (std::size_t j = 0; j < family->moving(); ++j)  // of first order in e
                add_scaled(e, family->acceleration_change(j, jump), &by.first(j, n));
            by_theta = std::move(by.first);
        }
        // Adds what gap, speed and parameters make of the errors to those of y+.
        const auto jump = [&](std::size_t i, const Matrix& errors, const Vector& gaps,
                              const Vector& speeds, double* to) {
            add_scaled(kappa[0][i], gaps, to);
            add_scaled(kappa[1][i], speeds, to);
            for (std::size_t j = 0; j < p; ++j)
                add_scaled(by_theta(j, i), errors.row(1 + size + j), to);
        };

        Vector rounding = family->sizes.rounding_scale(x, flown);
        if (!motion.frequency.empty())
            for (double& each : rounding)
                each *= 1.0 + TIME_SHARE * std::abs(t) / family->sizes.timescale;
        const std::size_t more = c + 4 + curved.columns;
        const bool is_final = p || size < LARGE || 2 * more > 3 * size;
        Matrix root(d, std::max(d, more + (is_final ? size : 0)));
        put(joint.root.part(1, d), root, 0, 0);
        put(curved, root, 0, c + 4);
        for (std::size_t i = 0; i < size; ++i) {
            double* to = root.row(i).data;
            jump(i, joint.root, row[0], row[1], to);
            to[0] += first[i] * deviation;
            to[c] = std::sqrt(2.0) * mean[i];
            for (std::size_t k = 0; k < 3; ++k)
                to[c + 1 + k] = once[0][i] * bent(0, k) + (once[1][i] - kappa[0][i]) * bent(1, k) -
                                kappa[1][i] * bent(2, k);
        }
        if (is_final) {  // with the rounding of as many impacts as have added columns
            const double events = c > size && !p ? 1 + double(c - size) / 5 : 1.0;
            for (std::size_t i = 0; i < size; ++i)
                root(i, more + i) = EPS * std::sqrt(events) * rounding[i];
            root = squared(std::move(root));
        }

        Matrix differences = joint.differences.part(1, d);
        const Vector gaps = seen_by(at.rho[0], joint.differences);
        const Vector speeds = seen_by(at.rho[1], joint.differences);
        for (std::size_t i = 0; i < size; ++i) {
            jump(i, joint.differences, gaps, speeds, differences.row(i).data);
            add_scaled(first[i], joint.differences.row(0), differences.row(i));
        }
        return {std::move(x), y.part(size, d - size), std::move(root), std::move(differences)};
    }

    // Logarithm of the density of the instant at which a gap goes through zero from above, 1/s
    // (Rice, Mathematical analysis of random noise, 1945): that of the gap, times the mean of the
    // closing speed where that is positive. Speed and spread are those at a gap of zero.
    static double density(double white, double deviation, double speed, double spread) {
        return log_mean_positive(speed, spread) - white * white / 2 - std::log(deviation) -
               0.9189385332046727;
    }
};

}  // namespace kernel::kalman
