#include "moc_replay.h"

#include <math.h>
#include <string.h>

#define SHRINK 0.61803398875
#define FINE 1e9
#define LARGEST 1e6

void moc_replay_start(moc_replay_state *state)
{
    memset(state, 0, sizeof *state);
}

static double add(int count, const double *values, double number)
{
    for (int i = 0; i < count; i++)
        number = SHRINK * number + values[i];
    return number;
}

/* Remember a reading by its number; return how many came before, all of them by the same number of readings. */
static double take_in(double number, int slots, double *numbers, double *at, moc_came_before *before)
{
    if (!(fabs(number) < LARGEST))
        return before->hits;
    before->readings += 1.0;
    int slot = (int)fmod(fabs(number) * FINE, slots);
    double lag = before->readings - at[slot];
    int same = number <= numbers[slot] && number >= numbers[slot];
    if (at[slot] > 0.0 && same && lag > 1.0) { /* lag 1: a frozen reading, a sign of its own */
        int again = lag <= before->lag && lag >= before->lag;
        before->hits = again ? before->hits + 1.0 : 1.0;
        before->lag = lag;
    }
    numbers[slot] = number;
    at[slot] = before->readings;
    return before->hits;
}

double moc_replay_count(const double *q, const double *v, const double *wrench, moc_replay_state *state)
{
    double number = add(6, wrench, add(MOC_N, v, add(MOC_N, q, 0.0)));

    return take_in(number, MOC_REPLAY_SLOTS, state->number, state->at, &state->whole);
}

double moc_replay_lagging(const double *q, const double *v, moc_replay_state *state)
{
    double most = 0.0;

    for (int i = 0; i < MOC_N; i++) {
        double number = SHRINK * q[i] + v[i];
        most = fmax(most, take_in(number, MOC_JOINT_SLOTS, state->joint_number[i], state->joint_at[i], &state->joint[i]));
    }
    return most;
}
