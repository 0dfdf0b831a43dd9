/* Self-test of the whole controller: a recorded run with faults again, compared with the torque recorded in Python. */
#include <math.h>
#include <stdio.h>

#include "moc_safe.h"
#include "safe_recording.h"

enum {
    V = MOC_N,
    STAMP = 2 * MOC_N,
    TIP_REF = STAMP + 1,
    TROCAR = TIP_REF + 9,
    WRENCH = TROCAR + 6,
    SOLVE_US = WRENCH + 6,
    TAU = SOLVE_US + 1
};

#if MOC_HAS_BUDGET
/* The recorded solve time passes between the first and the second call of a tick. */
static double solve_us;
static int asked;

double moc_clock_us(void)
{
    asked = !asked;
    return asked ? 0.0 : solve_us;
}
#endif

int main(void)
{
    moc_safe_state state;
    double tau[MOC_N], worst = 0.0;
    int limited = 0, stopped_at = -1, reason = MOC_RUNNING;

    moc_safe_start(safe_recording[0], safe_recording[0] + V, (int64_t)safe_recording[0][STAMP], safe_sent, &state);
    for (int k = 0; k < SAFE_TICKS; k++) {
        const double *row = safe_recording[k];
#if MOC_HAS_BUDGET
        solve_us = row[SOLVE_US];
#endif
        reason = moc_safe_step(row, row + V, (int64_t)row[STAMP], row + TIP_REF, row + TROCAR, row + WRENCH, &state,
                               tau, NULL);
        limited += state.limited > 0;
        if (reason != MOC_RUNNING && stopped_at < 0)
            stopped_at = k;
        for (int i = 0; i < MOC_N; i++)
            worst = fmax(worst, fabs(tau[i] - row[TAU + i]));
    }
    printf("%d ticks with faults, %d limited, %s", SAFE_TICKS, limited, moc_safe_reason(reason));
    if (stopped_at >= 0)
        printf(" (tick %d)", stopped_at);
    printf("; largest difference from the recorded torque %.1e Nm\n", worst);
    return worst < 1e-9 && stopped_at == SAFE_STOPPED_AT ? 0 : 1;
}
