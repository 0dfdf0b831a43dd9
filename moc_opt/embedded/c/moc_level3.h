/* The torque of the third level: it moves neither tip nor wrist. */
#ifndef MOC_LEVEL3_H
#define MOC_LEVEL3_H

#include "moc_constants.h"

/* tau += M Z^T (Z M Z^T)^-1 Z push,   push = share (K_N2 (x - v) - D_N2 v) joint by joint.
 *
 *   M: (n,n) inertia. Z: (rows,n) orthonormal rows of the null space; rows = 0: nothing is added.
 *   v: measured velocity, x: the one that is wanted (n,) [rad/s]. share: 0 to 1, of the third level.
 */
void moc_third_level(const double *M, const double *Z, int rows, const double *v, const double *x, double share,
                     double *tau);

#endif
