// SPDX-License-Identifier: Apache-2.0

// Divided differences of exp(s z) that stay accurate where their points coincide: the answer of
// a mode to a harmonic or a constant from rest, resonance included.
#pragma once

#include <algorithm>
#include <cmath>
#include <complex>

namespace kernel {

using Complex = std::complex<double>;

// e^z - 1 for Re z <= 0, without cancellation.
inline Complex expm1(Complex z) {
    const double half = std::sin(z.imag() / 2), decay = std::exp(z.real());
    return {std::expm1(z.real()) - 2 * decay * half * half, decay * std::sin(z.imag())};
}

// exp[a, b] = (e^{as} - e^{bs}) / (a - b), and s e^{as} where a = b.
inline Complex divided(Complex a, Complex b, double s) {
    if (a.real() > b.real()) std::swap(a, b);
    const Complex z = (a - b) * s;
    return s * std::exp(b * s) * (z == 0.0 ? Complex(1.0) : expm1(z) / z);
}

// exp[a, b, c], whatever their order; s^2 e^{as} / 2 where all coincide.
inline Complex divided(Complex a, Complex b, Complex c, double s) {
    // The two most distant ones first and last.
    if (std::abs(a - b) > std::abs(a - c)) std::swap(b, c);
    if (std::abs(b - c) > std::abs(a - c)) std::swap(a, b);
    const double distance = std::abs(a - c);
    if (distance * s > 1.0) return (divided(a, b, s) - divided(b, c, s)) / (a - c);
    // s^2 e^{ms} sum_i h_i / (i + 2)! about the mean m, h_i homogeneous symmetric; with 18 terms
    // the first one left out is below 1e-16 of the sum.
    const Complex mean = (a + b + c) / 3.0;
    const Complex parts[3] = {(a - mean) * s, (b - mean) * s, (c - mean) * s};
    Complex symmetric[3] = {1.0, 1.0, 1.0}, total = 0.5;
    double factorial = 2.0;
    for (std::size_t i = 1; i < (distance > 0 ? 18 : 1); ++i) {
        factorial *= double(i + 2);
        symmetric[0] *= parts[0];
        for (std::size_t j = 1; j < 3; ++j)
            symmetric[j] = symmetric[j - 1] + parts[j] * symmetric[j];
        total += symmetric[2] / factorial;
    }
    return s * s * std::exp(mean * s) * total;
}

// A bound on the size of exp[points] of 2 or 3 points without positive real part, until s: of
// order k it is at most s^k / k!, and at most two of order k - 1 over the distance of two points.
inline double divided_bound(Complex a, Complex b, double s) {
    const double apart = std::abs(a - b);
    return apart * s > 2 ? 2 / apart : s;
}

inline double divided_bound(Complex a, Complex b, Complex c, double s) {
    const double ab = divided_bound(a, b, s), bc = divided_bound(b, c, s),
                 ca = divided_bound(c, a, s);
    double bound = s * s / 2;
    if (a != c) bound = std::min(bound, (ab + bc) / std::abs(a - c));
    if (a != b) bound = std::min(bound, (bc + ca) / std::abs(a - b));
    if (b != c) bound = std::min(bound, (ca + ab) / std::abs(b - c));
    return bound;
}

}  // namespace kernel
