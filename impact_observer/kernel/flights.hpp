// SPDX-License-Identifier: Apache-2.0

// The motion of a plant through flights that end with the impact of one open contact each
// (Newton's law; gap and speed of Baumann and Leine, ENOC 2014, equations (2) and (3)).
#pragma once

#include "search.hpp"

namespace kernel {

// An instant: nanoseconds, rounded to the nearest, and what is missing, s.
struct Instant {
    std::int64_t stamp = 0;
    double remainder = 0.0;

    Instant later_by(double seconds) const {
        const double whole = std::nearbyint(seconds * 1e9);
        const double left = (seconds - whole * 1e-9) + remainder;
        const double carry = std::nearbyint(left * 1e9);
        return {stamp + std::int64_t(whole) + std::int64_t(carry), left - carry * 1e-9};
    }

    double until(std::int64_t other) const { return double(other - stamp) / 1e9 - remainder; }
};

// The impact of one contact: g = W^T q + q_r, u+ = u- - kick gamma, q+ = q- - Z g.
struct ContactJump {
    Vector W, kick, Z;   // kick and Z are empty until they are known
    double q_r, length;  // of the column of L^-1 W, M = L L^T

    double gap(const Vector& x) const { return dot(W, x.data()) + q_r; }
    double speed(const Vector& x) const { return dot(W, &x[W.size()]); }

    // A replica through an impact by switched geometric constraints (Baumann and Leine, ENOC 2014,
    // equations (2) to (5)), and others, which differ from it by columns. Those that
    // separate keep their velocities.
    void strike(Vector& x, Matrix& columns) const {
        constexpr double faded = 1e-100;  // as good as zero: denormal numbers are slow
        const std::size_t n = W.size();
        const double gamma = speed(x), g = gap(x);
        const Vector gaps = product(W, columns.part(0, n));
        Vector speeds = product(W, columns.part(n, n));
        for (double& each : speeds) {  // what is lost of each
            const double other = gamma + each;
            if (gamma > 0 || other > 0) each = std::min(other, 0.0) - std::min(gamma, 0.0);
        }
        add_scaled(-g, Z, x.data());
        add_scaled(-std::min(gamma, 0.0), kick, &x[n]);
        for (std::size_t i = 0; i < n; ++i) {
            add_scaled(-Z[i], gaps, columns.row(i));
            add_scaled(-kick[i], speeds, columns.row(n + i));
        }
        const auto has_faded = [](double each) { return std::abs(each) < faded; };
        if (std::all_of(columns.data.begin(), columns.data.end(), has_faded))
            std::fill(columns.data.begin(), columns.data.end(), 0.0);
    }
};

struct Hit {
    Instant instant;
    std::size_t contact;
    double energy;  // kinetic, before
    Vector before, after;

    auto fields() const {
        return std::tie(instant.stamp, instant.remainder, contact, energy, before, after);
    }
};

// What all flights of one plant share. Times that are short against `shortest` are left to others,
// who see accumulation; so are gaps below `lowest`, relative to what they are rounded against.
struct Arena {
    std::shared_ptr<const Guards> gaps;
    Matrix M;
    std::vector<ContactJump> contacts;
    double window, timescale, shortest, lowest;
};

// Flights from an instant on. They end at a crossing that is not a plain impact: of several
// contacts at once, one that may come to rest, one that separates but for rounding, one not known
// yet.
class Flights {
  public:
    std::optional<Crossing> crossing;  // the next crossing, if it is known
    bool ended = false;                // whether it is left to others

    Flights(std::shared_ptr<const Arena> in, const Instant& start, const double* x)
        : arena(std::move(in)), flight(begun(start, x)) {}

    // Flies on through impacts with stamps up to `limit`, at most so many: these impacts.
    std::vector<Hit> advance(std::int64_t limit, std::size_t most) {
        std::vector<Hit> hits;
        ended = false;  // a contact may be known now
        while (hits.size() < most && !ended) {
            if (!crossing) crossing = flight.search.first(flight.start.until(limit) + 0.5e-9);
            if (!crossing || crossing->s > flight.start.until(limit) + 1.0) break;
            const Instant instant = flight.start.later_by(crossing->s);
            if (instant.stamp > limit) break;
            if (std::optional<Hit> hit = impact(instant))
                hits.push_back(std::move(*hit));
            else
                ended = true;
        }
        return hits;
    }

  private:
    struct OpenFlight {
        Instant start;
        std::shared_ptr<PhaseMotion> motion;
        RootSearch search;
    };

    std::shared_ptr<const Arena> arena;
    OpenFlight flight;

    OpenFlight begun(const Instant& start, const double* x) const {
        const Elapsed t{double(start.stamp) / 1e9 + start.remainder, true, start.stamp,
                        start.remainder};
        auto motion = arena->gaps->flow->start(t, x);
        RootSearch search(arena->gaps->along(motion), arena->window);
        return {start, std::move(motion), std::move(search)};
    }

    // Goes through an impact if it is a plain one.
    std::optional<Hit> impact(const Instant& instant) {
        if (crossing->which.size() > 1 || crossing->s <= 2 * arena->shortest) return {};
        const std::size_t i = crossing->which.front(), n = arena->M.rows;
        const ContactJump& contact = arena->contacts[i];
        if (contact.kick.empty()) return {};
        Hit hit{instant, i, 0.0, Vector(2 * n), {}};
        flight.motion->states(&crossing->s, 1, hit.before.data());
        hit.after = hit.before;
        const ConstSpan u = ConstSpan(hit.before).part(n, n);
        if (!(contact.speed(hit.before) < 0)) return {};
        Matrix no_others(2 * n, 0);
        contact.strike(hit.after, no_others);
        for (std::size_t k = 0; k < n; ++k) hit.energy += u[k] * dot(arena->M.row(k), u) / 2;
        const double away = contact.speed(hit.after);
        if (away <= 1e-11 * contact.length * std::sqrt(2 * hit.energy)) return {};
        OpenFlight next = begun(instant, hit.after.data());
        if (may_rest(i, away, next)) return {};
        flight = std::move(next);
        crossing.reset();
        return hit;
    }

    // Whether a contact that separates with speed gamma could be back at once: not if its flight
    // is long and high enough with the acceleration that it has, known to 1e-8 of the largest.
    bool may_rest(std::size_t i, double gamma, OpenFlight& next) const {
        Functions& gaps = next.search.look(0.0);
        const double fall =
            std::max(-gaps.derivative(2, i), 0.0) + 1e-8 * gaps.bound(2, i, arena->timescale);
        const double scale = std::abs(gaps.constant(i)) + gaps.bound(0, i, arena->timescale);
        return gamma <= fall * arena->shortest ||
               gamma * gamma <= 4 * fall * arena->lowest * scale;
    }
};

}  // namespace kernel
