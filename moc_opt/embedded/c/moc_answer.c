#include "moc_answer.h"

#include <math.h>

#include "moc_dense.h"
#include "moc_subproblem.h"

#define STILL 1e-9        /* a joint that moves less along a unit vector of self-motion does not bound it */
#define NO_GRADIENT 1e-12 /* share of the gradient along the self-motion below which there is none */
#define PASSES 2e-3       /* where rho is the scale an answer with a smaller natural residual may be right */
#define IMMOBILE 1e-12    /* squared length of a joint's column of Z below which it does not move */
#define SWEEPS 50         /* of the retreat over the joints; one freedom needs two */
#define DONE 1e-12        /* change in a sweep after which none is needed [rad/s] */
#define OUTSIDE 1e-6      /* what a retreat may leave the box by [rad/s] */

static double largest(double a, double b)
{
    return a > b ? a : b;
}

moc_residuals moc_compute_residuals(const double *record, const double *Z, int rows, const double *x)
{
    const double *grad = record + MOC_GRAD, *lower = record + MOC_LOWER, *upper = record + MOC_UPPER;
    double c2 = record[MOC_C2], rho = record[MOC_RHO];
    moc_residuals found = {0.0, 0.0, 0.0, 0.0, 0.0};
    double line[MOC_N], steepest = 0.0;

    if (!moc_all_finite(MOC_N, x)) {
        found.primal = (double)NAN;
        return found;
    }
    for (int i = 0; i < 6; i++)
        found.primal = largest(fabs(moc_dot(MOC_N, record + MOC_A + i * MOC_N, x) - record[MOC_B + i]), found.primal);
    for (int j = 0; j < MOC_N; j++) {
        found.outside = largest(largest(lower[j] - x[j], x[j] - upper[j]), found.outside);
        steepest = largest(fabs(grad[j]), steepest);
        line[j] = 0.0;
    }
    for (int i = 0; i < rows; i++) {
        double along = moc_dot(MOC_N, Z + i * MOC_N, grad);
        for (int j = 0; j < MOC_N; j++)
            line[j] += along * Z[i * MOC_N + j];
    }
    double length = sqrt(moc_dot(MOC_N, line, line));
    if (!(length > NO_GRADIENT * steepest) || !(c2 > 0.0))
        return found;

    int faint = rho >= c2 * steepest; /* a course that rests: its gradient is no scale */
    double scale = largest(c2 * steepest, rho);
    double slope = 0.0, total = 0.0, place = 0.0, pull = 0.0, low = -HUGE_VAL, high = HUGE_VAL, room = HUGE_VAL;
    for (int j = 0; j < MOC_N; j++) {
        line[j] /= length;
        slope += line[j] * (rho * x[j] - c2 * grad[j]) / scale;
        pull += c2 * line[j] * grad[j];
        total += fabs(line[j]);
        place += line[j] * x[j];
        if (fabs(line[j]) > STILL) {
            double one = (lower[j] - x[j]) / line[j], other = (upper[j] - x[j]) / line[j];
            low = fmax(low, fmin(one, other));
            high = fmin(high, fmax(one, other));
        }
    }
    low = fmin(low, 0.0); /* x itself counts as allowed: its violation is judged above */
    high = fmax(high, 0.0);
    for (int j = 0; j < MOC_N; j++) {
        double push = line[j] * slope;
        if (push > STILL * fabs(slope))
            room = fmin(room, fmax(x[j] - lower[j], 0.0));
        else if (push < -STILL * fabs(slope))
            room = fmin(room, fmax(upper[j] - x[j], 0.0));
    }
    double desired = rho > 0.0 ? pull / rho : HUGE_VAL;
    found.natural = fmin(fabs(slope) / total, room);
    if (faint && found.natural <= PASSES)
        return found;
    found.off = fabs(moc_clip(desired - place, low, high));
    found.opposite = fabs(moc_clip(-desired - place, low, high));
    return found;
}

/* The shortest solution of A x = b: S^-1 A^T b with S = A^T A + Z^T Z. */
static void shortest_motion(const double *record, const double *Z, int rows, double *x)
{
    double S[MOC_N * MOC_N], factor[MOC_N * MOC_N];
    const double *A = record + MOC_A, *b = record + MOC_B;

    for (int i = 0; i < MOC_N; i++) {
        for (int j = 0; j < MOC_N; j++) {
            double sum = 0.0;
            for (int k = 0; k < 6; k++)
                sum += A[k * MOC_N + i] * A[k * MOC_N + j];
            for (int k = 0; k < rows; k++)
                sum += Z[k * MOC_N + i] * Z[k * MOC_N + j];
            S[i * MOC_N + j] = sum;
        }
        x[i] = 0.0;
        for (int k = 0; k < 6; k++)
            x[i] += A[k * MOC_N + i] * b[k];
    }
    moc_cholesky(MOC_N, S, factor);
    moc_solve_factored(MOC_N, factor, x);
}

/* Hildreth's dual coordinate ascent, one constraint a joint: motion (n,) = Z^T w. */
void moc_retreat(const double *record, const double *Z, int rows, double *motion)
{
    const double *lower = record + MOC_LOWER, *upper = record + MOC_UPPER;
    double shortest[MOC_N], w[MOC_N] = {0.0}, push[MOC_N] = {0.0}, size[MOC_N];
    double change = HUGE_VAL;

    shortest_motion(record, Z, rows, shortest);
    for (int j = 0; j < MOC_N; j++) {
        size[j] = 0.0;
        for (int k = 0; k < rows; k++)
            size[j] += Z[k * MOC_N + j] * Z[k * MOC_N + j];
    }
    for (int sweep = 0; sweep < SWEEPS && !(change < DONE); sweep++) {
        change = 0.0;
        for (int j = 0; j < MOC_N; j++) {
            if (!(size[j] > IMMOBILE))
                continue;
            double free = shortest[j] - size[j] * push[j];
            for (int k = 0; k < rows; k++)
                free += Z[k * MOC_N + j] * w[k];
            double wanted = (fmin(fmax(free, lower[j]), upper[j]) - free) / size[j];
            for (int k = 0; k < rows; k++)
                w[k] += (wanted - push[j]) * Z[k * MOC_N + j];
            change = fmax(change, fabs(wanted - push[j]));
            push[j] = wanted;
        }
    }
    int inside = 1; /* or the box is empty, or A has lost more than a rank */
    for (int j = 0; j < MOC_N; j++) {
        motion[j] = 0.0;
        for (int k = 0; k < rows; k++)
            motion[j] += Z[k * MOC_N + j] * w[k];
        double x = shortest[j] + motion[j];
        inside &= lower[j] - OUTSIDE <= x && x <= upper[j] + OUTSIDE;
    }
    for (int j = 0; j < MOC_N && !inside; j++)
        motion[j] = 0.0;
}
