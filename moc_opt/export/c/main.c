/* Self-test: repeat recorded ticks, compare the torques with Python's, time the ticks. The first SOUND ticks have no
 * faults. Python's controller stopped at the tick STOPPED_AT. */
#define _POSIX_C_SOURCE 199309L

#include <stdio.h>
#include <time.h>

#include "recording.h"

enum { ROUNDS = 500 };

static moc_state state;
static double tau[MOC_MAX_JOINTS];

static double now_us(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

static moc_measurement measured(int k, const double *applied)
{
    return (moc_measurement){recorded[k].q, recorded[k].v, recorded[k].stamp, 1, applied, recorded[k].wrench};
}

static void begin(void)
{
    moc_measurement first = measured(0, sent);
    if (moc_start(&moc_constants, &first, &state) != MOC_RUNNING)
        printf("%s\n", moc_reason(state.reason));
}

static moc_stop step(int k)
{
    const moc_input now = {measured(k, NULL), recorded[k].ref, recorded[k].trocar, NULL};
    return moc_step(&moc_constants, &now, &state, tau);
}

int main(void)
{
    double worst = 0.0, total = 0.0, longest = 0.0;
    int limited = 0, stopped_at = -1, same = 1;

    begin();
    for (int k = 0; k < TICKS; k++) {
        if (step(k) != MOC_RUNNING && stopped_at < 0)
            stopped_at = k;
        limited += state.watch.limited > 0;
        for (int i = 0; i < JOINTS; i++) {
            double off = fabs(tau[i] - recorded[k].tau[i]);
            same &= off < 1e-9; /* false for NaN */
            worst = fmax(worst, off);
        }
    }
    printf("%d ticks, %d limited, %s", TICKS, limited, moc_reason(state.reason));
    if (stopped_at >= 0)
        printf(" (tick %d%s)", stopped_at,
               stopped_at == STOPPED_AT ? ", as expected: the last ticks have faults" : "");
    printf("; largest difference from the recorded torque %.1e Nm\n", worst);

    for (int round = 0; round < ROUNDS; round++) {
        begin();
        for (int k = 0; k < SOUND; k++) {
            double from = now_us();
            step(k);
            double us = now_us() - from;
            total += us;
            longest = fmax(longest, us);
        }
    }
    printf("one tick: mean %.3f us, longest %.3f us\n", total / (ROUNDS * SOUND), longest);
    return same && stopped_at == STOPPED_AT ? 0 : 1;
}
