/* What the arm measures at its incision: how far the shaft passes from the trocar, and how hard it presses there. */
#ifndef MOC_INCISION_H
#define MOC_INCISION_H

#include "moc_constants.h"

enum { MOC_RCM = 0, MOC_FORCE = 1 };

/* Both as mean squares over a time constant; and when, and by how much, each has been above its warning level. */
typedef struct {
    double mean_square[2];  /* RCM error [m^2], force of the trocar [N^2] */
    double largest[2];      /* root mean square while above the warning level [m], [N] */
    int first_tick[2];      /* when it first was; -1: never */
    double point[3];        /* where the trocar was registered last [m] */
    int ticks;              /* since the start; it stays where it cannot count any further */
    int unread;             /* readings of the wrench sensor in a row that were no numbers */
} moc_incision_state;

void moc_incision_start(moc_incision_state *state);

/* Take in a tick; returns MOC_STOP_RCM, MOC_STOP_FORCE or MOC_STOP_WRENCH where it is time to stop, or else 0.
 *
 *   q: (n,) believed pose. trocar: (2,3) as in moc_tick.h.
 *   wrench: (6,) force [N] and torque [Nm] of the tool on its mount, in the tool's axes.
 */
int moc_incision_look(const double *q, const double *trocar, const double *wrench, moc_incision_state *state);

/* Force of the trocar on the shaft [N] where it was registered last; NaN where the reading is no number. */
double moc_incision_force(const double *q, const double *wrench, const moc_incision_state *state);

#endif
