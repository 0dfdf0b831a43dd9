/* Inverse kinematics: damped Gauss-Newton for a pose with the tip, and the wrist if wanted, at given points. */
#include <string.h>

#include "tools.h"
#include "vec.h"

#define TOLERANCE_M 1e-9
#define LONGEST_STEP 0.25 /* [rad]: beyond it the linearization is worth little */

/* The smallest damped least-squares step whose joints do not run against the limits they stand at. */
static void step_to(int n, int rows, double J[][MOC_MAX_JOINTS], const double *error, double damping, const double *q,
                    const double *low, const double *high, double *step)
{
    int held[MOC_MAX_JOINTS] = {0};
    for (int round = 0; round < n; round++) {
        double gram[6][MOC_MAX_JOINTS], L[6][MOC_MAX_JOINTS], inverse[6], weight[6], trace = 0.0;
        int blocked = 0;

        for (int i = 0; i < rows; i++) {
            for (int k = 0; k < rows; k++) {
                gram[i][k] = 0.0;
                for (int j = 0; j < n; j++)
                    gram[i][k] += held[j] ? 0.0 : J[i][j] * J[k][j];
            }
            trace += gram[i][i];
            weight[i] = error[i];
        }
        /* Tip and wrist are rigidly tied: the product is singular, so that a trace of damping is always there. */
        for (int i = 0; i < rows; i++)
            gram[i][i] += fmax(fmax(damping, 1e-10 * trace), 1e-14);
        cholesky(rows, gram, L, inverse);
        solve_factored(rows, L, inverse, weight);
        for (int j = 0; j < n; j++) {
            step[j] = 0.0;
            for (int i = 0; i < rows && !held[j]; i++)
                step[j] += J[i][j] * weight[i];
            if ((q[j] >= high[j] && step[j] > 0.0) || (q[j] <= low[j] && step[j] < 0.0))
                held[j] = blocked = 1;
        }
        if (!blocked)
            return;
    }
    memset(step, 0, (unsigned)n * sizeof *step);
}

double moc_nearest_pose(const moc_arm *arm, int points, double target[][3], const double *low, const double *high,
                        int iterations, const double *start, double *best)
{
    int n = arm->n, rows = 3 * points;
    double q[MOC_MAX_JOINTS], J[6][MOC_MAX_JOINTS], error[6], step[MOC_MAX_JOINTS];
    double damping = 1e-12, last = HUGE_VAL, miss = HUGE_VAL;
    moc_frame frame[MOC_MAX_JOINTS];
    moc_twist twist[MOC_MAX_JOINTS];

    memcpy(q, start, (unsigned)n * sizeof *q);
    memcpy(best, start, (unsigned)n * sizeof *best);
    for (int round = 0; round < iterations; round++) {
        double worst = 0.0, length = 0.0;
        moc_place(arm, q, frame);
        moc_twists(arm, frame, twist);
        for (int p = 0; p < points; p++) {
            double there[3];
            moc_point(&frame[n - 1], arm->point[p], there);
            moc_jacobian(n, twist, there, arm->moves[p], J + 3 * p);
            for (int i = 0; i < 3; i++) {
                error[3 * p + i] = target[p][i] - there[i];
                worst = fmax(worst, fabs(error[3 * p + i]));
            }
        }
        if (worst < miss) {
            memcpy(best, q, (unsigned)n * sizeof *best);
            miss = worst;
        }
        if (worst < TOLERANCE_M)
            break;
        /* out of reach, undamped steps swing about without end */
        damping = worst < 0.5 * last ? 1e-12 : fmin(fmax(10.0 * damping, 1e-8), 1e-2);
        last = worst;
        step_to(n, rows, J, error, damping, q, low, high, step);
        for (int j = 0; j < n; j++)
            length = fmax(length, fabs(step[j]));
        if (!(length >= 1e-12))
            break;
        for (int j = 0; j < n; j++)
            q[j] = fmin(fmax(q[j] + step[j] * fmin(1.0, LONGEST_STEP / length), low[j]), high[j]);
    }
    return miss;
}
