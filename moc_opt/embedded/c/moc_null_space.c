#include "moc_null_space.h"

#include <math.h>

#include "moc_dense.h"

/* Of the first pivot: below LOST a pivot is rounding, above OWN it is one; see moc_opt/solvers/exact/elimination.py. */
#define LOST 1e-13
#define OWN 3e-11

/* The largest entry of the rows that are no pivots yet. */
static double next_pivot(const moc_plane *plane, const int *open, int *row, int *column)
{
    double most = 0.0;
    *row = *column = 0;
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < MOC_N; j++)
            if (open[i] && fabs(plane->W[i * MOC_N + j]) > most) {
                most = fabs(plane->W[i * MOC_N + j]);
                *row = i;
                *column = j;
            }
    return most;
}

static void clear_column(moc_plane *plane, int row, int column)
{
    double inverse = 1.0 / plane->W[row * MOC_N + column];
    for (int i = 0; i < 6; i++) {
        double scale = i == row ? 0.0 : plane->W[i * MOC_N + column] * inverse;
        for (int j = 0; j < MOC_N; j++)
            plane->W[i * MOC_N + j] -= scale * plane->W[row * MOC_N + j];
        plane->b[i] -= scale * plane->b[row];
    }
    for (int j = 0; j < MOC_N; j++)
        plane->W[row * MOC_N + j] *= inverse;
    plane->b[row] *= inverse;
}

moc_plane moc_eliminate(const double *A, const double *b)
{
    moc_plane plane = {.rank = 0, .certain = 1};
    int open[6], taken[MOC_N] = {0}, place;
    double first = 0.0;

    for (int i = 0; i < 6; i++) {
        open[i] = 1;
        plane.b[i] = b ? b[i] : 0.0;
        for (int j = 0; j < MOC_N; j++)
            plane.W[i * MOC_N + j] = A[i * MOC_N + j];
    }
    while (plane.rank < 5) { /* the sixth row repeats the others: the tool is rigid */
        int row, column;
        double size = next_pivot(&plane, open, &row, &column);
        first = plane.rank == 0 ? size : first;
        if (!(size > OWN * first)) {
            plane.certain = !(size > LOST * first);
            break;
        }
        plane.pivot[plane.rank] = row;
        plane.joint[plane.rank] = column;
        plane.rank++;
        open[row] = 0;
        taken[column] = 1;
        clear_column(&plane, row, column);
    }
    place = plane.rank;
    for (int j = 0; j < MOC_N && place < MOC_N; j++)
        if (!taken[j])
            plane.joint[place++] = j;
    return plane;
}

void moc_direction(const moc_plane *plane, int f, double *motion)
{
    int column = plane->joint[plane->rank + f];
    for (int j = 0; j < MOC_N; j++)
        motion[j] = 0.0;
    motion[column] = 1.0;
    for (int k = 0; k < plane->rank; k++)
        motion[plane->joint[k]] = -plane->W[plane->pivot[k] * MOC_N + column];
}

void moc_orthonormalise(int count, double *rows)
{
    for (int i = 0; i < count; i++)
        for (int twice = 0; twice < 2; twice++) {
            for (int k = 0; k < i; k++) {
                double along = moc_dot(MOC_N, rows + k * MOC_N, rows + i * MOC_N);
                for (int j = 0; j < MOC_N; j++)
                    rows[i * MOC_N + j] -= along * rows[k * MOC_N + j];
            }
            double length = sqrt(moc_dot(MOC_N, rows + i * MOC_N, rows + i * MOC_N));
            for (int j = 0; j < MOC_N; j++)
                rows[i * MOC_N + j] /= length;
        }
}

int moc_kernel(const moc_plane *plane, double Z[MOC_N * MOC_N])
{
    int rows = MOC_N - plane->rank;
    for (int f = 0; f < rows; f++)
        moc_direction(plane, f, Z + f * MOC_N);
    moc_orthonormalise(rows, Z);
    return rows;
}
