"""The C files that surround the generated equations; `source.py` fills in what starts with a dollar."""

from __future__ import annotations

from string import Template
from textwrap import dedent

HEADER = Template(
    dedent("""\
    /* $title
     *
     * Generated: change the scenario and export again instead of editing. Plain C99; needs libm only.
     * No memory is allocated, nothing is locked, and every tick runs through the same operations.
     * This is the bare tick: it believes every measurement and holds no limit but the torque's. What may be sent to an
     * arm is the torque of moc_safe.h, which has supervisor and guard around it.
     *
     * The numbers in the code came from these settings:
    $constants
     *
     * Arrays are in joint order from the base, matrices row by row, SI units throughout.
     */
    #ifndef MOC_TICK_H
    #define MOC_TICK_H

    #ifdef __cplusplus
    extern "C" {
    #endif

    #define MOC_TICK_JOINTS $n

    /* What moc_tick returns. */
    enum {
        MOC_TICK_OK = 0,         /* torque valid; the third level, if there is one, followed the optimum */
        MOC_TICK_INFEASIBLE = 1, /* torque valid; no joint velocity in the box meets the references: fallback */
        MOC_TICK_SINGULAR = 2,   /* torque valid; the rows of tip and wrist have lost rank: fallback */
        MOC_TICK_BAD_INPUT = $bad_input   /* an input or the torque is not finite: tau and state are unchanged */
    };

    /* What is carried from tick to tick. One for each arm; moc_tick_start fills it. */
    typedef struct {
    $state
    } moc_tick_state;

    /* What the tick knew, for logging. */
    typedef struct {
    $report
    } moc_tick_report;

    /* Forget the past: begin at q, v (as below) with no external torque. */
    void moc_tick_start($start_arguments, moc_tick_state *state);

    /* One control period: measurements and references in, torque out.
     *
    $inputs
     *   state: updated in place.
     *   tau[$n]: ($n,) torque for this period [Nm], the arm's own dynamics included.
     *   report: filled if not NULL; no meaning after MOC_TICK_BAD_INPUT.
     *
     * Returns one of the values above. Inputs may not overlap tau or state.
     */
    int moc_tick($arguments,
                 moc_tick_state *state, double tau[$n], moc_tick_report *report);

    /* The two halves of moc_tick, for whoever puts something between them (moc_safe.c does).
     *
     * moc_tick_levels: from measurements to levels 1 and 2 and the answer of the third, if there is one; the observer
     * in state moves on. Takes numbers as they are: one that is not finite leads to a torque that is not.
     * moc_tick_follow: the torque for the joint velocity x ($n,) in the null space Z (rows,$n), cut at the limits.
     */
    int moc_tick_levels($arguments,
                        moc_tick_state *state, moc_tick_report *report);
    void moc_tick_follow(const double v[$n], const double x[$n], const double *Z, int rows,
                         const moc_tick_report *report, moc_tick_state *state, double tau[$n]);

    #ifdef __cplusplus
    }
    #endif

    #endif
    """)
)

PROLOGUE = dedent("""\
    /* ---- equations, written by CasADi ------------------------------------------------------------------ */

    #if defined(__GNUC__)
    #pragma GCC diagnostic push
    #pragma GCC diagnostic ignored "-Wunused-function"
    #pragma GCC diagnostic ignored "-Wunused-parameter"
    #endif
    #define CASADI_SYMBOL_EXPORT static
    #define casadi_int int
    /* One instruction instead of a call; the equations compare numbers only, never NaN. */
    #undef fmin
    #undef fmax
    #define fmin(x, y) ((x) < (y) ? (x) : (y))
    #define fmax(x, y) ((x) > (y) ? (x) : (y))
    """)

EPILOGUE = dedent("""\
    #undef fmin
    #undef fmax
    #if defined(__GNUC__)
    #pragma GCC diagnostic pop
    #endif
    """)

