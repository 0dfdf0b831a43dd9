/* Old, repeated and frozen measurements: how old each one is, and whether it shows the arm that the torque went to.
 * See control/motion.py and control/motion_kernels.py. */
#ifndef MOC_MOTION_H
#define MOC_MOTION_H

#include <stdint.h>

#include "moc_constants.h"
#include "moc_replay.h"
#include "moc_tick.h"

typedef struct {
    int64_t now;    /* the number that a measurement of this tick would have */
    int64_t newest; /* that of the newest one seen */
    int64_t delay;  /* the ordinary delay in ticks; below zero while it is not known */
    int64_t ticks;  /* since the last reading that was looked at */
    double gap[MOC_N];       /* q - integral of v, forgotten over a time [rad] */
    double peak[MOC_N];      /* largest recent |v| [rad/s] */
    double shown[MOC_N];     /* the last q [rad] */
    double repeats[MOC_N];   /* ticks in a row with the same q; -1 before the first */
    double torque[MOC_N];    /* where all had repeated for the patience [Nm] */
    double integral[MOC_N];  /* of the momentum observer [Nm s] */
    double residual[MOC_N];  /* what it makes of the torque from outside [Nm] */
    double mean[MOC_N];      /* of that [Nm] */
    double at_repeat[MOC_N]; /* the residual where the joint began to repeat [Nm] */
    double unseen[MOC_N];    /* speed that it must have gathered since [rad/s] */
    double exceeded[MOC_N];  /* ticks in a row with the residual far from its mean */
    double speed[MOC_N];     /* the last v [rad/s] */
    double whole[MOC_N];     /* ticks so far with the same q and v as the tick before */
    double readings_twice;   /* readings so far in which all joints had that: old ones under new numbers */
    double told[3];          /* where the tip is told to be [m] */
    double still[3];         /* where that was when all encoders had repeated themselves for the patience [m] */
    double wrench[6];        /* the last one */
    double wrench_repeats;   /* ticks in a row in which it was the same */
    int looked;              /* the first readings, counted */
    int wrench_is_still;     /* whether the wrench ever repeated itself in them: where not, its sensor has noise */
    int weighed;             /* ticks that were weighed; it stays where it cannot count any further */
    moc_replay_state replay; /* the readings so far */
} moc_motion_state;

enum { MOC_FRESH = 0, MOC_REPEAT, MOC_OLD };

/* Begin at measurement number `stamp` of q, v (n,); the next one taken in may be the same. */
void moc_motion_start(const double *q, const double *v, int64_t stamp, moc_motion_state *state);

/* The age of a measurement by its number, once a tick: MOC_FRESH; MOC_REPEAT, not newer than what was seen; MOC_OLD. */
int moc_motion_age(int64_t stamp, moc_motion_state *state);

/* Take in a new reading q, v (n,), wrench (6,), after the torque tau (n,) went out.
 * Returns MOC_STOP_REPLAYED, MOC_STOP_REPEATED, MOC_STOP_RAN_AWAY, MOC_STOP_ONE_REPEATED, MOC_STOP_WRENCH_REPEATED,
 * MOC_STOP_LAGGING, or 0. */
int moc_motion_look(const double *q, const double *v, const double *tau, const double *wrench, moc_motion_state *state);

/* Take in what the model makes of a measurement with velocity v (n,), tau (n,) having acted before it.
 * Returns MOC_STOP_STUCK, MOC_STOP_UNEXPLAINED, or 0. */
int moc_motion_weigh(const moc_tick_report *seen, const double *v, const double *tau, moc_motion_state *state);

#endif
