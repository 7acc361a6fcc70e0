// SPDX-License-Identifier: Apache-2.0

// Interfaces of the motions of a linear phase and of guard functions along these motions.
#pragma once

#include <cmath>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>

#include "matrix.hpp"

namespace kernel {

__extension__ typedef unsigned __int128 Turns;

// Seconds since the epoch: whole nanoseconds and a remainder, or one number.
struct Elapsed {
    double seconds;
    bool exact = false;
    std::int64_t ns = 0;
    double remainder = 0.0;
};

// Angles omega t of harmonics, accurate however late it is: turns in a nanosecond are counted in
// parts of 2^-128, so that whole turns are left out before anything is rounded.
struct Harmonics {
    Vector frequency;  // omega, rad/s
    std::vector<Turns> turns;

    std::size_t size() const { return frequency.size(); }

    Vector angles_at(const Elapsed& t) const {
        const double part = 6.283185307179586476925286766559 / 0x1p128;
        Vector angles(size());
        for (std::size_t k = 0; k < size(); ++k)
            angles[k] = t.exact ? double(Turns(__int128(t.ns)) * turns[k]) * part +
                                      frequency[k] * t.remainder
                                : frequency[k] * t.seconds;
        return angles;
    }

    // 1, cosines and sines, s seconds after the instant with these angles.
    void waves(const Vector& angles, double s, double* waves) const {
        const std::size_t h = size();
        waves[0] = 1.0;
        for (std::size_t k = 0; k < h; ++k) {
            const double angle = angles[k] + frequency[k] * s;
            waves[1 + k] = std::cos(angle);
            waves[1 + h + k] = std::sin(angle);
        }
    }
};

// Coordinates y of the motions of a phase: p, u = T y + (rest, 0), where rest = held p_0 stays.
// States are q = Q p + offset and u; at the start p is q.
class Coordinates {
  public:
    std::size_t n, size;  // numbers in q and in y

    // T is 2n x size. Where y are `paired`, coordinates and their velocities side by side, it is
    // the shapes of the coordinates, n x size / 2. `held` and `Q` are n x n, or empty.
    Coordinates(const MatrixView& T, const MatrixView& T_inverse, const MatrixView& held,
                const MatrixView& Q, const MatrixView& offset, bool paired)
        : n(paired ? T.rows : T.rows / 2),
          size(paired ? 2 * T.columns : T.columns),
          paired(paired),
          forward(transposed(T)),
          backward(transposed(T_inverse)),
          held(held),
          Q(Q),
          offset(offset.data, offset.data + offset.rows) {}

    // y = T^-1 (x - rest).
    void split(const double* x, const Vector& rest, double* y) const {
        Vector moves(x, x + 2 * n), parts(size, 0.0);
        for (std::size_t i = 0; i < rest.size(); ++i) moves[i] -= rest[i];
        add_product({moves.data(), paired ? 2u : 1u, backward.rows}, backward, parts.data());
        for (std::size_t k = 0; k < size; ++k) y[k] = parts[place(k)];
    }

    // The part of the position that does not move, n numbers, or none where all moves.
    Vector rest(const double* x) const {
        Vector still(held.rows);
        for (std::size_t i = 0; i < still.size(); ++i) still[i] = dot(held.row(i), x);
        return still;
    }

    // States of rows y. Terms are added in the order of the pairs, whatever else is computed.
    void states(const double* y, std::size_t count, const Vector& rest, double* x) const {
        Vector parts(count * size);
        for (std::size_t i = 0; i < count; ++i) {
            std::fill(std::copy(rest.begin(), rest.end(), x + 2 * n * i), x + 2 * n * (i + 1),
                      0.0);
            for (std::size_t k = 0; k < size; ++k) parts[size * i + place(k)] = y[size * i + k];
        }
        add_product({parts.data(), paired ? 2 * count : count, forward.rows}, forward, x);
        for (std::size_t i = 0; i < count && Q.rows > 0; ++i, x += 2 * n) {
            const Vector p(x, x + n);
            for (std::size_t j = 0; j < n; ++j) x[j] = dot(Q.row(j), p) + offset[j];
        }
    }

    // T E, transposed, size x 2n. E carries each pair by itself: four numbers e_ij.
    Matrix transposed_transition(const Vector& E) const {
        Matrix columns(size, 2 * n);
        for (std::size_t k = 0; k < 2 * size; ++k) {
            const std::size_t p = k / 4, i = k / 2 % 2, j = k % 2;
            add_scaled(E[k], forward.row(paired ? p : 2 * p + i),
                       &columns(2 * p + j, paired ? i * n : 0));
        }
        return columns;
    }