IMPLEMENTATION = Template(
    dedent("""\
    #include "moc_tick.h"

    #include <math.h>
    #include <stddef.h>
    #include <string.h>

    #include "moc_dense.h"
    #include "moc_level3.h"
    #if MOC_SOLVES
    #include "moc_fallback.h"
    #endif

    $prologue
    $generated
    $epilogue
    /* ---- interface ------------------------------------------------------------------------------------- */

    void moc_tick_start($start_arguments, moc_tick_state *state)
    {
        const double *arg[] = {$start_given};
        double *res[] = {$start_results};
        moc_start_equations(arg, res, NULL, NULL, 0);
    }

    int moc_tick_levels($arguments,
                        moc_tick_state *state, moc_tick_report *report)
    {
        moc_tick_state next;
        double status;
        const double *arg[] = {$given};
        double *res[] = {
            &status, $results,
            $reported,
        };
        moc_tick_equations(arg, res, NULL, NULL, 0);
        memcpy(state->momentum, next.momentum, sizeof next.momentum);
        memcpy(state->external_torque, next.external_torque, sizeof next.external_torque);
        return (int)status;
    }

    void moc_tick_follow(const double v[$n], const double x[$n], const double *Z, int rows,
                         const moc_tick_report *report, moc_tick_state *state, double tau[$n])
    {
        state->share = fmin(1.0, state->share + MOC_FADE);
        memcpy(tau, report->levels, sizeof report->levels);
        moc_third_level(report->M, Z, rows, v, x, state->share, tau);
        for (int i = 0; i < $n; i++) {
            tau[i] -= state->external_torque[i];
            if (MOC_LIMITS_TORQUE && tau[i] > moc_tau_max[i]) /* a NaN passes: it must not become full torque */
                tau[i] = moc_tau_max[i];
            else if (MOC_LIMITS_TORQUE && tau[i] < -moc_tau_max[i])
                tau[i] = -moc_tau_max[i];
        }
        memcpy(state->torque, tau, sizeof state->torque);
    }

    int moc_tick($arguments,
                 moc_tick_state *state, double tau[$n], moc_tick_report *report)
    {
        static const double rest[$n];
        moc_tick_report own, *seen = report ? report : &own;
        moc_tick_state next = *state;
        double torque[$n];
        if ($bad)
            return MOC_TICK_BAD_INPUT;
        int status = moc_tick_levels($inputs, &next, seen);
    $follow
        if (!moc_all_finite($n, torque))
            return MOC_TICK_BAD_INPUT;
        *state = next;
        memcpy(tau, torque, sizeof torque);
        return status;
    }
    """)
)

FOLLOW = {
    "solver": """\
    if (status == MOC_TICK_OK)
        memcpy(next.held_x, seen->x, sizeof seen->x);
    else if (status == MOC_TICK_INFEASIBLE && MOC_FALLBACK == MOC_FALLBACK_LEAST_VIOLATION)
        moc_least_violation(seen->subproblem, seen->x);
    else
        memcpy(seen->x, MOC_FALLBACK == MOC_FALLBACK_HOLD ? next.held_x : rest, sizeof seen->x);
    moc_tick_follow(v, seen->x, seen->null_space, MOC_ROWS, seen, &next, torque);""",
    "damping": "    moc_tick_follow(v, rest, seen->null_space, MOC_ROWS, seen, &next, torque);",
    "levels": "    moc_tick_follow(v, rest, NULL, 0, seen, &next, torque);",
}
"""What follows the levels in the bare tick: the solver's answer, damping of the self-motion, or nothing."""

ARM = Template(
    dedent("""\
    #include "moc_arm.h"

    #include <math.h>
    #include <stddef.h>

    $prologue
    $generated
    $epilogue
    void moc_gravity(const double *q, double *g)
    {
        const double *arg[] = {q};
        double *res[] = {g};
        moc_gravity_equations(arg, res, NULL, NULL, 0);
    }

    void moc_tool_pose(const double *q, double *pose)
    {
        const double *arg[] = {q};
        double *res[] = {pose};
        moc_tool_pose_equations(arg, res, NULL, NULL, 0);
    }
    """)
)

MAIN = Template(
    dedent("""\
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
                    printf("tick %d: an input is not finite\\n", k);
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
        printf("%d ticks, %d with fallback; largest difference from the recorded torque %.1e Nm\\n", TICKS,
               fallbacks, worst);
        printf("one tick: mean %.3f us; with the clock: median %.3f us, p99.9 %.3f us, max %.3f us\\n", mean,
               times[ROUNDS * TICKS / 2], times[ROUNDS * TICKS - ROUNDS * TICKS / 1000],
               times[ROUNDS * TICKS - 1]);
        return worst < 1e-9 && isfinite(total) ? 0 : 1;
    }
    """)
)

SAFE_RECORDING = Template(
    dedent("""\
    /* Consecutive ticks of the Python controller in its guard: q, v, stamp, tip_ref, trocar, wrench, solve_us, tau. */
    enum { SAFE_TICKS = $ticks, SAFE_STOPPED_AT = $stopped_at };
    static const double safe_sent[$n] = {$sent}; /* torque before the first of them */
    static const double safe_recording[SAFE_TICKS][$width] = {
    $rows
    };
    """)
)

RECORDING = Template(
    dedent("""\
    /* Consecutive ticks of the Python controller: q, v, tip_ref, trocar, tau, as in moc_tick.h. */
    enum { TICKS = $ticks };
    static const double recording[TICKS][$width] = {
    $rows
    };
    """)
)
