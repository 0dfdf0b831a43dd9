/* A basis Z of ker A that follows the arm, and the climb of mu in it. */
#include <string.h>

#include "vec.h"

/* Scaled climb: Newton's step to the local top of mu, at most LONGEST, in 1 / RATE seconds. */
#define RATE 5.0     /* [1/s] */
#define LONGEST 1.0  /* [rad] */
#define PROBE 1e-3   /* way over which the slope's change is taken [rad] */

/* What is left of a row of Z that turns by 1.4 mrad in a tick: up to there one projection is as good as two. */
#define NEARLY_ALL (1.0 - 1e-6)

/* Row k less its part along the rows before it, as a unit vector; returns what was left, 0 for less than `least`. */
static double orthonormalise(int n, double Z[][MOC_MAX_JOINTS], int k, double least)
{
    for (int i = 0; i < k; i++) {
        double along = dot(n, Z[i], Z[k]);
        for (int j = 0; j < n; j++)
            Z[k][j] -= along * Z[i][j];
    }
    double length = sqrt(dot(n, Z[k], Z[k]));
    if (!(length > least)) /* also catches NaN */
        return 0.0;
    for (int j = 0; j < n; j++)
        Z[k][j] /= length;
    return length;
}

/* The factor of A5 A5^T; 0 near a singularity. */
static int factor_rows(int n, double A[][MOC_MAX_JOINTS], const double u[3], double A5[5][MOC_MAX_JOINTS],
                       double L[5][MOC_MAX_JOINTS], double inverse[5])
{
    double b[2][3], S[5][MOC_MAX_JOINTS];
    across(u, b);
    five_rows(n, A, b, A5);
    for (int i = 0; i < 5; i++)
        for (int k = 0; k <= i; k++)
            S[i][k] = S[k][i] = dot(n, A5[i], A5[k]);
    cholesky(5, S, L, inverse);
    for (int i = 0; i < 5; i++)
        if (!(L[i][i] * L[i][i] > 1e-9 * S[i][i]))
            return 0;
    return 1;
}

/* x (n,) less its part in the rows of A5. */
static void onto_kernel(int n, double A5[5][MOC_MAX_JOINTS], double L[5][MOC_MAX_JOINTS], const double inverse[5],
                        double *x)
{
    double off[5];
    for (int k = 0; k < 5; k++)
        off[k] = dot(n, A5[k], x);
    solve_factored(5, L, inverse, off);
    for (int k = 0; k < 5; k++)
        for (int j = 0; j < n; j++)
            x[j] -= A5[k][j] * off[k];
}

/* The rows are projected on the new kernel and made orthonormal again: Z turns no further than the kernel does,
 * whatever sign a fresh decomposition would have chosen. */
int moc_follow_null_space(int n, double A[][MOC_MAX_JOINTS], const double u[3], int rows, double Z[][MOC_MAX_JOINTS])
{
    double A5[5][MOC_MAX_JOINTS], L[5][MOC_MAX_JOINTS], inverse[5];

    if (!factor_rows(n, A, u, A5, L, inverse))
        return 0;
    for (int i = 0; i < rows; i++) {
        double left = 0.0;
        for (int round = 0; round < 2 && left < NEARLY_ALL; round++) { /* twice is always enough */
            onto_kernel(n, A5, L, inverse, Z[i]);
            left = orthonormalise(n, Z, i, 0.5);
            if (!(left > 0.0))
                return 0;
        }
    }
    return 1;
}

int moc_null_space(int n, double A[][MOC_MAX_JOINTS], int rows, double Z[][MOC_MAX_JOINTS])
{
    double fresh[MOC_MAX_JOINTS][MOC_MAX_JOINTS], turned[MOC_MAX_JOINTS][MOC_MAX_JOINTS];
    int found = moc_kernel(n, A, fresh), alike = found == rows;

    for (int i = 0; i < found; i++)
        for (int twice = 0; twice < 2; twice++)
            orthonormalise(n, fresh, i, 0.0);
    for (int i = 0; i < found && alike; i++) {
        for (int j = 0; j < n; j++)
            turned[i][j] = 0.0;
        for (int k = 0; k < found; k++) {
            double along = dot(n, fresh[k], Z[i]);
            for (int j = 0; j < n; j++)
                turned[i][j] += along * fresh[k][j];
        }
        alike = orthonormalise(n, turned, i, 0.5) > 0.0 && orthonormalise(n, turned, i, 0.5) > 0.0;
    }
    memcpy(Z, alike ? turned : fresh, sizeof fresh);
    return found;
}

/* The gradient that the climb follows, on ker A: grad mu, and away from where the shaft is lost. */
static void slope_of(int n, const moc_law *law, moc_terms *t, double *slope)
{
    double A5[5][MOC_MAX_JOINTS], L[5][MOC_MAX_JOINTS], inverse[5];
    double push = moc_shaft_push(t->mu_shaft, law->shaft_margin);

    for (int j = 0; j < n; j++)
        slope[j] = t->grad_mu[j] + push * t->grad_mu_shaft[j];
    factor_rows(n, t->A, t->u, A5, L, inverse);
    onto_kernel(n, A5, L, inverse, slope);
}

/* d = (I - A^+ A)(grad mu + p grad mu_shaft), t = d / |d|, h = dd/ds along t:  x_d = RATE t |d| / max(-h, |d| / LONGEST).
 *
 * With a pull of grad mu alone the speed is c2/rho |d|: where mu is small or flat the climb is slow, and at a sharp top it is
 * stiff. */
void moc_climb(const moc_arm *arm, const moc_law *law, const moc_terms *t, double *x_d)
{
    double slope[MOC_MAX_JOINTS], q[MOC_MAX_JOINTS], there[MOC_MAX_JOINTS];
    moc_terms ahead;
    int n = arm->n;

    memset(x_d, 0, (unsigned)n * sizeof *x_d);
    slope_of(n, law, (moc_terms *)t, slope);
    double steepness = sqrt(dot(n, slope, slope));
    if (!(steepness > 1e-12)) /* also catches NaN */
        return;
    for (int j = 0; j < n; j++)
        q[j] = t->q[j] + PROBE * (slope[j] / steepness);
    moc_compute_kinematics(arm, q, &ahead);
    slope_of(n, law, &ahead, there);
    double bend = (dot(n, there, slope) / steepness - steepness) / PROBE;
    double step = steepness / fmax(-bend, steepness / LONGEST);
    for (int j = 0; j < n && all_finite(1, &step); j++)
        x_d[j] = RATE * step * (slope[j] / steepness);
}
