/* The controller at the end of a wire: receives measurements, ticks, sends torques; see docs/realtime.md.
 *
 * moc_udp HOST PORT reference.bin [KEYFILE]; the key may also stand in MOC_OPT_WIRE_KEY. No heap but what stdio takes
 * before and after the loop. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#ifdef __linux__
#include <sys/prctl.h>
#endif

#include "constants.h"
#include "wire_link.h"

enum { PRIORITY = 50, SHORTEST_KEY = 16, REHEARSALS = 200, REPEAT_MS = 100 };

static const int64_t MS = 1000000;
static const char *const counters[WIRE_COUNTERS] = WIRE_COUNTER_NAMES;
static const char *const faults[MOC_FAULTS] = {"none",       "infeasible", "failed", "raised", "malformed",
                                               "not_finite", "outside",    "lied",   "late",   "lost"};

static struct {
    moc_reference tip;
    moc_trocar trocar;
} reference[WIRE_TICKS];
static wire_link plant;
static moc_state state;
static wire_command command;
static wire_report report;

static int fail(const char *what, const char *cure)
{
    fprintf(stderr, "moc_udp: %s: %s\n", what, cure);
    return 2;
}

static const char *read_reference(const char *path)
{
    FILE *file = fopen(path, "rb");
    size_t rows = file ? fread(reference, sizeof reference[0], WIRE_TICKS, file) : 0;
    if (file)
        fclose(file);
    return rows == WIRE_TICKS ? NULL : "is not the file that was exported with this program";
}

/* The key of a file or of the environment; without one, that of the loopback. */
static const char *read_key(const char *path, const char *host)
{
    const char *text = getenv("MOC_OPT_WIRE_KEY");
    char line[WIRE_KEY + 8] = "";

    if (path) {
        FILE *file = fopen(path, "r");
        if (!file)
            return "cannot be read";
        text = fgets(line, sizeof line, file) ? line : "";
        fclose(file);
    } else if (!text || !*text) {
        if (strncmp(host, "127.", 4) != 0)
            return "other machines reach that address: give a key file or MOC_OPT_WIRE_KEY";
        text = WIRE_LOOPBACK_KEY;
    }
    plant.key_length = strcspn(text, "\r\n");
    while (plant.key_length && text[plant.key_length - 1] == ' ')
        plant.key_length--;
    if (plant.key_length < SHORTEST_KEY || plant.key_length > WIRE_KEY)
        return "a key has 16 to 32 bytes, in one line";
    memcpy(plant.key, text, plant.key_length);
    return NULL;
}

/* Send a packet over and over until a measurement comes that waits, or one that does not. */
static int ask(int kind, int waiting, wire_measurement *found)
{
    int64_t until = wire_now_ns() + (int64_t)(1e9 * WIRE_WAIT_S);

    while (wire_now_ns() < until) {
        wire_plain request = {0};
        int64_t again = wire_now_ns() + REPEAT_MS * MS;
        wire_send(&plant, &request.head, sizeof request, kind, 0);
        while (wire_receive(&plant, again, found))
            if ((found->head.flags == WIRE_WAITING) == waiting)
                return 1;
    }
    return 0;
}

static void put(const double *from, int count, double **to)
{
    memcpy(*to, from, (size_t)count * sizeof *from);
    *to += count;
}

/* The answer and its subproblem, in the order of moc_opt/qp/layout.py; the third level alone has them. */
static void fill_report(void)
{
    static const char *const statuses[] = {"solved", "infeasible", "numerical"};
    const moc_problem *p = &state.problem;
    int asked = state.reason == MOC_RUNNING && moc_constants.law->third_level;

    for (int i = 0; i < JOINTS; i++) {
        report.x_rad_per_s[i] = asked && state.status == MOC_OK ? state.answer[i] : (double)NAN;
        report.applied_x_rad_per_s[i] = asked ? state.x[i] : (double)NAN;
    }
    for (int i = 0; i < 6; i++)
        report.dual[i] = asked && state.status == MOC_OK ? state.y[i] : (double)NAN;
    double *row = report.subproblem;
    for (int i = 0; i < 6; i++)
        put(p->A[i], JOINTS, &row);
    put(p->b, 6, &row);
    put(p->grad_mu, JOINTS, &row);
    put(p->lower, JOINTS, &row);
    put(p->upper, JOINTS, &row);
    put((const double[]){p->c0, p->c1, p->c2, p->rho}, 4, &row);
    put(state.terms.q, JOINTS, &row);
    strncpy(report.status, asked ? statuses[state.status] : "none", sizeof report.status - 1);
    strncpy(report.fault, asked ? faults[state.fault] : state.reason ? "stopped" : "none", sizeof report.fault - 1);
    report.solve_us = (double)NAN;
}

