// Adjustments solved by Ceres: analytic Jacobians, blocks of fixed size (2 residuals, 3 of a landmark, 3 of a camera),
// dense Schur complement, one thread.
//
// The argument is a file of doubles: the number of windows, then for each the numbers of views, landmarks, pixels and
// distances; fx, fy, cx, cy; per view its attitude (9, by rows, body to camera), position and whether it is free; per
// landmark its position; per pixel view, landmark, u, v, sigma; per distance view, landmark, metres, sigma.
// Reads lines "WINDOW REPETITIONS TOLERANCE" from standard input and answers each by a line: mean processor seconds of
// building the problem and of solving it, and the positions of the views and of the landmarks at the end.

#include <ceres/ceres.h>

#include <cmath>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <memory>
#include <vector>

namespace {

struct View {
  double attitude[9];
  double position[3];
  double is_free;
};
struct Sighting {
  double view, landmark, u, v, sigma;
};
struct Distance {
  double view, landmark, metres, sigma;
};
struct Window {
  double lens[4];
  std::vector<View> views;
  std::vector<double> landmarks;
  std::vector<Sighting> sightings;
  std::vector<Distance> distances;
};

// Blocks: landmark, camera position. The derivative by the position is the negative of that by the landmark.
class PixelCost final : public ceres::SizedCostFunction<2, 3, 3> {
 public:
  PixelCost(const double* lens, const double* attitude, const Sighting& seen)
      : lens_(lens), attitude_(attitude), u_(seen.u), v_(seen.v), weight_(1.0 / seen.sigma) {}

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const double* r = attitude_;
    const double a = blocks[0][0] - blocks[1][0], b = blocks[0][1] - blocks[1][1], c = blocks[0][2] - blocks[1][2];
    const double depth = r[6] * a + r[7] * b + r[8] * c;
    if (!(depth > 0.0)) return false;
    const double over = 1.0 / depth;
    const double x = (r[0] * a + r[1] * b + r[2] * c) * over, y = (r[3] * a + r[4] * b + r[5] * c) * over;
    residuals[0] = (lens_[0] * x + lens_[2] - u_) * weight_;
    residuals[1] = (lens_[1] * y + lens_[3] - v_) * weight_;
    if (jacobians == nullptr) return true;
    const double by_x = lens_[0] * over * weight_, by_y = lens_[1] * over * weight_;
    for (int k = 0; k < 3; ++k) {
      const double row0 = by_x * (r[k] - x * r[6 + k]), row1 = by_y * (r[3 + k] - y * r[6 + k]);
      if (jacobians[0] != nullptr) jacobians[0][k] = row0, jacobians[0][3 + k] = row1;
      if (jacobians[1] != nullptr) jacobians[1][k] = -row0, jacobians[1][3 + k] = -row1;
    }
    return true;
  }

 private:
  const double *lens_, *attitude_;
  const double u_, v_, weight_;
};

// The second residual is always zero: Ceres eliminates by code compiled for blocks 2/3/3 if all rows have two residuals,
// and otherwise by code for any size, which takes 1.6 times as long.
class DistanceCost final : public ceres::SizedCostFunction<2, 3, 3> {
 public:
  explicit DistanceCost(const Distance& measured) : metres_(measured.metres), weight_(1.0 / measured.sigma) {}

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const double line[3] = {blocks[0][0] - blocks[1][0], blocks[0][1] - blocks[1][1], blocks[0][2] - blocks[1][2]};
    const double length = std::sqrt(line[0] * line[0] + line[1] * line[1] + line[2] * line[2]);
    residuals[0] = (length - metres_) * weight_;
    residuals[1] = 0.0;
    for (int block = 0; jacobians != nullptr && block < 2; ++block) {
      if (jacobians[block] == nullptr) continue;
      const double scale = (block == 0 ? weight_ : -weight_) / length;
      for (int k = 0; k < 3; ++k) {
        jacobians[block][k] = scale * line[k];
        jacobians[block][3 + k] = 0.0;
      }
    }
    return true;
  }

 private:
  const double metres_, weight_;
};

double processor_seconds() {
  timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}

