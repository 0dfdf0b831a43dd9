/* Small dense algebra: symmetric positive definite systems of at most MOC_N unknowns, row by row with a stride. */
#ifndef MOC_DENSE_H
#define MOC_DENSE_H

#include "moc_constants.h"

/* The lower factor L (m,m) of S = L L^T; NaN where S is not positive definite. */
void moc_cholesky(int m, const double *S, double *L);

/* x (m,) becomes S^-1 x, given the factor of S. */
void moc_solve_factored(int m, const double *L, double *x);

/* Here, because a call would take as long as the sum. */
static inline double moc_dot(int m, const double *a, const double *b)
{
    double sum = 0.0;
    for (int i = 0; i < m; i++)
        sum += a[i] * b[i];
    return sum;
}

/* Whether none of the m numbers is NaN or infinite. */
int moc_all_finite(int m, const double *x);

/* x, or the nearer end of [low, high]; the low end where they are the wrong way round. */
double moc_clip(double x, double low, double high);

#endif
