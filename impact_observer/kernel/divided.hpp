// Divided differences of exp(s z) that stay accurate where their points coincide: the answer of
// a mode to a harmonic, a step or a ramp from rest, resonance included.
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

constexpr std::size_t MOST_POINTS = 8;

// exp[points], whatever their order; s^k e^{as} / k! where all k + 1 coincide.
inline Complex divided(const Complex* points, std::size_t count, double s) {
    if (count == 2) return divided(points[0], points[1], s);
    std::size_t first = 0, last = 0;
    double distance = -1.0;
    for (std::size_t i = 0; i < count; ++i)
        for (std::size_t j = i + 1; j < count; ++j)
            if (const double apart = std::abs(points[i] - points[j]); apart > distance)
                distance = apart, first = i, last = j;
    Complex ordered[MOST_POINTS];  // the two most distant ones first and last
    std::size_t k = 0;
    ordered[k++] = points[first];
    for (std::size_t i = 0; i < count; ++i)
        if (i != first && i != last) ordered[k++] = points[i];
    ordered[k] = points[last];
    if (distance * s > 1.0)  // the recursion, with the largest distance for its divisor
        return (divided(ordered, k, s) - divided(ordered + 1, k, s)) / (ordered[0] - ordered[k]);
    // s^k e^{ms} sum_i h_i / (i+k)! about the mean m, h_i homogeneous symmetric; with 18 terms
    // the first one left out is below 1e-16 of the sum.
    Complex mean = 0.0, parts[MOST_POINTS], symmetric[MOST_POINTS];
    for (std::size_t i = 0; i < count; ++i) mean += ordered[i] / double(count);
    double factorial = 1.0;
    for (std::size_t i = 0; i < count; ++i) {
        parts[i] = (ordered[i] - mean) * s;
        symmetric[i] = 1.0;
        if (i > 0) factorial *= double(i);
    }
    Complex total = 1.0 / factorial;
    for (std::size_t i = 1; i < (distance > 0 ? 18 : 1); ++i) {
        factorial *= double(i + k);
        symmetric[0] *= parts[0];
        for (std::size_t j = 1; j <= k; ++j)
            symmetric[j] = symmetric[j - 1] + parts[j] * symmetric[j];
        total += symmetric[k] / factorial;
    }
    return std::pow(s, double(k)) * std::exp(mean * s) * total;
}

// A bound on the size of exp[points] of 2 or 3 points without positive real part, until s: of
// order k it is at most s^k / k!, and at most two of order k - 1 over the distance of two points.
inline double largest(Complex a, Complex b, double s) {
    const double apart = std::abs(a - b);
    return apart * s > 2 ? 2 / apart : s;
}

inline double largest(Complex a, Complex b, Complex c, double s) {
    const double ab = largest(a, b, s), bc = largest(b, c, s), ca = largest(c, a, s);
    double found = s * s / 2;
    if (a != c) found = std::min(found, (ab + bc) / std::abs(a - c));
    if (a != b) found = std::min(found, (bc + ca) / std::abs(a - b));
    if (b != c) found = std::min(found, (ca + ab) / std::abs(b - c));
    return found;
}

}  // namespace kernel
