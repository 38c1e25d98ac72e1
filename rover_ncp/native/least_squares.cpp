// Nonlinear least squares: damped Gauss-Newton steps, Broyden's correction of the slopes, and the survival.
//
// Between two calls the episodes displace all code and data from the processor's caches, after which numpy's many
// small operations take two to four times as long. sim/learn/search/least_squares.py documents the functions.

#include "arrays.h"

extern "C" {
double exp(double);
double sqrt(double);
}

namespace {

// gcc's -O2 vectorises loops of a known length alone; clang's all.
#ifdef __clang__
#define VECTORISED
#else
#define VECTORISED __attribute__((optimize("O3")))
#endif

constexpr double MIN_SHARE = 1e-12;
constexpr double MIN_EXPONENT = -690.0;  // the exponential of less underflows, and all weights would be 0
constexpr double LARGEST = 1.7976931348623157e308;

// Routines of scipy's BLAS and LAPACK. Fortran's matrices are the transposes of ours.
struct Routines {
    void (*syrk)(const char *triangle, const char *transposed, const int *n, const int *k, const double *alpha,
                 const double *a, const int *lda, const double *beta, double *c, const int *ldc);
    void (*gemv)(const char *transposed, const int *m, const int *n, const double *alpha, const double *a,
                 const int *lda, const double *x, const int *incx, const double *beta, double *y, const int *incy);
    double (*dot)(const int *n, const double *x, const int *incx, const double *y, const int *incy);
    void (*potrf)(const char *triangle, const int *n, double *a, const int *lda, int *failed);
};

// The fields of the named tuple of sim/learn/search/least_squares.py: R residuals of D parameters.
struct LeastSquares {
    Routines routines;
    Matrix slopes;
    Doubles factors;
    Matrix targets;
    Doubles weights, step;
    Matrix weighted, products, lower;
    Doubles right, solution;
};

const int ONE = 1;
const double YES = 1.0, NONE = 0.0;

// product = matrix (m, n) times vector (n,)
void multiply(const Routines &routines, const Matrix &matrix, const double *vector, double *product) {
    const int rows = (int)matrix.shape[0], columns = (int)matrix.shape[1];
    routines.gemv("T", &columns, &rows, &YES, matrix.data, &columns, vector, &ONE, &NONE, product, &ONE);
}

// out = a * b, number by number
VECTORISED void multiply_by(int64_t count, const double *__restrict a, const double *__restrict b,
                            double *__restrict out) {
    for (int64_t i = 0; i < count; i++) out[i] = a[i] * b[i];
}

// out += factor * a
VECTORISED void add(int64_t count, double factor, const double *__restrict a, double *__restrict out) {
    for (int64_t i = 0; i < count; i++) out[i] += factor * a[i];
}

// Solve L L' x = x in place, L being the lower triangle of `lower`.
void solve(const Matrix &lower, double *x) {
    const int64_t count = lower.shape[0];
    for (int64_t i = 0; i < count; i++) {
        for (int64_t j = 0; j < i; j++) x[i] -= lower(i, j) * x[j];
        x[i] /= lower(i, i);
    }
    for (int64_t i = count - 1; i >= 0; i--) {
        x[i] /= lower(i, i);
        add(i, -x[i], &lower(i, 0), x);
    }
}

double loss_at(const double *residuals, int64_t checkpoint) {
    double sum = 0.0;
    for (int64_t i = 3 * checkpoint; i < 3 * checkpoint + 3; i++) sum += residuals[i] * residuals[i];
    return sum;
}

double term(double loss, double lifetime) {
    const double exponent = -loss / lifetime;
    return exp(exponent < MIN_EXPONENT ? MIN_EXPONENT : exponent);
}

void set_survival_weights(int64_t checkpoints, const double *residuals, double lifetime, double *weights) {
    double loss = 0.0, later = 0.0, sum = 0.0;
    for (int64_t checkpoint = 0; checkpoint < checkpoints; checkpoint++) {
        loss += loss_at(residuals, checkpoint);
        weights[3 * checkpoint] = term(loss, lifetime);
    }
    for (int64_t checkpoint = checkpoints - 1; checkpoint >= 0; checkpoint--) {
        later += weights[3 * checkpoint];
        for (int i = 0; i < 3; i++) weights[3 * checkpoint + i] = later;
    }
    for (int64_t i = 0; i < 3 * checkpoints; i++) sum += weights[i];
    const double mean = sum / (double)(3 * checkpoints);
    for (int64_t i = 0; i < 3 * checkpoints; i++) weights[i] = sqrt(weights[i] / mean);
}

// The number of residuals up to the checkpoint where the return falls below `to_beat`. The sum is that of an episode,
// to the last bit.
int64_t count_known(int64_t count, const double *residuals, double to_beat) {
    double loss = 0.0;
    for (int64_t checkpoint = 0; 3 * checkpoint < count; checkpoint++) {
        loss += loss_at(residuals, checkpoint);
        if (loss > -to_beat) return 3 * checkpoint + 3;
    }
    return count;
}

}  // namespace

