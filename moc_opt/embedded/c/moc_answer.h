/* What an answer of the third level is worth, and what may stand in for it. */
#ifndef MOC_ANSWER_H
#define MOC_ANSWER_H

#include "moc_constants.h"

typedef struct {
    double primal;   /* |A x - b|_inf; NaN where x is not finite [m/s] */
    double outside;  /* violation of the box [rad/s] */
    double natural;  /* natural residual along the self-motion, the cost scaled to one [rad/s] */
    double off;      /* distance from the optimum [rad/s] */
    double opposite; /* and from that of the opposite gradient [rad/s] */
} moc_residuals;

/* Judge x (n,) by its record, on the line of self-motion that Z (rows,n) leaves; see moc_opt/control/solution_check.py. */
moc_residuals moc_compute_residuals(const double *record, const double *Z, int rows, const double *x);

/* The smallest self-motion that brings the arm's other motion into the box; zero where none can.
 * See into_the_box in moc_opt/control/null_space.py. */
void moc_retreat(const double *record, const double *Z, int rows, double *x);

#endif
