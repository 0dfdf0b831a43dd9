/* Where the parts of a flat subproblem record lie: A (6,n), b (6,), grad_mu, lower, upper (n,), c0 c1 c2 rho, q (n,). */
#ifndef MOC_SUBPROBLEM_H
#define MOC_SUBPROBLEM_H

#include "moc_constants.h"

enum {
    MOC_A = 0,
    MOC_B = 6 * MOC_N,
    MOC_GRAD = MOC_B + 6,
    MOC_LOWER = MOC_GRAD + MOC_N,
    MOC_UPPER = MOC_LOWER + MOC_N,
    MOC_C2 = MOC_UPPER + MOC_N + 2,
    MOC_RHO = MOC_C2 + 1,
    MOC_RECORD = 10 * MOC_N + 10
};

#endif