class Reader {
 public:
  explicit Reader(const char* path) : file_(path, std::ios::binary) {}
  template <typename T>
  void fill(T* values, size_t count) {
    file_.read(reinterpret_cast<char*>(values), static_cast<std::streamsize>(count * sizeof(T)));
  }
  bool good() const { return file_.good(); }

 private:
  std::ifstream file_;
};

Window read_window(Reader& reader) {
  double counts[4] = {0.0, 0.0, 0.0, 0.0};
  Window window;
  reader.fill(counts, 4);
  reader.fill(window.lens, 4);
  window.views.resize(static_cast<size_t>(counts[0]));
  window.landmarks.resize(3 * static_cast<size_t>(counts[1]));
  window.sightings.resize(static_cast<size_t>(counts[2]));
  window.distances.resize(static_cast<size_t>(counts[3]));
  reader.fill(window.views.data(), window.views.size());
  reader.fill(window.landmarks.data(), window.landmarks.size());
  reader.fill(window.sightings.data(), window.sightings.size());
  reader.fill(window.distances.data(), window.distances.size());
  return window;
}

struct Seconds {
  double build, solve;
};

// Positions and landmarks hold the start, and then the end.
Seconds solve(const Window& window, double tolerance, std::vector<double>& positions, std::vector<double>& landmarks) {
  const double began = processor_seconds();
  ceres::Problem::Options shape;
  shape.disable_all_safety_checks = true;
  ceres::Problem problem(shape);
  ceres::Solver::Options options;
  auto order = std::make_shared<ceres::ParameterBlockOrdering>();
  for (const Sighting& seen : window.sightings) {
    const auto view = static_cast<size_t>(seen.view), landmark = static_cast<size_t>(seen.landmark);
    problem.AddResidualBlock(new PixelCost(window.lens, window.views[view].attitude, seen), nullptr,
                             &landmarks[3 * landmark], &positions[3 * view]);
  }
  for (const Distance& measured : window.distances) {
    problem.AddResidualBlock(new DistanceCost(measured), nullptr,
                             &landmarks[3 * static_cast<size_t>(measured.landmark)],
                             &positions[3 * static_cast<size_t>(measured.view)]);
  }
  for (size_t k = 0; k < landmarks.size(); k += 3) order->AddElementToGroup(&landmarks[k], 0);
  for (size_t i = 0; i < window.views.size(); ++i) {
    order->AddElementToGroup(&positions[3 * i], 1);
    if (window.views[i].is_free == 0.0) problem.SetParameterBlockConstant(&positions[3 * i]);
  }
  options.linear_solver_ordering = order;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.num_threads = 1;
  options.function_tolerance = tolerance;
  options.max_num_iterations = 100;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  const double built = processor_seconds();
  ceres::Solve(options, &problem, &summary);
  const double solved = processor_seconds();
  return {built - began, solved - built};
}

}  // namespace

int main(int count, char** arguments) {
  if (count != 2) return 2;
  Reader reader(arguments[1]);
  double windows = 0.0;
  reader.fill(&windows, 1);
  std::vector<Window> all;
  while (reader.good() && all.size() < static_cast<size_t>(windows)) all.push_back(read_window(reader));
  if (!reader.good()) return 2;
  size_t number = 0;
  int repetitions = 0;
  double tolerance = 0.0;
  while (std::scanf("%zu %d %lf", &number, &repetitions, &tolerance) == 3 && number < all.size()) {
    const Window& window = all[number];
    std::vector<double> positions, landmarks;
    Seconds total = {0.0, 0.0};
    for (int turn = 0; turn < repetitions; ++turn) {
      positions.clear();
      for (const View& view : window.views) positions.insert(positions.end(), view.position, view.position + 3);
      landmarks = window.landmarks;
      const Seconds found = solve(window, tolerance, positions, landmarks);
      total = {total.build + found.build, total.solve + found.solve};
    }
    std::printf("%.9g %.9g", total.build / repetitions, total.solve / repetitions);
    for (double value : positions) std::printf(" %.17g", value);
    for (double value : landmarks) std::printf(" %.17g", value);
    std::printf("\n");
    std::fflush(stdout);
  }
  return 0;
}
