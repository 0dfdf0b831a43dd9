/* What the files of the core share: elimination (exact.c), several freedoms (polytope.c), the shaft (levels.c). */
#ifndef MOC_SHARED_H
#define MOC_SHARED_H

#include "moc.h"

/* A x = b, eliminated: row pivot[k] reads x[joint[k]] + sum over free joints of row[.][j] x[j] = from[.][RIGHT]. */
typedef struct {
    double row[6][MOC_MAX_JOINTS];
    double from[6][8];         /* the row as a combination of the rows of A; then its right-hand side */
    double open[6];            /* 1 for a row that is no pivot */
    int pivot[6];
    int joint[MOC_MAX_JOINTS]; /* those of the pivots, then the free ones that move tip or wrist */
    int rank, freedoms;
} moc_plane;

enum { RIGHT = 6 };

/* Rows (returned) of any basis of ker A; a row of A that is neither repeated nor independent counts as repeated. */
int moc_kernel(int n, double A[][MOC_MAX_JOINTS], double rows[][MOC_MAX_JOINTS]);

/* Weight of grad mu_shaft beside grad mu [m]. */
double moc_shaft_push(double mu_shaft, double margin);

/* How all joints move along A x = b when free joint number k moves by one: z (n,). */
void moc_direction(const moc_plane *plane, int n, int k, double *z);

/* Move x (n,), any point of the plane, along it to the optimum over the box, where the plane has two freedoms or more.
 * force (n,): the multipliers of the active bounds are added to it. */
moc_status moc_solve_several(const moc_plane *plane, const moc_problem *problem, double tolerance, double *x,
                             double *force);

#endif
