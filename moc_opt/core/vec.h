/* Three-vectors and small dense matrices. */
#ifndef MOC_VEC_H
#define MOC_VEC_H

#include <math.h>
#include <string.h>

#include "shared.h"

static inline double dot3(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* out += s a x b */
static inline void add_cross(double s, const double a[3], const double b[3], double out[3])
{
    out[0] += s * (a[1] * b[2] - a[2] * b[1]);
    out[1] += s * (a[2] * b[0] - a[0] * b[2]);
    out[2] += s * (a[0] * b[1] - a[1] * b[0]);
}

/* Scale a to length 1. Returns the previous length. */
static inline double normalise3(double a[3])
{
    double length = sqrt(dot3(a, a));
    for (int i = 0; i < 3; i++)
        a[i] /= length;
    return length;
}

static inline void times3(double S[3][3], const double x[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = dot3(S[i], x);
}

/* Compute the adjugate of a symmetric S. Returns the determinant. */
static inline double adjugate3(double S[3][3], double adj[3][3])
{
    for (int i = 0; i < 3; i++) {
        adj[i][0] = adj[i][1] = adj[i][2] = 0.0;
        add_cross(1.0, S[(i + 1) % 3], S[(i + 2) % 3], adj[i]);
    }
    return dot3(S[0], adj[0]);
}

/* a^T b. Two partial sums are faster than one. */
static inline double dot(int n, const double *a, const double *b)
{
    double even = n % 2 ? a[n - 1] * b[n - 1] : 0.0, odd = 0.0;
    for (int i = 0; i + 1 < n; i += 2) {
        even += a[i] * b[i];
        odd += a[i + 1] * b[i + 1];
    }
    return even + odd;
}

static inline bool all_finite(int n, const double *x)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++)
        sum += 0.0 * x[i]; /* NaN if x[i] is NaN or infinite */
    return sum == 0.0;
}

/* `larger` and `smaller` are faster than fmax and fmin. If a or b is NaN, they return b. */
static inline double larger(double a, double b)
{
    return a > b ? a : b;
}

static inline double smaller(double a, double b)
{
    return a < b ? a : b;
}

/* If low > high, the result is high. NaN stays NaN. */
static inline double clip(double x, double low, double high)
{
    return smaller(high, larger(low, x));
}

/* Factor S (m,m) = L L^T. inverse_i is 1 / L_ii. If S is not positive definite, some inverse_i is not finite. */
static inline void cholesky(int m, double S[][MOC_MAX_JOINTS], double L[][MOC_MAX_JOINTS], double *inverse)
{
    for (int j = 0; j < m; j++) {
        L[j][j] = sqrt(S[j][j] - dot(j, L[j], L[j]));
        inverse[j] = 1.0 / L[j][j];
        for (int i = j + 1; i < m; i++)
            L[i][j] = (S[i][j] - dot(j, L[i], L[j])) * inverse[j];
    }
}

static inline moc_stop first_of(moc_stop reason, moc_stop other)
{
    return reason == MOC_RUNNING ? other : reason;
}

/* Replace x by S^-1 x, with L and inverse from `cholesky`. */
static inline void solve_factored(int m, double L[][MOC_MAX_JOINTS], const double *inverse, double *x)
{
    for (int i = 0; i < m; i++)
        x[i] = (x[i] - dot(i, L[i], x)) * inverse[i];
    for (int i = m - 1; i >= 0; i--) {
        for (int k = i + 1; k < m; k++)
            x[i] -= L[k][i] * x[k];
        x[i] *= inverse[i];
    }
}

/* Complete the unit vector u to a right-handed orthonormal basis (b[0], b[1], u). */
static inline void across(const double u[3], double b[2][3])
{
    int k = fabs(u[0]) <= fabs(u[1]) ? 0 : 1; /* an axis at least 45 degrees from u */
    double e[3] = {0.0, 0.0, 0.0};

    e[k] = 1.0;
    memset(b, 0, 2 * sizeof *b);
    add_cross(1.0, u, e, b[0]);
    normalise3(b[0]);
    add_cross(1.0, u, b[0], b[1]);
}

/* max |x_i|, or NaN if any x_i is NaN */
static inline double largest_of(int count, const double *x)
{
    double most = 0.0;
    for (int i = 0; i < count; i++)
        most = isnan(x[i]) ? x[i] : larger(fabs(x[i]), most);
    return most;
}

/* |A x - b|_inf, or NaN if a row is NaN */
static inline double off_plane(const moc_problem *p, const double *x)
{
    double gap[6];
    for (int i = 0; i < 6; i++)
        gap[i] = dot(p->n, p->A[i], x) - p->b[i];
    return largest_of(6, gap);
}

/* A5 = [J_T; b J_W], five independent rows of A, with b from `across` */
static inline void five_rows(int n, double A[][MOC_MAX_JOINTS], double b[2][3], double A5[5][MOC_MAX_JOINTS])
{
    memcpy(A5, A, 3 * sizeof *A5);
    for (int j = 0; j < n; j++)
        for (int i = 0; i < 2; i++)
            A5[3 + i][j] = b[i][0] * A[3][j] + b[i][1] * A[4][j] + b[i][2] * A[5][j];
}

#endif
