#include "moc_level3.h"

#include "moc_dense.h"

void moc_third_level(const double *M, const double *Z, int rows, const double *v, const double *x, double share,
                     double *tau)
{
    double push[MOC_N], MZ[MOC_N * MOC_N], inertia[MOC_N * MOC_N], factor[MOC_N * MOC_N], along[MOC_N];

    for (int j = 0; j < MOC_N; j++)
        push[j] = share * (moc_pull[j] * (x[j] - v[j]) - moc_damping[j] * v[j]);
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < MOC_N; j++)
            MZ[i * MOC_N + j] = moc_dot(MOC_N, M + j * MOC_N, Z + i * MOC_N);
    for (int i = 0; i < rows; i++) {
        for (int k = 0; k < rows; k++)
            inertia[i * rows + k] = moc_dot(MOC_N, Z + i * MOC_N, MZ + k * MOC_N);
        along[i] = moc_dot(MOC_N, Z + i * MOC_N, push);
    }
    moc_cholesky(rows, inertia, factor);
    moc_solve_factored(rows, factor, along);
    for (int j = 0; j < MOC_N; j++)
        for (int i = 0; i < rows; i++)
            tau[j] += MZ[i * MOC_N + j] * along[i];
}
