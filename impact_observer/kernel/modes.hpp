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

// Real pairs dy/dt = J y with eigenvalues a +- d.
#pragma once

#include <cmath>
#include <cstddef>

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

}  // namespace kernel
