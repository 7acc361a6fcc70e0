// SPDX-License-Identifier: Apache-2.0

// A run of one contact and one harmonic by Siconos, event-driven, in a process that waits for commands.
//
// Compiled and started by speed.py, with the problem's file as the only argument. Prints
// "ready" when a model is built; "run" simulates it and prints "done", then builds the next one;
// "save FILE" writes what the last run found. What is timed is the simulation's loop alone.

#include <SiconosKernel.hpp>
#include <cmath>
#include <fstream>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

namespace {

const int NONSMOOTH = 2;  // what Siconos calls an event that is not one of its grid

struct Problem {
  unsigned n;
  double seconds, step, tolerance, frequency, gap, restitution;
  std::vector<double> M, C, K, w, cosine, position, velocity;
};

std::vector<double> numbers(std::istream &in, size_t count) {
  std::vector<double> found(count);
  for (double &value : found) in >> value;
  return found;
}

Problem read(const char *path) {
  std::ifstream in(path);
  Problem p;
  in >> p.n >> p.seconds >> p.step >> p.tolerance >> p.frequency >> p.gap >> p.restitution;
  for (auto *square : {&p.M, &p.C, &p.K}) *square = numbers(in, p.n * p.n);
  for (auto *vector : {&p.w, &p.cosine, &p.position, &p.velocity}) *vector = numbers(in, p.n);
  if (!in) throw std::runtime_error("the problem's file ends too early");
  return p;
}

SP::SimpleMatrix matrix(const std::vector<double> &values, unsigned rows, unsigned columns) {
  SP::SimpleMatrix made(new SimpleMatrix(rows, columns));
  for (unsigned i = 0; i < rows; ++i)
    for (unsigned j = 0; j < columns; ++j) (*made)(i, j) = values[i * columns + j];
  return made;
}

SP::SiconosVector vector(const std::vector<double> &values) {
  SP::SiconosVector made(new SiconosVector(values.size()));
  for (unsigned i = 0; i < values.size(); ++i) (*made)(i) = values[i];
  return made;
}

class Body : public LagrangianLinearTIDS {
 public:
  Body(const Problem &p)
      : LagrangianLinearTIDS(vector(p.position), vector(p.velocity), matrix(p.M, p.n, p.n),
                             matrix(p.K, p.n, p.n), matrix(p.C, p.n, p.n)),
        frequency_(p.frequency),
        cosine_(p.cosine) {
    setFExtPtr(vector(p.cosine));
  }
  void computeFExt(double t) override {
    const double now = std::cos(frequency_ * t);
    for (unsigned i = 0; i < cosine_.size(); ++i) (*_fExt)(i) = cosine_[i] * now;
  }

 private:
  double frequency_;
  std::vector<double> cosine_;
};

class Run {
 public:
  explicit Run(const Problem &p) : n_(p.n), body_(std::make_shared<Body>(p)) {
    auto system = std::make_shared<NonSmoothDynamicalSystem>(0.0, p.seconds);
    system->insertDynamicalSystem(body_);
    auto relation = std::make_shared<LagrangianLinearTIR>(
        matrix(p.w, 1, p.n), vector(std::vector<double>(1, p.gap)));
    auto law = std::make_shared<NewtonImpactNSL>(p.restitution);
    system->link(std::make_shared<Interaction>(law, relation), body_);
    simulation_ = std::make_shared<EventDriven>(
        system, std::make_shared<TimeDiscretisation>(0.0, p.step));
    auto integrator = std::make_shared<LsodarOSI>();
    integrator->setTol(1, p.tolerance, p.tolerance);
    simulation_->insertIntegrator(integrator);
    simulation_->insertNonSmoothProblem(std::make_shared<LCP>(), SICONOS_OSNSP_ED_IMPACT);
    simulation_->insertNonSmoothProblem(std::make_shared<LCP>(), SICONOS_OSNSP_ED_SMOOTH_ACC);
    samples_.reserve((2 * n_ + 1) * static_cast<size_t>(p.seconds / p.step + 2));
  }

  void simulate() {
    const SiconosVector &q = *body_->q(), &u = *body_->velocity();
    while (simulation_->hasNextEvent()) {
      simulation_->advanceToEvent();
      const bool impact = simulation_->eventsManager()->nextEvent()->getType() == NONSMOOTH;
      simulation_->processEvents();
      if (impact) {
        impacts_.push_back(simulation_->startingTime());
        continue;
      }
      samples_.push_back(simulation_->startingTime());
      for (unsigned i = 0; i < n_; ++i) samples_.push_back(q(i));
      for (unsigned i = 0; i < n_; ++i) samples_.push_back(u(i));
    }
  }

  void save(const std::string &path) const {
    std::ofstream out(path);
    out.precision(17);
    for (double t : impacts_) out << t << ' ';
    for (size_t i = 0; i < samples_.size(); ++i)
      out << (i % (2 * n_ + 1) ? ' ' : '\n') << samples_[i];
    out << '\n';
  }

 private:
  unsigned n_;
  std::shared_ptr<Body> body_;
  std::shared_ptr<EventDriven> simulation_;
  std::vector<double> impacts_, samples_;
};

}  // namespace

int main(int, char **arguments) {
  const Problem problem = read(arguments[1]);
  auto next = std::make_unique<Run>(problem), last = std::make_unique<Run>(problem);
  std::cout << "ready" << std::endl;
  std::string command;
  while (std::getline(std::cin, command)) {
    if (command == "run") {
      next->simulate();
      std::cout << "done" << std::endl;
      last = std::move(next);
      next = std::make_unique<Run>(problem);
    } else {
      last->save(command.substr(std::string("save ").size()));
      std::cout << "saved" << std::endl;
    }
  }
}
