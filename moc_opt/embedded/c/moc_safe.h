/* The whole controller: measurement in, torque out; the control tick inside its supervisor and guard.
 *
 * One moc_safe_state for each arm. moc_safe_start fills it and forgets all that was; moc_safe_step runs one period.
 * No memory is allocated, nothing is locked, no function calls itself, and every loop has a constant bound.
 * Whatever the inputs and the state hold, the torque is finite and within moc_tau_max.
 */
#ifndef MOC_SAFE_H
#define MOC_SAFE_H

#include "moc_guard.h"
#include "moc_incision.h"
#if MOC_SOLVES
#include "moc_supervisor.h"
#endif
#include "moc_tick.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Why the arm has to be stopped. */
enum {
    MOC_RUNNING = 0,
    MOC_STOP_NOT_STARTED, /* moc_safe_start has not been called, or has refused */
    MOC_STOP_STATE,       /* the state is not what the last step left */
    MOC_STOP_MEASUREMENT, /* measurements not believed, more than MOC_PATIENCE_TICKS in a row */
    MOC_STOP_WRENCH,      /* as many readings of the wrench sensor were no numbers */
    MOC_STOP_RCM,         /* the shaft has been too far from the registered trocar */
    MOC_STOP_FORCE,       /* the trocar has been pressed too hard */
    MOC_STOP_TIP,         /* the tip has been too far off its reference */
    MOC_STOP_TORQUE,      /* the controller's torque is not finite */
    MOC_STOP_LATE,        /* measurements are more than MOC_PATIENCE_TICKS late */
    MOC_STOP_REPEATED,    /* all encoders repeat one reading, as no arm that moves or has noise does */
    MOC_STOP_RAN_AWAY,    /* the encoders' positions do not follow their velocities */
    MOC_STOP_STUCK,       /* an encoder repeats one reading while torque acts on its joint */
    MOC_STOP_UNEXPLAINED, /* the measured motion is not what the torque makes */
    MOC_STOP_REPLAYED,    /* the measurements are a recording: they came before, to the last bit */
    MOC_STOP_ONE_REPEATED, /* one encoder repeats its reading, as its noise does not let it */
    MOC_STOP_WRENCH_REPEATED, /* the wrench sensor does, as its noise does not let it */
    MOC_STOP_LAGGING, /* one encoder lags: its readings came before, to the last bit */
    MOC_REASONS
};

typedef struct {
    moc_tick_state law;
#if MOC_SOLVES
    moc_supervisor_state supervisor;
#endif
    moc_guard_state guard;
    moc_incision_state incision;
    double sent[MOC_N]; /* the last torque that went out [Nm] */
    int limited;        /* joints at which the guard changed it */
    int reason;         /* MOC_RUNNING, or why the arm is stopped: the first reason stays */
    unsigned seal;      /* MOC_SEAL after moc_safe_start */
} moc_safe_state;

#define MOC_SEAL 0x6d6f6331u

#if MOC_HAS_BUDGET
/* Yours to give: a steady clock [us]. The time of the equations counts as that of the solver. */
double moc_clock_us(void);
#endif

/* Reset: begin at measurement number `stamp` of q, v (n,), the torque `sent` (n,) [Nm] acting. Returns MOC_RUNNING, or
 * MOC_STOP_NOT_STARTED and a state that stays stopped, where a number is not finite or `sent` is beyond the limits. */
int moc_safe_start(const double q[MOC_N], const double v[MOC_N], int64_t stamp, const double sent[MOC_N],
                   moc_safe_state *state);

/* One control period: measured q, v (n,), the number of the period in which that was taken, references and trocar as in moc_tick.h, wrench (6,) of the tool on its
 * mount as in moc_incision.h. tau (n,) is what to send, in any case.
 *
 * Returns MOC_RUNNING, or why the arm is stopped. From then on tau carries the arm's weight in the last pose that was
 * believed, and the drives have to brake with MOC_STOP_DAMPING; there is no way back but moc_safe_start.
 * report: what the tick knew, if not NULL; left alone where the arm was stopped before the tick.
 * Nothing may overlap. */
int moc_safe_step(const double q[MOC_N], const double v[MOC_N], int64_t stamp, const double tip_ref[9],
                  const double trocar[6], const double wrench[6], moc_safe_state *state, double tau[MOC_N],
                  moc_tick_report *report);

/* Once a period while the arm is stopped: dry friction (n,) [Nm] that the brakes are to have, zero while the trocar
 * presses the shaft hard; wrench as for moc_safe_step. */
void moc_safe_hold(const double wrench[6], moc_safe_state *state, double friction[MOC_N]);

/* A reason in words. */
const char *moc_safe_reason(int reason);

#ifdef __cplusplus
}
#endif

#endif
