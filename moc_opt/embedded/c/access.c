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

/* What is remembered: mean squares of tip error, RCM error and force, the press in a stop, the supervisor's good
 * answer (n,), and of the motion, one row of n after the other: gap, peak, shown, repeats, torque, integral, residual,
 * mean, at_repeat, unseen, exceeded, speed, whole; then where the tip was told to be (3,), still (3,), and of the wrench how often it
 * was the same, how many first readings were counted, whether it was ever the same in them,
 * and readings that came twice. */
void moc_remembered(const moc_safe_state *state, double *out)
{
    const moc_motion_state *m = &state->guard.motion;
    const double *rows[] = {m->gap,  m->peak,      m->shown,  m->repeats, m->torque, m->integral, m->residual,
                            m->mean, m->at_repeat, m->unseen, m->exceeded, m->speed,  m->whole};
    out[0] = state->guard.tip_square;
    out[1] = state->incision.mean_square[0];
    out[2] = state->incision.mean_square[1];
    out[3] = state->guard.press;
    for (int j = 0; j < MOC_N; j++) {
#if MOC_SOLVES
        out[4 + j] = state->supervisor.good[j];
#else
        out[4 + j] = 0.0;
#endif
        for (int k = 0; k < 13; k++)
            out[4 + MOC_N * (1 + k) + j] = rows[k][j];
    }
    out += 4 + 14 * MOC_N;
    for (int i = 0; i < 3; i++) {
        out[i] = m->told[i];
        out[3 + i] = m->still[i];
    }
    out[6] = m->wrench_repeats;
    out[7] = m->looked;
    out[8] = m->wrench_is_still;
    out[9] = m->readings_twice;
}
