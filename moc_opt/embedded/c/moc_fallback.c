#include "moc_fallback.h"

#include <math.h>

#include "moc_dense.h"
#include "moc_subproblem.h"

#define SWEEPS 50      /* over the joints */
#define IMMOBILE 1e-12 /* squared length of a joint's column of A below which it moves nothing */

void moc_least_violation(const double *record, double *x)
{
    const double *A = record + MOC_A, *b = record + MOC_B;
    const double *lower = record + MOC_LOWER, *upper = record + MOC_UPPER;
    double missing[6], size[MOC_N];

    for (int j = 0; j < MOC_N; j++) {
        x[j] = fmin(fmax(0.0, lower[j]), upper[j]);
        size[j] = 0.0;
        for (int i = 0; i < 6; i++)
            size[j] += A[i * MOC_N + j] * A[i * MOC_N + j];
    }
    for (int i = 0; i < 6; i++)
        missing[i] = moc_dot(MOC_N, A + i * MOC_N, x) - b[i];
    for (int sweep = 0; sweep < SWEEPS; sweep++)
        for (int j = 0; j < MOC_N; j++) {
            if (!(size[j] > IMMOBILE))
                continue;
            double along = 0.0;
            for (int i = 0; i < 6; i++)
                along += A[i * MOC_N + j] * missing[i];
            double best = fmin(fmax(x[j] - along / size[j], lower[j]), upper[j]);
            for (int i = 0; i < 6; i++)
                missing[i] += (best - x[j]) * A[i * MOC_N + j];
            x[j] = best;
        }
    if (!moc_all_finite(MOC_N, x))
        for (int j = 0; j < MOC_N; j++)
            x[j] = 0.0;
}
