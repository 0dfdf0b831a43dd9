#include "moc_supervisor.h"

#include <limits.h>
#include <math.h>

#include "moc_answer.h"
#include "moc_fallback.h"
#include "moc_tick.h"

void moc_supervisor_start(moc_supervisor_state *state)
{
    for (int j = 0; j < MOC_N; j++)
        state->good[j] = 0.0;
    for (int k = 0; k < MOC_FAULTS; k++)
        state->counts[k] = 0;
    state->age = 0;
    state->fault = MOC_FAULT_NONE;
}

static int fault_of(int status, const double *record, const double *Z, int rows, const double *answer,
                    double solve_us)
{
    if (status != MOC_TICK_OK)
        return status == MOC_TICK_INFEASIBLE ? MOC_FAULT_INFEASIBLE : MOC_FAULT_FAILED;
    moc_residuals found = moc_compute_residuals(record, Z, rows, answer);
    if (!(found.primal >= 0.0))
        return MOC_FAULT_NOT_FINITE;
    if (MOC_CHECK && (found.primal > MOC_PRIMAL_LIMIT || found.outside > MOC_PRIMAL_LIMIT))
        return MOC_FAULT_OUTSIDE;
    if (MOC_CHECK && (found.natural > MOC_RELATIVE_LIMIT ||
                      (found.off > MOC_OPPOSITE_LIMIT && found.opposite < found.off)))
        return MOC_FAULT_FALSE_OPTIMUM;
    return solve_us > MOC_BUDGET_US ? MOC_FAULT_LATE : MOC_FAULT_NONE;
}

void moc_supervise(int status, const double *record, const double *Z, int rows, const double *answer,
                   double solve_us, moc_supervisor_state *state, double *x)
{
    static const double rest[MOC_N];
    const double *chosen = rest;
    int fault = fault_of(status, record, Z, rows, answer, solve_us);

    state->fault = fault;
    if (fault == MOC_FAULT_NONE) {
        for (int j = 0; j < MOC_N; j++)
            x[j] = state->good[j] = answer[j];
        state->age = 0;
        return;
    }
    if (state->counts[fault] < INT_MAX)
        state->counts[fault]++;
    if (state->age < INT_MAX)
        state->age++;
    if (fault == MOC_FAULT_INFEASIBLE && MOC_FALLBACK == MOC_FALLBACK_LEAST_VIOLATION) {
        moc_least_violation(record, x);
        return;
    }
    if (fault == MOC_FAULT_INFEASIBLE && MOC_FALLBACK == MOC_FALLBACK_DAMPING)
        chosen = rest;
    else if (fault == MOC_FAULT_LATE && MOC_LATE != MOC_LATE_HOLD)
        chosen = MOC_LATE == MOC_LATE_ITERATE ? answer : rest;
    else if (state->age <= MOC_HOLD_TICKS)
        chosen = state->good;
    else if (MOC_KEEP_OFF_LIMITS) {
        moc_retreat(record, Z, rows, x);
        return;
    }
    for (int j = 0; j < MOC_N; j++)
        x[j] = chosen[j];
}