  private:
    bool paired;
    Matrix forward, backward;  // transposed: T and T^-1 by columns
    Matrix held, Q;
    Vector offset;

    // Where y_k stands if all coordinates stand before all velocities.
    std::size_t place(std::size_t k) const { return paired ? k % 2 * (size / 2) + k / 2 : k; }
};

struct PhaseFlow;
class Guards;

// One motion of a phase, from an instant on.
struct PhaseMotion {
    std::shared_ptr<const PhaseFlow> flow;
    Elapsed t;
    Vector rest;  // the part of the position that does not move

    PhaseMotion(std::shared_ptr<const PhaseFlow> of, const Elapsed& t, const double* x);
    virtual ~PhaseMotion() = default;

    // States (q, u) at `count` instants, a row each; a row does not depend on the others.
    virtual void states(const double* s, std::size_t count, double* rows) const = 0;
};

// Functions of the motions of one flow: rows of q, which tell what they see of a position at rest;
// of y, and what these are rounded against; of (1, cos, sin); of sampled forces.
struct GuardRows {
    Matrix position, seen, reach, waves, force;
};

// All motions of a phase.
struct PhaseFlow : std::enable_shared_from_this<PhaseFlow> {
    Coordinates coordinates;
    Harmonics harmonics;

    PhaseFlow(Coordinates coordinates, Harmonics harmonics)
        : coordinates(std::move(coordinates)), harmonics(std::move(harmonics)) {}
    virtual ~PhaseFlow() = default;

    // The motion through x at t.
    virtual std::shared_ptr<PhaseMotion> start(const Elapsed& t, const double* x) const = 0;
    virtual std::shared_ptr<Guards> guards(GuardRows rows) const = 0;
    virtual std::size_t forces() const { return 0; }  // that are sampled

  protected:
    template <class Own>
    std::shared_ptr<const Own> self() const {
        return std::static_pointer_cast<const Own>(shared_from_this());
    }
};

inline PhaseMotion::PhaseMotion(std::shared_ptr<const PhaseFlow> of, const Elapsed& t,
                                const double* x)
    : flow(std::move(of)), t(t), rest(flow->coordinates.rest(x)) {}

constexpr std::size_t ORDERS = 9;     // derivatives 0 to 8
constexpr double MOST_STRIDES = 4e6;  // of a motion: more would take too long

// A motion that would take too long.
struct TooFar : std::runtime_error {
    explicit TooFar(double s)
        : runtime_error("the motion of " + std::to_string(s) +
                        " s takes too many steps; are these stamps right?") {}
};

// Functions along one motion: `look` goes to an instant, and the other methods hold there.
class Functions {
  public:
    virtual ~Functions() = default;
    virtual std::size_t size() const = 0;
    virtual void look(double s) = 0;
    // Until when the functions keep the form that they have there, and where they end, s.
    virtual double smooth_until() const = 0;
    virtual double end() const { return INFINITY; }
    // How fast they may be looked at, strides a second; 0 where it does not matter.
    virtual double rate() const { return 0.0; }
    // A derivative of one function there.
    virtual double derivative(std::size_t order, std::size_t i) const = 0;
    virtual double constant(std::size_t i) const = 0;
    // A bound on one derivative, less the constant, from there to `stop`.
    virtual double bound(std::size_t order, std::size_t i, double stop) = 0;
    // The size of the terms of one function, against which its value is rounded.
    virtual double scale(std::size_t i) = 0;
};

// Functions rows x + waves (1, cos, sin) + forces f of the motions of one flow, w of them.
class Guards : public std::enable_shared_from_this<Guards> {
  public:
    std::shared_ptr<const PhaseFlow> flow;
    GuardRows rows;

    Guards(std::shared_ptr<const PhaseFlow> flow, GuardRows rows)
        : flow(std::move(flow)), rows(std::move(rows)) {}
    virtual ~Guards() = default;

    std::size_t size() const { return rows.position.rows; }

    std::unique_ptr<Functions> along(const std::shared_ptr<const PhaseMotion>& motion) const {
        if (motion->flow != flow) throw std::invalid_argument("motion: of another flow");
        Vector shift(size());
        for (std::size_t i = 0; i < size() && !motion->rest.empty(); ++i)
            shift[i] = dot(rows.position.row(i), motion->rest);
        return functions(motion, std::move(shift));
    }

  private:
    // Of one motion of the flow; `shift` is added to the constants.
    virtual std::unique_ptr<Functions> functions(std::shared_ptr<const PhaseMotion> motion,
                                                 Vector shift) const = 0;
};

}  // namespace kernel
