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

// Motions of a linear phase under harmonics and a constant force, in closed form.
#pragma once

#include "divided.hpp"
#include "modes.hpp"
#include "phase.hpp"

namespace kernel {

// A pair and a load Re(beta e^{mu t}) that drives it, answered from the motion's start on by
// (exp[l1, mu] + exp[l1, l2, mu] (J - l1)) beta.
struct Drive {
    std::size_t pair, harmonic;                // 0 is the constant
    Complex one, two, mu, beta[2], turned[2];  // turned = (J - l1) beta

    // exp[l1, mu] and exp[l1, l2, mu] at s.
    void answers(double s, Complex* phi) const {
        phi[0] = divided(one, mu, s);
        phi[1] = divided(one, two, mu, s);
    }
};

// A phase that falls into pairs.
class ModalFlow : public Flow, public std::enable_shared_from_this<ModalFlow> {
  public:
    std::vector<Pair> pairs;
    Matrix response;               // steady, in pairs: 2r x (1 + 2h), for (1, cos, sin)
    std::vector<Drive> near, all;  // loads near resonance; and all loads
    Matrix energy;                 // weights of a pair's squares in twice the energy, r x 2
    double small;  // root of twice the energy below which a motion is young at its start
    double young;  // how long, s

    ModalFlow(Coordinates coordinates, Harmonics harmonics, std::vector<Pair> pairs,
              Matrix response, Matrix energy, double small, double young)
        : Flow(std::move(coordinates), std::move(harmonics)),
          pairs(std::move(pairs)),
          response(std::move(response)),
          energy(std::move(energy)),
          small(small),
          young(young) {}

    std::shared_ptr<const Motion> start(const Time& t, const double* x) const override;

    // T e^{Js}, transposed, for s of any sign.
    Matrix propagated(double s) const {
        std::vector<double> carried(4 * pairs.size());  // of each pair e^{Js}
        for (std::size_t p = 0; p < pairs.size(); ++p) {
            if (pairs[p].dead(s)) continue;
            const Propagated by = pairs[p].propagated(s);
            for (std::size_t k = 0; k < 4; ++k)
                carried[4 * p + k] = (k % 3 == 0 ? by.c : 0.0) + by.S * pairs[p].D[k];
        }
        return coordinates.carried(carried);
    }

    // Differences of motions, one a column, s seconds later; where no coordinate is held.
    Matrix carried(double s, const View& columns) const {
        const std::size_t count = columns.columns;
        Matrix x(count, columns.rows), y(count, coordinates.size), found(columns.rows, count);
        for (std::size_t k = 0; k < count; ++k) {
            for (std::size_t i = 0; i < columns.rows; ++i) x(k, i) = columns(i, k);
            coordinates.split(x.row(k), {}, y.row(k));
        }
        for (std::size_t p = 0; p < pairs.size(); ++p) {
            const bool dead = pairs[p].dead(s);
            const Propagated by = dead ? Propagated{0, 0, 0} : pairs[p].propagated(s);
            const double* D = pairs[p].D;
            for (std::size_t k = 0; k < count; ++k) {
                double *z = y.row(k) + 2 * p, one = z[0], two = z[1];
                z[0] = by.c * one + by.S * (D[0] * one + D[1] * two);
                z[1] = by.c * two + by.S * (D[2] * one + D[3] * two);
            }
        }
        coordinates.states(y.data.data(), count, {}, x.data.data());
        for (std::size_t k = 0; k < count; ++k)
            for (std::size_t i = 0; i < columns.rows; ++i) found(i, k) = x(k, i);
        return found;
    }
};

// One motion, from a state x at t on. A young one, small against the steady response that it has
// not had time to reach, is answered from its start on for a while.
class ModalMotion : public Motion {
  public:
    std::shared_ptr<const ModalFlow> flow;
    std::vector<double> angles;  // of the harmonics at the start
    std::vector<double> rest;
    bool young;

    ModalMotion(std::shared_ptr<const ModalFlow> of, const Time& t, const double* x)
        : flow(std::move(of)), angles(flow->harmonics.at(t)), rest(flow->coordinates.rest(x)) {
        std::vector<double> y(flow->coordinates.size), now(flow->response.columns);
        flow->coordinates.split(x, rest, y.data());
        double squares = 0.0;
        for (std::size_t k = 0; k < y.size(); ++k) squares += flow->energy.data[k] * y[k] * y[k];
        young = std::sqrt(squares) < flow->small;
        if (young) from_start = with_deviator(y);
        add_steady(0.0, -1.0, y.data(), now.data());
        beside_steady = with_deviator(y);
    }

    bool is_young(double s) const { return young && s < flow->young; }

    // The pairs that go on freely, without what is answered or steady: z and D z.
    const std::vector<double>& free(bool early) const {
        return early ? from_start : beside_steady;
    }

    // e^{i angle} of what drives, at the start.
    Complex phase(std::size_t harmonic) const {
        return harmonic == 0 ? Complex(1.0) : std::polar(1.0, angles[harmonic - 1]);
    }

    void states(const double* s, std::size_t count, double* rows) const override {
        const std::size_t size = flow->coordinates.size, at_once = 64;  // shapes are read once
        std::vector<double> y(std::min(count, at_once) * size), now(flow->response.columns);
        for (std::size_t first = 0; first < count; first += at_once) {
            const std::size_t some = std::min(at_once, count - first);
            for (std::size_t i = 0; i < some; ++i) pairs(s[first + i], &y[i * size], now.data());
            flow->coordinates.states(y.data(), some, rest, rows + first * 2 * flow->coordinates.n);
        }
    }

  private:
    std::vector<double> from_start, beside_steady;  // four numbers a pair: z, D z

    // All pairs at s; `now` is room for 1 + 2h numbers.
    void pairs(double s, double* y, double* now) const {
        const bool early = is_young(s);
        const std::vector<double>& z = free(early);
        for (std::size_t p = 0; p < flow->pairs.size(); ++p) {
            y[2 * p] = y[2 * p + 1] = 0.0;
            if (flow->pairs[p].dead(s)) continue;
            const Propagated by = flow->pairs[p].propagated(s);
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

    std::vector<double> with_deviator(const std::vector<double>& y) const {
        std::vector<double> found(2 * y.size());
        for (std::size_t p = 0; 2 * p < y.size(); ++p) {
            const double *D = flow->pairs[p].D, one = y[2 * p], two = y[2 * p + 1];
            const double four[4] = {one, two, D[0] * one + D[1] * two, D[2] * one + D[3] * two};
            std::copy(four, four + 4, &found[4 * p]);
        }
        return found;
    }

    // y += factor times the steady response at s.
    void add_steady(double s, double factor, double* y, double* now) const {
        const Matrix& response = flow->response;
        flow->harmonics.waves(angles, s, now);
        for (std::size_t k = 0; k < response.rows; ++k) {
            double sum = 0.0;
            for (std::size_t j = 0; j < response.columns; ++j) sum += response(k, j) * now[j];
            y[k] += factor * sum;
        }
    }
};

inline std::shared_ptr<const Motion> ModalFlow::start(const Time& t, const double* x) const {
    return std::make_shared<const ModalMotion>(shared_from_this(), t, x);
}

}  // namespace kernel
