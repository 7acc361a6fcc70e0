// Motions of a linear phase under harmonics and a constant force.
#pragma once

#include <cstdint>
#include <memory>

#include "divided.hpp"
#include "modes.hpp"

namespace kernel {

__extension__ typedef unsigned __int128 Turns;

// Seconds since the epoch: whole nanoseconds and a remainder, or one number.
struct Time {
    double seconds;
    bool exact = false;
    std::int64_t ns = 0;
    double remainder = 0.0;
};

// Angles omega t of harmonics, accurate however late it is: turns in a nanosecond are counted in
// parts of 2^-128, so that whole turns are left out before anything is rounded.
struct Harmonics {
    std::vector<double> frequency;  // omega, rad/s
    std::vector<Turns> turns;

    std::size_t size() const { return frequency.size(); }

    std::vector<double> at(const Time& t) const {
        const double part = 6.283185307179586476925286766559 / 0x1p128;
        std::vector<double> found(size());
        for (std::size_t k = 0; k < size(); ++k)
            found[k] = t.exact ? double(Turns(__int128(t.ns)) * turns[k]) * part +
                                     frequency[k] * t.remainder
                               : frequency[k] * t.seconds;
        return found;
    }
};

// A pair and a load Re(beta e^{mu t}) that drives it, answered from the motion's start on by
// (exp[l1, mu] + exp[l1, l2, mu] (J - l1)) beta.
struct Drive {
    std::size_t pair, harmonic;                // 0 is the constant
    Complex one, two, mu, beta[2], turned[2];  // turned = (J - l1) beta

    // exp[l1, mu] and exp[l1, l2, mu] at s.
    void answers(double s, Complex* phi) const {
        const Complex points[3] = {one, two, mu};
        phi[0] = divided(one, mu, s);
        phi[1] = divided(points, 3, s);
    }
};

// All that motions of one phase share.
struct Flow {
    Modes modes;
    Harmonics harmonics;
    Matrix response;  // steady, in pairs: 2n x (1 + 2h), for 1 and each cosine, then each sine
    std::vector<Drive> near, all;  // loads near resonance; and all loads
    Matrix energy;                 // weights of a pair's squares in twice the energy, n x 2
    double small;  // root of twice the energy below which a motion is young at its start
    double young;  // how long, s
};

// One motion, from a state x at t on. A young one, small against the steady response that it has
// not had time to reach, is answered from its start on for a while.
class Motion {
  public:
    std::shared_ptr<const Flow> flow;
    std::vector<double> angles;  // of the harmonics at the start
    bool young;

    Motion(std::shared_ptr<const Flow> of, const Time& t, const double* x) : flow(std::move(of)) {
        angles = flow->harmonics.at(t);
        std::vector<double> y(2 * flow->modes.n);
        flow->modes.split(x, y.data());
        begin(y);
    }

    // From pairs y = T^-1 x.
    Motion(std::shared_ptr<const Flow> of, std::vector<double> at, const std::vector<double>& y)
        : flow(std::move(of)), angles(std::move(at)) {
        begin(y);
    }

    bool is_young(double s) const { return young && s < flow->young; }

    // The pairs that go on freely, without what is answered or steady: z and D z.
    const std::vector<double>& free(bool early) const {
        return early ? from_start : beside_steady;
    }

    // Cosines and sines of the harmonics at s, h of each.
    void waves(double s, double* waves) const {
        const std::size_t h = angles.size();
        for (std::size_t k = 0; k < h; ++k) {
            const double angle = angles[k] + flow->harmonics.frequency[k] * s;
            waves[k] = std::cos(angle);
            waves[h + k] = std::sin(angle);
        }
    }

    // e^{i angle} of what drives, at the start.
    Complex phase(std::size_t harmonic) const {
        return harmonic == 0 ? Complex(1.0) : std::polar(1.0, angles[harmonic - 1]);
    }

    // All pairs at s, x = T y; `now` is room for 1 + 2h numbers.
    void pairs(double s, double* y, double* now) const {
        const bool early = is_young(s);
        const std::vector<double>& z = free(early);
        const Modes& modes = flow->modes;
        for (std::size_t p = 0; p < modes.n; ++p) {
            y[2 * p] = y[2 * p + 1] = 0.0;
            if (modes.pairs[p].dead(s)) continue;
            const Propagated by = modes.pairs[p].propagated(s);
            for (std::size_t k = 0; k < 2; ++k)
                y[2 * p + k] = by.c * z[4 * p + k] + by.S * z[4 * p + 2 + k];
        }
        for (const Drive& drive : early ? flow->all : flow->near) {
            Complex phi[2];
            drive.answers(s, phi);
            const Complex now = phase(drive.harmonic);
            for (std::size_t k = 0; k < 2; ++k)
                y[2 * drive.pair + k] +=
                    ((phi[0] * drive.beta[k] + phi[1] * drive.turned[k]) * now).real();
        }
        if (!early) add_steady(s, 1.0, y, now);
    }

    // States (q, u) at `count` instants, a row each; a row does not depend on the others.
    void states(const double* s, std::size_t count, double* rows) const {
        const std::size_t size = 2 * flow->modes.n;
        std::vector<double> y(size), now(flow->response.columns);
        for (std::size_t i = 0; i < count; ++i) {
            pairs(s[i], y.data(), now.data());
            flow->modes.state(y.data(), rows + i * size);
        }
    }

  private:
    std::vector<double> from_start, beside_steady;  // four numbers a pair: z, D z

    void begin(const std::vector<double>& y) {
        double squares = 0.0;
        for (std::size_t k = 0; k < y.size(); ++k) squares += flow->energy.data[k] * y[k] * y[k];
        young = std::sqrt(squares) < flow->small;
        if (young) from_start = with_deviator(y);
        std::vector<double> z = y;
        std::vector<double> now(flow->response.columns);
        add_steady(0.0, -1.0, z.data(), now.data());
        beside_steady = with_deviator(z);
    }

    std::vector<double> with_deviator(const std::vector<double>& y) const {
        std::vector<double> found(2 * y.size());
        for (std::size_t p = 0; 2 * p < y.size(); ++p) {
            const double *D = flow->modes.pairs[p].D, one = y[2 * p], two = y[2 * p + 1];
            const double four[4] = {one, two, D[0] * one + D[1] * two, D[2] * one + D[3] * two};
            std::copy(four, four + 4, &found[4 * p]);
        }
        return found;
    }

    // y += factor times the steady response at s.
    void add_steady(double s, double factor, double* y, double* now) const {
        const Matrix& response = flow->response;
        now[0] = 1.0;
        waves(s, now + 1);
        for (std::size_t k = 0; k < response.rows; ++k) {
            double sum = 0.0;
            for (std::size_t j = 0; j < response.columns; ++j) sum += response(k, j) * now[j];
            y[k] += factor * sum;
        }
    }
};

}  // namespace kernel