static moc_measurement measured(const wire_measurement *m)
{
    return (moc_measurement){m->q, m->v, m->stamp, 1, m->commanded, m->wrench};
}

/* One tick of the control side: the torque into `command`. */
static void tick(const wire_measurement *m)
{
    int64_t begin = wire_now_ns(), number = m->head.sequence;
    moc_measurement now = measured(m);
    moc_stop reason =
        moc_step(&moc_constants, &now, &reference[number].tip, &reference[number].trocar, &state, command.tau);

    command.head.flags = WIRE_REPORTED;
    command.limited = (uint32_t)state.watch.limited;
    if (reason != MOC_RUNNING) {
        command.head.flags |= WIRE_STOP;
        strncpy(command.reason, moc_reason(reason), sizeof command.reason - 1);
        moc_guard_hold(moc_constants.guard, moc_constants.arm, m->wrench, &state.watch, command.friction);
    }
    command.control_us = 1e-3 * (double)(wire_now_ns() - begin);
}

static void send_answer(int64_t number)
{
    wire_send(&plant, &command.head, sizeof command, WIRE_KIND_COMMAND, number);
    wire_send(&plant, &report.head, sizeof report, WIRE_KIND_REPORT, number);
}

/* Begin at a measurement. */
static int start(const wire_measurement *m)
{
    moc_measurement first = measured(m);
    return moc_begin_run(&moc_constants, &first, &state) == MOC_RUNNING;
}

static void ask_for_realtime(const char **scheduling, const char **memory)
{
    struct sched_param priority = {.sched_priority = PRIORITY};

    *scheduling = sched_setscheduler(0, SCHED_FIFO, &priority) == 0 ? "SCHED_FIFO 50" : "as other processes";
    *memory = mlockall(MCL_CURRENT | MCL_FUTURE) == 0 ? "locked" : "not locked";
#ifdef __linux__
    prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0);
#endif
}

static void print_counts(const char *name, const uint32_t *counts)
{
    printf("\"%s\": {", name);
    for (int i = 0; i < WIRE_COUNTERS; i++)
        printf("%s\"%s\": %u", i ? ", " : "", counters[i], (unsigned)counts[i]);
    printf("}");
}

int main(int argc, char **argv)
{
    const char *scheduling, *memory, *wrong, *ended = "the plant has been silent";
    wire_measurement m;
    long ticks = 0;

    if (argc < 4 || argc > 5)
        return fail("usage", "moc_udp HOST PORT REFERENCE.bin [KEYFILE]");
    if ((wrong = read_reference(argv[3])) || (wrong = wire_open(&plant, argv[1], argv[2])))
        return fail(argv[3], wrong);
    if ((wrong = read_key(argc > 4 ? argv[4] : NULL, argv[1])))
        return fail(argc > 4 ? argv[4] : argv[1], wrong);
    if (!ask(WIRE_KIND_HELLO, 1, &m))
        return fail("no plant answers there", "start `python -m moc_opt plant` with the same robot and key");
    if (m.head.scenario != WIRE_SCENARIO)
        return fail("the plant runs another scenario", "export this program from that one");
    plant.session = m.head.session;
    m.head.sequence = 0;
    for (int k = 0; k < REHEARSALS; k++) /* touches every page that a tick needs */
        if (!start(&m))
            return fail("the first measurement cannot be used", "look at the plant's sensors");
        else
            tick(&m);
    memset(&command, 0, sizeof command);
    start(&m);
    ask_for_realtime(&scheduling, &memory);
    if (!ask(WIRE_KIND_START, 0, &m))
        return fail("the plant does not begin", "start it again");
    do {
        if (m.head.flags == WIRE_ENDED) {
            static wire_bye bye;
            wire_send(&plant, &bye.head, sizeof bye, WIRE_KIND_BYE, 0);
            ended = m.head.sequence + 1 >= WIRE_TICKS ? "completed" : "the plant ended the run early";
            break;
        }
        int fresh = wire_is_new(&plant, &m);
        if (fresh > 0) {
            tick(&m);
            fill_report();
            ticks++;
        }
        if (fresh)
            send_answer(m.head.sequence);
    } while (wire_receive(&plant, wire_now_ns() + (int64_t)(1e9 * WIRE_SILENCE_S), &m));
    if (state.reason != MOC_RUNNING)
        ended = moc_reason(state.reason);
    printf("{\"ended\": \"%s%s\", \"ticks\": %ld, ", state.reason ? "stopped: " : "", ended, ticks);
    print_counts("quality", plant.counts);
    printf(", ");
    print_counts("plant", m.counters);
    printf(", \"system\": {\"scheduling\": \"%s\", \"memory\": \"%s\"}}\n", scheduling, memory);
    return strcmp(ended, "completed") == 0 ? 0 : 3;
}
