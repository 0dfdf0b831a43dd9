/* Every answer of the third level is checked before the arm follows it; see control/supervisor.py. */
#ifndef MOC_SUPERVISOR_H
#define MOC_SUPERVISOR_H

#include "moc_constants.h"

/* What was wrong with an answer. */
enum {
    MOC_FAULT_NONE = 0,
    MOC_FAULT_INFEASIBLE, /* no joint velocity in the box meets the references */
    MOC_FAULT_FAILED,     /* the rows of tip and wrist have lost rank, and there is no answer */
    MOC_FAULT_NOT_FINITE, /* the answer holds NaN or infinity */
    MOC_FAULT_OUTSIDE,    /* it leaves the box or misses the references by more than the check allows */
    MOC_FAULT_FALSE_OPTIMUM,       /* it is not the optimum */
    MOC_FAULT_LATE,       /* it took longer than its budget */
    MOC_FAULTS
};

typedef struct {
    double good[MOC_N];     /* the last answer that was taken [rad/s] */
    int age;                /* ticks since then */
    int fault;              /* of the last tick */
    int counts[MOC_FAULTS]; /* since the start */
} moc_supervisor_state;

void moc_supervisor_start(moc_supervisor_state *state);

/* The velocity x (n,) that the arm follows [rad/s].
 *
 *   status: MOC_TICK_OK, MOC_TICK_INFEASIBLE or MOC_TICK_SINGULAR, what the solver said.
 *   record: the subproblem; Z (rows,n): its null space; answer (n,): the solver's.
 *   solve_us: how long it took.
 */
void moc_supervise(int status, const double *record, const double *Z, int rows, const double *answer,
                   double solve_us, moc_supervisor_state *state, double *x);

#endif
