/* Limits that hold at every tick, and what a measurement may be. */
#ifndef MOC_GUARD_H
#define MOC_GUARD_H

#include "moc_constants.h"
#include "moc_motion.h"

typedef struct {
    double q[MOC_N], v[MOC_N]; /* the last measurement that was believed, moved on since [rad], [rad/s] */
    double low[MOC_N], high[MOC_N]; /* where the walls begin [rad] */
    double tip_square;         /* mean square of the tip's error over a time constant [m^2] */
    double press;              /* mean of the trocar's force in a stop [N] */
    double borne;              /* of it, what the brakes were closed on when they had been open for long enough [N] */
    int yields;                /* whether the brakes are open because of it */
    int open;                  /* for how many ticks they have been */
    int bad;                   /* measurements in a row that were not believed */
    moc_motion_state motion;   /* age of the measurements, and whether they show the arm */
} moc_guard_state;

/* Begin at a finite q, v (n,), measurement number `stamp`. The wall of a joint that stands inside it begins there. */
void moc_guard_start(const double *q, const double *v, int64_t stamp, moc_guard_state *state);

/* The measurement, or the last believed one moved on where this one cannot be true, is old or repeats itself, is in
 * state->q, v then. sent (n,): the torque that went out before it; wrench (6,): of the tool on its mount.
 * Returns why the measurements show that the arm has to be stopped, or 0. */
int moc_guard_believe(const double *q, const double *v, int64_t stamp, const double *sent, const double *wrench,
                      moc_guard_state *state);

/* Take note of how far the tip (3,) is from its reference (3,) [m]. Returns MOC_STOP_TIP, or 0. */
int moc_guard_follow(const double *tip, const double *tip_ref, moc_guard_state *state);

/* Walls, speed, torque rate and torque limit on tau (n,), in place, at the state's q, v; before: the torque of the
 * last tick.
 * Returns at how many joints they acted; -1, and tau as it was, where it is not finite. */
int moc_guard_limit(const double *before, const moc_guard_state *state, double *tau);

/* Dry friction (n,) [Nm] of the brakes in a stop; zero while the trocar presses with more than MOC_STOP_YIELD [N].
 * force: of the trocar on the shaft; NaN where it is not known. */
void moc_guard_hold(double force, moc_guard_state *state, double *friction);

/* The torque of a damped stop: the weight of the arm in the last pose believed, reached at the torque rate. */
void moc_guard_rest(const double *before, const moc_guard_state *state, double *tau);

#endif
