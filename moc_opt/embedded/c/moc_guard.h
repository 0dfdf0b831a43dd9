/* Limits that hold at every tick, and what a measurement may be. */
#ifndef MOC_GUARD_H
#define MOC_GUARD_H

#include "moc_constants.h"

typedef struct {
    double q[MOC_N], v[MOC_N]; /* the last measurement that was believed, moved on since [rad], [rad/s] */
    double tip_square;         /* mean square of the tip's error over a time constant [m^2] */
    int bad;                   /* measurements in a row that were not believed */
} moc_guard_state;

/* Begin at a finite q, v (n,). */
void moc_guard_start(const double *q, const double *v, moc_guard_state *state);

/* The measurement, or the last believed one moved on where this one cannot be true, is in state->q, v then.
 * Returns MOC_STOP_MEASUREMENT after too many bad ones in a row, or else 0. */
int moc_guard_believe(const double *q, const double *v, moc_guard_state *state);

/* Take note of how far the tip (3,) is from its reference (3,) [m]. Returns MOC_STOP_TIP, or 0. */
int moc_guard_follow(const double *tip, const double *tip_ref, moc_guard_state *state);

/* Walls, speed, torque rate and torque limit on tau (n,), in place; before: the torque of the last tick.
 * Returns at how many joints they acted; -1, and tau as it was, where it is not finite. */
int moc_guard_limit(const double *before, const double *q, const double *v, double *tau);

/* The torque of a damped stop: the weight of the arm in the last pose believed, reached at the torque rate. */
void moc_guard_rest(const double *before, const moc_guard_state *state, double *tau);

#endif
