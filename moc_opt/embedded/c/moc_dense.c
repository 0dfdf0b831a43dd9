#include "moc_dense.h"

#include <math.h>

void moc_cholesky(int m, const double *S, double *L)
{
    for (int j = 0; j < m; j++) {
        double d = S[j * m + j];
        for (int k = 0; k < j; k++)
            d -= L[j * m + k] * L[j * m + k];
        double root = d > 0.0 ? sqrt(d) : (double)NAN;
        double inverse = 1.0 / root;
        for (int i = 0; i < j; i++)
            L[i * m + j] = 0.0;
        L[j * m + j] = root;
        for (int i = j + 1; i < m; i++) {
            double s = S[i * m + j];
            for (int k = 0; k < j; k++)
                s -= L[i * m + k] * L[j * m + k];
            L[i * m + j] = s * inverse;
        }
    }
}

void moc_solve_factored(int m, const double *L, double *x)
{
    for (int i = 0; i < m; i++) {
        for (int k = 0; k < i; k++)
            x[i] -= L[i * m + k] * x[k];
        x[i] = x[i] * (1.0 / L[i * m + i]);
    }
    for (int i = m - 1; i >= 0; i--) {
        for (int k = i + 1; k < m; k++)
            x[i] -= L[k * m + i] * x[k];
        x[i] = x[i] * (1.0 / L[i * m + i]);
    }
}

int moc_all_finite(int m, const double *x)
{
    double sum = 0.0;
    for (int i = 0; i < m; i++)
        sum += 0.0 * x[i]; /* NaN for NaN and for both infinities */
    return sum == 0.0;
}

double moc_clip(double x, double low, double high)
{
    if (x > high)
        x = high;
    return x < low ? low : x;
}
