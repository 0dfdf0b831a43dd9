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

double moc_replay_count(const double *q, const double *v, const double *wrench, moc_replay_state *state)
{
    double number = add(6, wrench, add(MOC_N, v, add(MOC_N, q, 0.0)));

    if (!(fabs(number) < LARGEST))
        return state->hits;
    state->readings += 1.0;
    int slot = (int)fmod(fabs(number) * FINE, MOC_REPLAY_SLOTS);
    double lag = state->readings - state->at[slot];
    int same = number <= state->number[slot] && number >= state->number[slot];
    if (state->at[slot] > 0.0 && same && lag > 1.0) { /* lag 1: a frozen reading, a sign of its own */
        int again = lag <= state->lag && lag >= state->lag;
        state->hits = again ? state->hits + 1.0 : 1.0;
        state->lag = lag;
    }
    state->number[slot] = number;
    state->at[slot] = state->readings;
    return state->hits;
}
