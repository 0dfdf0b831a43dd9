/* Self-test: the recorded ticks again, compared with the torque recorded in Python, and timed. */
#define _POSIX_C_SOURCE 199309L

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "moc_tick.h"
#include "recording.h"

enum { N = MOC_TICK_JOINTS, V = N, TIP_REF = 2 * N, TROCAR = 2 * N + 9, TAU = 2 * N + 15 };
enum { ROUNDS = 2000 };

static double now_us(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

static int ascending(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int main(void)
{
    static double times[ROUNDS * TICKS];
    moc_tick_state state;
    double tau[N], worst = 0.0, total = 0.0;
    int fallbacks = 0;

    for (int round = 0; round < ROUNDS; round++) {
        moc_tick_start(recording[0], recording[0] + V, &state);
        for (int k = 0; k < TICKS; k++) {
            const double *row = recording[k];
            double begin = now_us();
            int status = moc_tick(row, row + V, row + TIP_REF, row + TROCAR, &state, tau, NULL);
            times[round * TICKS + k] = now_us() - begin;
            if (status == MOC_TICK_BAD_INPUT) {
                printf("tick %d: an input is not finite\n", k);
                return 1;
            }
            fallbacks += round == 0 && status != MOC_TICK_OK;
            for (int i = 0; i < N; i++)
                worst = fmax(worst, fabs(tau[i] - row[TAU + i]));
        }
    }
    double begin = now_us();
    for (int round = 0; round < ROUNDS; round++)
        for (int k = 0; k < TICKS; k++) {
            const double *row = recording[k];
            moc_tick(row, row + V, row + TIP_REF, row + TROCAR, &state, tau, NULL);
            total += tau[0]; /* so that no tick is optimized away */
        }
    double mean = (now_us() - begin) / (ROUNDS * TICKS);

    qsort(times, ROUNDS * TICKS, sizeof times[0], ascending);
    printf("%d ticks, %d with fallback; largest difference from the recorded torque %.1e Nm\n", TICKS,
           fallbacks, worst);
    printf("one tick: mean %.3f us; with the clock: median %.3f us, p99.9 %.3f us, max %.3f us\n", mean,
           times[ROUNDS * TICKS / 2], times[ROUNDS * TICKS - ROUNDS * TICKS / 1000],
           times[ROUNDS * TICKS - 1]);
    return worst < 1e-9 && isfinite(total) ? 0 : 1;
}
