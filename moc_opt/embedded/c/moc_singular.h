/* The third level's subproblem at a straight elbow, where the self-motion has a second freedom. */
#ifndef MOC_SINGULAR_H
#define MOC_SINGULAR_H

#include "moc_null_space.h"

/* Answer the record's subproblem on its eliminated rows: x (n,) [rad/s].
 *
 * Returns MOC_TICK_OK, MOC_TICK_INFEASIBLE, or MOC_TICK_SINGULAR where the rank is doubtful or more than one rank
 * is lost. The optimum is where at most two bounds hold: every such point is looked at. */
int moc_singular_answer(const moc_plane *plane, const double *record, double *x);

#endif
