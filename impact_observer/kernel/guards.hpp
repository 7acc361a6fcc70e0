// SPDX-License-Identifier: Apache-2.0

// Guard functions of a modal motion in closed form, with their derivatives and bounds on these.
#pragma once

#include "motion.hpp"

namespace kernel {

// With r T = (r_1, .., r_n), a part for each pair, the k-th derivative of what a pair does freely
// is r_p J_p^k e^{J_p s} z_p. A harmonic has a factor i omega for each derivative. An answer to a
// load has r_p J_p^k in place of r_p and, besides, more and more of the load itself.
class ModalGuards : public Guards {
  public:
    // Of a function to a load: to its answers, and to the load itself.
    struct Response {
        Complex one, two, direct;
    };

    // What differs between a young motion and one with a steady response.
    struct Form {
        const std::vector<DrivenPair>* drives;
        Matrix waves[ORDERS];         // derivatives of what (1, cos, sin) make, w x (1 + 2h)
        Matrix driven;                // sums of their sizes, but for the constant, ORDERS x w
        std::vector<Response> loads;  // ORDERS x w x drives
    };

    std::shared_ptr<const ModalFlow> modal;
    std::array<Matrix, ORDERS> of_pairs;  // r T J^k, w x 2n
    Matrix growth;                        // |lambda|^k, ORDERS x n
    Form early, late;

    ModalGuards(std::shared_ptr<const ModalFlow> of, GuardRows given)
        : Guards(of, std::move(given)), modal(std::move(of)), growth(ORDERS, modal->pairs.size()) {
        of_pairs[0] = rows.seen;
        for (std::size_t k = 1; k < ORDERS; ++k) {
            of_pairs[k] = of_pairs[0];
            for (std::size_t i = 0; i < size(); ++i)
                for (std::size_t p = 0; p < modal->pairs.size(); ++p) {
                    const double *J = modal->pairs[p].J, *r = &of_pairs[k - 1](i, 2 * p);
                    of_pairs[k](i, 2 * p) = r[0] * J[0] + r[1] * J[2];
                    of_pairs[k](i, 2 * p + 1) = r[0] * J[1] + r[1] * J[3];
                }
        }
        for (std::size_t p = 0; p < modal->pairs.size(); ++p)
            for (std::size_t k = 0; k < ORDERS; ++k)
                growth(k, p) =
                    std::pow(std::hypot(modal->pairs[p].a, modal->pairs[p].d), double(k));
        early = form(modal->all, rows.waves);
        Matrix waves = rows.waves;
        add_product(rows.seen, modal->response, waves.data.data());
        late = form(modal->near, waves);
    }

  private:
    std::unique_ptr<Functions> functions(std::shared_ptr<const PhaseMotion> motion,
                                         Vector shift) const override;

    Form form(const std::vector<DrivenPair>& drives, const Matrix& waves) const {
        const std::size_t h = flow->harmonics.size(), r = drives.size(), w = size();
        Form form{&drives, {waves}, Matrix(ORDERS, w), {}};
        for (std::size_t k = 0; k < ORDERS; ++k) {
            Matrix& now = form.waves[k];
            if (k > 0) now = Matrix(w, 1 + 2 * h);
            for (std::size_t i = 0; i < w; ++i) {
                for (std::size_t j = 0; j < h; ++j) {
                    double &even = now(i, 1 + j), &odd = now(i, 1 + h + j);
                    if (k > 0) {
                        const double omega = flow->harmonics.frequency[j];
                        even = omega * form.waves[k - 1](i, 1 + h + j);
                        odd = -omega * form.waves[k - 1](i, 1 + j);
                    }
                    form.driven(k, i) += std::hypot(even, odd);
                }
                for (const DrivenPair& drive : drives) {
                    const double* row = &of_pairs[k].row(i)[2 * drive.pair];
                    Response by{row[0] * drive.beta[0] + row[1] * drive.beta[1],
                                row[0] * drive.turned[0] + row[1] * drive.turned[1], 0.0};
                    if (k > 0) {
                        const Response& before = form.loads[form.loads.size() - w * r];
                        by.direct = drive.mu * before.direct + before.one;
                    }
                    form.loads.push_back(by);
                }
            }
        }
        return form;
    }
};

class ModalFunctions : public Functions {
  public:
    // `shift` is added to the constants.
    ModalFunctions(std::shared_ptr<const ModalGuards> of, std::shared_ptr<const ModalMotion> along,
                   Vector shift)
        : guards(std::move(of)),
          motion(std::move(along)),
          added(std::move(shift)),
          n(guards->modal->pairs.size()),
          h(motion->angles.size()),
          y(2 * n),
          decay(n),
          waves(1 + 2 * h) {
        enter();
    }

    std::size_t size() const override { return guards->size(); }

    double smooth_until() const override { return early ? motion->modal->young : INFINITY; }

    void look(double to) override {
        s = to;
        if (early != motion->is_young(s)) enter();
        const Vector& z = motion->free(early);
        for (std::size_t p = 0; p < n; ++p)
            decay[p] = guards->modal->pairs[p].carry(s, &z[4 * p], &y[2 * p]).decay;
        motion->flow->harmonics.waves(motion->angles, s, waves.data());
        for (std::size_t j = 0; j < phi.size(); ++j) phi[j] = (*form->drives)[j].answers(s);
    }

