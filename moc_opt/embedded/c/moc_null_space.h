/* The rows of tip and wrist where they have lost rank: eliminated with complete pivoting. */
#ifndef MOC_NULL_SPACE_H
#define MOC_NULL_SPACE_H

#include "moc_constants.h"

typedef struct {
    double W[6 * MOC_N];    /* eliminated rows: row pivot[k] reads x[joint[k]] + sum over the free joints = b */
    double b[6];
    int pivot[6];           /* row of the k-th pivot, k < rank */
    int joint[MOC_N];       /* its joint; from rank on the free joints, ascending */
    int rank;
    int certain;            /* 0: the next pivot is neither rounding nor a row of its own */
} moc_plane;

/* Eliminate A (6,n) x = b (6,); b may be NULL. */
moc_plane moc_eliminate(const double *A, const double *b);

/* How joint j moves when free joint `joint[rank + f]` moves by one: (n,). */
void moc_direction(const moc_plane *plane, int f, double *motion);

/* Orthonormal rows Z (n - rank,n) of the kernel; returns how many. */
int moc_kernel(const moc_plane *plane, double Z[MOC_N * MOC_N]);

/* Make the rows (count,n) orthonormal, in place. */
void moc_orthonormalise(int count, double *rows);

#endif
