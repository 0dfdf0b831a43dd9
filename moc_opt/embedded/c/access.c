/* For Python, which knows no structs: not part of the exported folder. */
#include "moc_safe.h"

#if MOC_HAS_BUDGET
/* The time that is to pass between the first and the second call of a tick. */
double moc_solve_us;
static int asked;

double moc_clock_us(void)
{
    asked = !asked;
    return asked ? 0.0 : moc_solve_us;
}
#endif

unsigned long moc_state_size(void)
{
    return sizeof(moc_safe_state);
}

int moc_limited(const moc_safe_state *state)
{
    return state->limited;
}

/* Count of a fault since the start; its own code of the last tick is -1. */
int moc_fault(const moc_safe_state *state, int code)
{
#if MOC_SOLVES
    return code < 0 ? state->supervisor.fault : state->supervisor.counts[code];
#else
    (void)state;
    (void)code;
    return 0;
#endif
}

void moc_incision_seen(const moc_safe_state *state, double largest[2], int first_tick[2])
{
    for (int k = 0; k < 2; k++) {
        largest[k] = state->incision.largest[k];
        first_tick[k] = state->incision.first_tick[k];
    }
}
