#include "moc_incision.h"

#include <limits.h>
#include <math.h>

#include "moc_arm.h"
#include "moc_dense.h"
#include "moc_safe.h"

#define SHORTEST_DEPTH 0.05 /* nearer to the tip, trocar and touch cannot be told apart [m] */
#define GRAVITY 9.81        /* [m/s^2] */

void moc_incision_start(moc_incision_state *state)
{
    for (int k = 0; k < 2; k++) {
        state->mean_square[k] = state->largest[k] = 0.0;
        state->first_tick[k] = -1;
    }
    for (int i = 0; i < 3; i++)
        state->point[i] = (double)NAN;
    state->ticks = -1;
    state->unread = 0;
}

/* Distance of the shaft's line from the point P [m]. pose: (4,3) axes x, y, z (along the shaft) and tip. */
static double rcm_error(const double *pose, const double *point)
{
    double square = 0.0;
    for (int axis = 0; axis < 2; axis++) {
        double across = 0.0;
        for (int i = 0; i < 3; i++)
            across += pose[3 * axis + i] * (point[i] - pose[9 + i]);
        square += across * across;
    }
    return sqrt(square);
}

/* Force of the trocar on the shaft, across it [N], from the moment at the mount and the depth of the tip. */
static double trocar_force(const double *pose, const double *point, const double *wrench)
{
    double depth = 0.0;
    for (int i = 0; i < 3; i++)
        depth += pose[6 + i] * (pose[9 + i] - point[i]);
    double weight_x = -MOC_TOOL_MASS * GRAVITY * pose[2], weight_y = -MOC_TOOL_MASS * GRAVITY * pose[5];
    double force_x = wrench[0] - weight_x, force_y = wrench[1] - weight_y;
    double whole = sqrt(force_x * force_x + force_y * force_y);
    if (depth >= SHORTEST_DEPTH) {
        double moment_x = wrench[4] - 0.5 * MOC_TOOL_LENGTH * weight_x;
        double moment_y = -wrench[3] - 0.5 * MOC_TOOL_LENGTH * weight_y;
        force_x = (MOC_TOOL_LENGTH * force_x - moment_x) / depth;
        force_y = (MOC_TOOL_LENGTH * force_y - moment_y) / depth;
        double force = sqrt(force_x * force_x + force_y * force_y);
        return whole - MOC_TIP_FORCE > force ? whole - MOC_TIP_FORCE : force;
    }
    return whole;
}

double moc_incision_force(const double *q, const double *wrench, const moc_incision_state *state)
{
    double pose[12];

    moc_tool_pose(q, pose);
    return trocar_force(pose, state->point, wrench);
}

int moc_incision_look(const double *q, const double *trocar, const double *wrench, moc_incision_state *state)
{
    static const int reasons[2] = {MOC_STOP_RCM, MOC_STOP_FORCE};
    double pose[12];
    int reason = 0;

    if (state->ticks < INT_MAX)
        state->ticks++;
    for (int i = 0; i < 3; i++)
        state->point[i] = trocar[i];
    moc_tool_pose(q, pose);
    double distance = rcm_error(pose, trocar), force = trocar_force(pose, trocar, wrench);
    state->mean_square[MOC_RCM] += MOC_INCISION_SHARE * (distance * distance - state->mean_square[MOC_RCM]);
    if (moc_all_finite(1, &force)) {
        state->mean_square[MOC_FORCE] += MOC_INCISION_SHARE * (force * force - state->mean_square[MOC_FORCE]);
        state->unread = 0;
    } else {
        if (state->unread < INT_MAX)
            state->unread++;
        if (state->unread > MOC_PATIENCE_TICKS && (moc_warning[MOC_FORCE] < HUGE_VAL || moc_limit[MOC_FORCE] < HUGE_VAL))
            return MOC_STOP_WRENCH;
    }
    for (int k = 0; k < 2; k++) {
        double value = sqrt(state->mean_square[k]);
        if (value > moc_warning[k]) {
            if (state->first_tick[k] < 0)
                state->first_tick[k] = state->ticks;
            if (value > state->largest[k])
                state->largest[k] = value;
        }
        if (reason == 0 && moc_limit[k] < HUGE_VAL && !(value <= moc_limit[k]))
            reason = reasons[k];
    }
    return reason;
}