    double derivative(std::size_t order, std::size_t i) const override {
        // Parts of a constant cancel before anything is added that is rounded against less.
        double value = (order == 0 ? constant(i) : 0.0) + dot(guards->of_pairs[order].row(i), y) +
                       dot(form->waves[order].row(i).part(1, 2 * h), &waves[1]);
        for (std::size_t j = 0; j < phi.size(); ++j) {
            const ModalGuards::Response& by = response(order, i, j);
            const std::size_t of = (*form->drives)[j].harmonic;
            const Complex turn = of ? Complex(waves[of], waves[h + of]) : Complex(1.0);
            const Complex answer = by.one * phi[j][0] + by.two * phi[j][1];
            value += (answer * phase[j] + by.direct * turn).real();
        }
        return value;
    }

    double constant(std::size_t i) const override { return form->waves[0](i, 0) + added[i]; }

    double bound(std::size_t order, std::size_t i, double stop) override {
        if (sizes[0].rows == 0) prepare(0);
        if (sizes[order].rows == 0) prepare(order);
        const double *flat = sizes[order].row(i).data, *value = flat + n, *rate = value + n;
        Two sum = {0, 0};
        std::size_t p = 0;
        for (; p + 2 <= n; p += 2) {
            const Two early = two(value + p) + two(rate + p) * stop, late = two(flat + p);
            sum += two(&decay[p]) * (early < late ? early : late);
        }
        double bound = sum[0] + sum[1] + form->driven(order, i);
        if (p < n) bound += decay[p] * std::min(flat[p], value[p] + rate[p] * stop);
        for (std::size_t j = 0; j < phi.size(); ++j) {
            const DrivenPair& drive = (*form->drives)[j];
            const ModalGuards::Response& by = response(order, i, j);
            bound += std::abs(by.direct) +
                     std::abs(by.one) * divided_bound(drive.one, drive.mu, stop) +
                     std::abs(by.two) * divided_bound(drive.one, drive.two, drive.mu, stop);
        }
        return bound;
    }

    double scale(std::size_t i) override {
        return std::abs(constant(i)) + bound(0, i, s) + dot(decay, rounded.row(i));
    }

  private:
    std::shared_ptr<const ModalGuards> guards;
    std::shared_ptr<const ModalMotion> motion;
    Vector added;
    std::size_t n, h;
    Vector y, decay, waves;
    std::vector<std::array<Complex, 2>> phi;
    std::vector<Complex> phase;
    std::array<Matrix, ORDERS> sizes;  // of each pair: amplitude, c's and S's, w x 3n
    Matrix rounded;                    // w x n
    double s = 0.0;
    bool early = false;
    const ModalGuards::Form* form = nullptr;

    const ModalGuards::Response& response(std::size_t order, std::size_t i, std::size_t j) const {
        return form->loads[(order * size() + i) * phi.size() + j];
    }

    // Takes the form that the motion has at s.
    void enter() {
        early = motion->is_young(s);
        form = early ? &guards->early : &guards->late;
        phi.resize(form->drives->size());
        phase.clear();
        for (const DrivenPair& drive : *form->drives)
            phase.push_back(motion->phase(drive.harmonic));
        sizes = {};
        const Vector& z = motion->free(early);
        rounded = Matrix(size(), n);
        for (std::size_t i = 0; i < size(); ++i)
            for (std::size_t p = 0; p < n; ++p)
                rounded(i, p) = guards->rows.reach(i, 2 * p) * std::abs(z[4 * p]) +
                                guards->rows.reach(i, 2 * p + 1) * std::abs(z[4 * p + 1]);
    }

    // The k-th derivative of a pair that oscillates is |lambda|^k as large as its value.
    void prepare(std::size_t order) {
        const Vector& z = motion->free(early);
        sizes[order] = Matrix(size(), 3 * n);
        for (std::size_t i = 0; i < size(); ++i)
            for (std::size_t p = 0; p < n; ++p) {
                const Pair& pair = guards->modal->pairs[p];
                const double *row = &guards->of_pairs[order].row(i)[2 * p], *of = &z[4 * p];
                const double A = row[0] * of[0] + row[1] * of[1];
                const double B = row[0] * of[2] + row[1] * of[3];
                sizes[order](i, p) = order > 0 && pair.oscillates
                                         ? sizes[0](i, p) * guards->growth(order, p)
                                         : pair.amplitude(A, B);
                sizes[order](i, n + p) = std::abs(A);
                sizes[order](i, 2 * n + p) = std::abs(B);
            }
    }
};

inline std::unique_ptr<Functions> ModalGuards::functions(std::shared_ptr<const PhaseMotion> motion,
                                                         Vector shift) const {
    return std::make_unique<ModalFunctions>(
        std::static_pointer_cast<const ModalGuards>(shared_from_this()),
        std::static_pointer_cast<const ModalMotion>(motion), std::move(shift));
}

inline std::shared_ptr<Guards> ModalFlow::guards(GuardRows rows) const {
    return std::make_shared<ModalGuards>(self<ModalFlow>(), std::move(rows));
}

}  // namespace kernel