extern "C" {
#pragma GCC visibility push(default)

int64_t rover_ncp_size_of_least_squares() { return sizeof(LeastSquares); }

// Write the first `count` steps and the point to the targets. Return 0, or 1 if slopes are not finite, or 2 if the
// matrix is not positive definite.
int64_t rover_ncp_damped_steps(const LeastSquares *problem, int64_t count, double damping, double lifetime,
                               const double *point, const double *residuals) {
    const auto &[routines, slopes, factors, targets, weights, step, weighted, products, lower, right, solution] =
        *problem;
    const int64_t parameters = slopes.shape[0], equations = slopes.shape[1];
    if (lifetime > 0.0)
        set_survival_weights(equations / 3, residuals, lifetime, weights.data);
    else
        for (int64_t r = 0; r < equations; r++) weights(r) = 1.0;
    for (int64_t d = 0; d < parameters; d++) multiply_by(equations, &slopes(d, 0), weights.data, &weighted(d, 0));
    multiply_by(equations, residuals, weights.data, right.data);
    multiply(routines, weighted, right.data, step.data);  // the gradient
    for (int64_t d = 0; d < parameters; d++) {
        const bool leaves = (point[d] <= 0.0 && step(d) > 0.0) || (point[d] >= 1.0 && step(d) < 0.0);
        for (int64_t r = 0; leaves && r < equations; r++) weighted(d, r) = 0.0;
    }
    const int n = (int)equations, k = (int)parameters;
    // Our upper triangle, as numpy has it computed: of the lower one the last bits may differ.
    routines.syrk("L", "N", &n, &k, &YES, weighted.data, &n, &NONE, products.data, &n);
    double largest = 0.0;
    for (int64_t i = 0; i < equations; i++) {
        if (!(products(i, i) <= LARGEST)) return 1;  // LAPACK would not always object
        if (products(i, i) > largest) largest = products(i, i);
    }
    // With less damping than that, rounding could make the matrix negative.
    const double least = MIN_SHARE * largest;
    for (int64_t d = 0; d < parameters; d++) targets(count, d) = point[d];
    for (int64_t s = 0; s < count; s++) {
        const double wanted = damping * factors(s), added = wanted > least ? wanted : least;
        for (int64_t i = 0; i < equations; i++) {
            for (int64_t j = 0; j < i; j++) lower(i, j) = products(j, i);
            lower(i, i) = products(i, i) + added;
        }
        int failed = 0;
        routines.potrf("U", &n, lower.data, &n, &failed);
        if (failed != 0) return 2;
        for (int64_t r = 0; r < equations; r++) solution(r) = right(r);
        solve(lower, solution.data);
        multiply(routines, weighted, solution.data, step.data);
        for (int64_t d = 0; d < parameters; d++) {
            const double moved = point[d] - step(d);
            targets(s, d) = moved < 0.0 ? 0.0 : moved > 1.0 ? 1.0 : moved;
        }
    }
    return 0;
}

// Set the slopes of the one parameter in which two points differ.
void rover_ncp_measure_slopes(const LeastSquares *problem, const double *point, const double *residuals,
                              const double *there, const double *found) {
    const Matrix &slopes = problem->slopes;
    int64_t moved = 0;
    while (moved + 1 < slopes.shape[0] && there[moved] == point[moved]) moved++;
    const double length = there[moved] - point[moved];
    for (int64_t r = 0; r < slopes.shape[1]; r++) slopes(moved, r) = (found[r] - residuals[r]) / length;
}

// Broyden's correction (1965) of the slopes by the residuals at two points, as far as the second are known.
void rover_ncp_correct_slopes(const LeastSquares *problem, double to_beat, const double *point,
                              const double *residuals, const double *there, const double *found) {
    const Matrix &slopes = problem->slopes;
    const Doubles &step = problem->step, &unexplained = problem->right;
    const int64_t parameters = slopes.shape[0], known = count_known(slopes.shape[1], found, to_beat);
    for (int64_t d = 0; d < parameters; d++) step(d) = there[d] - point[d];
    const int n = (int)parameters;
    const double length = problem->routines.dot(&n, step.data, &ONE, step.data, &ONE);
    if (length == 0.0) return;
    for (int64_t i = 0; i < known; i++) unexplained(i) = found[i] - residuals[i];
    for (int64_t d = 0; d < parameters; d++) add(known, -step(d), &slopes(d, 0), unexplained.data);
    for (int64_t d = 0; d < parameters; d++) add(known, step(d) / length, unexplained.data, &slopes(d, 0));
}

double rover_ncp_survival(const LeastSquares *problem, double lifetime, const double *residuals) {
    double loss = 0.0, survived = 0.0;
    for (int64_t checkpoint = 0; 3 * checkpoint < problem->weights.shape[0]; checkpoint++) {
        loss += loss_at(residuals, checkpoint);
        survived += term(loss, lifetime);
    }
    return survived;
}
#pragma GCC visibility pop
}
