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

}  // namespace

extern "C" {
#pragma GCC visibility push(default)

// Write the targets (n + 1, D) of n dampings, for R residuals of D parameters. `work` (D + 2 + 2 R, R) is scratch.
// Return 0, or 1 if slopes are not finite, or 2 if the matrix is not positive definite.
int64_t rover_ncp_damped_steps(int64_t routines_at, int64_t size, int64_t count, int64_t dampings_count,
                               const double *slopes, const double *residuals, const double *weights,
                               const double *point, const double *dampings, double *targets, double *step,
                               double *work) {
    const Routines &routines = *(const Routines *)routines_at;
    const Matrix rows = {work, {size, count}}, products = {work + size * count, {count, count}};
    const Matrix lower = {products.data + count * count, {count, count}};
    double *right = lower.data + count * count, *solution = right + count;
    for (int64_t d = 0; d < size; d++) multiply_by(count, slopes + d * count, weights, &rows(d, 0));
    multiply_by(count, residuals, weights, right);
    multiply(routines, rows, right, step);  // the gradient
    for (int64_t d = 0; d < size; d++) {
        const bool leaves = (point[d] <= 0.0 && step[d] > 0.0) || (point[d] >= 1.0 && step[d] < 0.0);
        for (int64_t r = 0; leaves && r < count; r++) rows(d, r) = 0.0;
    }
    const int n = (int)count, k = (int)size;
    // Our upper triangle, as numpy has it computed: of the lower one the last bits may differ.
    routines.syrk("L", "N", &n, &k, &YES, work, &n, &NONE, products.data, &n);
    double largest = 0.0;
    for (int64_t i = 0; i < count; i++) {
        if (!(products(i, i) <= LARGEST)) return 1;  // LAPACK would not always object
        if (products(i, i) > largest) largest = products(i, i);
    }
    // With less damping than that, rounding could make the matrix negative.
    const double least = MIN_SHARE * largest;
    for (int64_t d = 0; d < size; d++) targets[dampings_count * size + d] = point[d];
    for (int64_t s = 0; s < dampings_count; s++) {
        const double damping = dampings[s] > least ? dampings[s] : least;
        for (int64_t i = 0; i < count; i++) {
            for (int64_t j = 0; j < i; j++) lower(i, j) = products(j, i);
            lower(i, i) = products(i, i) + damping;
        }
        int failed = 0;
        routines.potrf("U", &n, lower.data, &n, &failed);
        if (failed != 0) return 2;
        for (int64_t r = 0; r < count; r++) solution[r] = right[r];
        solve(lower, solution);
        multiply(routines, rows, solution, step);
        for (int64_t d = 0; d < size; d++) {
            const double moved = point[d] - step[d];
            targets[s * size + d] = moved < 0.0 ? 0.0 : moved > 1.0 ? 1.0 : moved;
        }
    }
    return 0;
}

// Broyden's correction (1965) of slopes (D, R) by the first `known` residuals at two points; `step` (D,) and
// `unexplained` (R,) are scratch.
void rover_ncp_correct_slopes(int64_t routines_at, int64_t size, int64_t count, int64_t known, double *slopes,
                              const double *point, const double *residuals, const double *there,
                              const double *found, double *step, double *unexplained) {
    for (int64_t d = 0; d < size; d++) step[d] = there[d] - point[d];
    const int n = (int)size;
    const double length = ((const Routines *)routines_at)->dot(&n, step, &ONE, step, &ONE);
    if (length == 0.0) return;
    for (int64_t i = 0; i < known; i++) unexplained[i] = found[i] - residuals[i];
    for (int64_t d = 0; d < size; d++) add(known, -step[d], slopes + d * count, unexplained);
    for (int64_t d = 0; d < size; d++) add(known, step[d] / length, unexplained, slopes + d * count);
}

double rover_ncp_survival(int64_t checkpoints, const double *residuals, double lifetime) {
    double loss = 0.0, survived = 0.0;
    for (int64_t checkpoint = 0; checkpoint < checkpoints; checkpoint++) {
        loss += loss_at(residuals, checkpoint);
        survived += term(loss, lifetime);
    }
    return survived;
}

void rover_ncp_survival_weights(int64_t checkpoints, const double *residuals, double lifetime, double *weights) {
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
#pragma GCC visibility pop
}
