/* The controller at the end of a wire: receives measurements, ticks, sends torques; see docs/realtime.md.
 *
 * moc_udp HOST PORT reference.bin [KEYFILE]; the key may also stand in MOC_OPT_WIRE_KEY. No heap but what stdio takes
 * before and after the loop. In order: the check of a packet, the link, the tick, the program. */
#define _POSIX_C_SOURCE 200809L
#include <arpa/inet.h>
#include <math.h>
#include <netinet/in.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#ifdef __linux__
#include <sys/prctl.h>
#endif

#include "constants.h"
#include "wire_packets.h"

/* --- the check at the end of every packet: BLAKE2s (RFC 7693) with a key --- */

enum { WIRE_TAG = 16, WIRE_KEY = 32 };

enum { BLOCK = 64, ROUNDS = 10 };

static const uint32_t initial[8] = {0x6A09E667u, 0xBB67AE85u, 0x3C6EF372u, 0xA54FF53Au,
                                  0x510E527Fu, 0x9B05688Cu, 0x1F83D9ABu, 0x5BE0CD19u};
static const uint8_t order[ROUNDS][16] = {
    {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}, {14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3},
    {11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4}, {7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8},
    {9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13}, {2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9},
    {12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11}, {13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10},
    {6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5}, {10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0},
};

static uint32_t turned(uint32_t x, int bits)
{
    return x >> bits | x << (32 - bits);
}

static void mix(uint32_t v[16], int a, int b, int c, int d, uint32_t x, uint32_t y)
{
    v[a] += v[b] + x;
    v[d] = turned(v[d] ^ v[a], 16);
    v[c] += v[d];
    v[b] = turned(v[b] ^ v[c], 12);
    v[a] += v[b] + y;
    v[d] = turned(v[d] ^ v[a], 8);
    v[c] += v[d];
    v[b] = turned(v[b] ^ v[c], 7);
}

/* One block into the state, after `count` bytes with it; the last one is marked. */
static void compress(uint32_t h[8], const uint8_t block[BLOCK], size_t count, int last)
{
    uint32_t v[16], m[16];

    for (int i = 0; i < 16; i++) {
        const uint8_t *at = block + 4 * i;
        m[i] = (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
        v[i] = i < 8 ? h[i] : initial[i - 8];
    }
    v[12] ^= (uint32_t)count; /* packets have fewer than 2^32 bytes */
    if (last)
        v[14] = ~v[14];
    for (int r = 0; r < ROUNDS; r++) {
        const uint8_t *s = order[r];
        for (int i = 0; i < 4; i++)
            mix(v, i, 4 + i, 8 + i, 12 + i, m[s[2 * i]], m[s[2 * i + 1]]);
        for (int i = 0; i < 4; i++)
            mix(v, i, 4 + (i + 1) % 4, 8 + (i + 2) % 4, 12 + (i + 3) % 4, m[s[8 + 2 * i]], m[s[9 + 2 * i]]);
    }
    for (int i = 0; i < 8; i++)
        h[i] ^= v[i] ^ v[i + 8];
}

/* Write the 16 bytes for data of 1 byte or more, with a key of 1 to 32 bytes. */
static void sign(const uint8_t *data, size_t length, const uint8_t *key, size_t key_length, uint8_t tag[WIRE_TAG])
{
    uint32_t h[8];
    uint8_t block[BLOCK] = {0};
    size_t done = 0;

    memcpy(h, initial, sizeof h);
    h[0] ^= 0x01010000u ^ (uint32_t)key_length << 8 ^ (uint32_t)WIRE_TAG;
    memcpy(block, key, key_length);
    compress(h, block, BLOCK, 0);
    for (; length - done > BLOCK; done += BLOCK)
        compress(h, data + done, BLOCK + done + BLOCK, 0);
    memset(block, 0, BLOCK);
    memcpy(block, data + done, length - done);
    compress(h, block, BLOCK + length, 1);
    for (int i = 0; i < WIRE_TAG; i++)
        tag[i] = (uint8_t)(h[i / 4] >> 8 * (i % 4));
}

/* Whether `tag` is that of the data; takes the same time wherever they differ. */
static int is_sound(const uint8_t *data, size_t length, const uint8_t *key, size_t key_length,
                  const uint8_t tag[WIRE_TAG])
{
    uint8_t own[WIRE_TAG], differ = 0;

    sign(data, length, key, key_length, own);
    for (int i = 0; i < WIRE_TAG; i++)
        differ = (uint8_t)(differ | (own[i] ^ tag[i]));
    return differ == 0;
}

/* --- the link: a UDP socket that lets only sound measurements through, and counts the rest --- */

static struct {
    int socket;
    struct sockaddr_in plant;
    uint8_t key[WIRE_KEY];
    size_t key_length;
    uint64_t session; /* 0 until the plant has told it */
    uint32_t counts[WIRE_COUNTERS];
    int64_t newest; /* number of the newest measurement that was taken */
    uint64_t seen;  /* bit i: number newest - i has come */
} wire;

enum { REMEMBERED = 64, TURN_US = 50000 };

/* A steady clock [ns]. */
static int64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

/* Begin to speak with host:port. Returns NULL, or what is wrong. */
static const char *open_link(const char *host, const char *port)
{
    struct timeval turn = {.tv_usec = TURN_US}; /* a call that waits comes back so often, to look at the clock */
    char *end;
    long number = strtol(port, &end, 10);

    memset(&wire.plant, 0, sizeof wire.plant);
    wire.plant.sin_family = AF_INET;
    if (*end || number < 1 || number > 65535 || inet_pton(AF_INET, host, &wire.plant.sin_addr) != 1)
        return "give HOST PORT as numbers: 127.0.0.1 30200";
    wire.plant.sin_port = htons((uint16_t)number);
    wire.socket = socket(AF_INET, SOCK_DGRAM, 0);
    if (wire.socket < 0 || setsockopt(wire.socket, SOL_SOCKET, SO_RCVTIMEO, &turn, sizeof turn) != 0)
        return "the system gives no socket";
    wire.newest = -1;
    return NULL;
}

/* Fill the header of a packet, seal it and send it; one that the system does not take is lost. */
static void send_packet(wire_header *packet, size_t size, int kind, int64_t number)
{
    uint8_t *bytes = (uint8_t *)packet;

    memcpy(packet->magic, WIRE_MAGIC, sizeof packet->magic);
    packet->version = WIRE_VERSION;
    packet->kind = (uint8_t)kind;
    packet->joints = WIRE_JOINTS;
    packet->session = wire.session;
    packet->scenario = WIRE_SCENARIO;
    packet->sequence = number;
    packet->sent_ns = now_ns();
    sign(bytes, size - WIRE_TAG, wire.key, wire.key_length, bytes + size - WIRE_TAG);
    (void)!sendto(wire.socket, packet, size, 0, (const struct sockaddr *)&wire.plant, sizeof wire.plant);
}

/* What is wrong with a datagram, as a counter; -1: nothing. */
static int judge(const uint8_t *bytes, size_t size, const struct sockaddr_in *sender)
{
    const wire_header *head = (const wire_header *)bytes;

    if (size != sizeof(wire_measurement) || head->kind != WIRE_KIND_MEASUREMENT)
        return WIRE_TRUNCATED;
    if (!is_sound(bytes, size - WIRE_TAG, wire.key, wire.key_length, bytes + size - WIRE_TAG))
        return WIRE_FORGED;
    if (memcmp(head->magic, WIRE_MAGIC, sizeof head->magic) || head->version != WIRE_VERSION ||
        head->joints != WIRE_JOINTS || (wire.session && head->session != wire.session))
        return WIRE_FOREIGN;
    if (sender->sin_addr.s_addr != wire.plant.sin_addr.s_addr || sender->sin_port != wire.plant.sin_port)
        return WIRE_FOREIGN;
    return -1;
}

/* The next sound measurement, waiting until `until` [ns]; 0 where none has come. */
static int receive(int64_t until, wire_measurement *found)
{
    do {
        struct sockaddr_in sender;
        socklen_t length = sizeof sender;
        union { /* one byte more than fits: a longer datagram is not cut to a sound one */
            wire_measurement packet;
            uint8_t bytes[sizeof(wire_measurement) + 1];
        } scratch;
        ssize_t size = recvfrom(wire.socket, &scratch, sizeof scratch, 0, (struct sockaddr *)&sender, &length);
        if (size < 0)
            continue; /* the turn is over, or nobody listened where the last packet went */
        int wrong = judge(scratch.bytes, (size_t)size, &sender);
        if (wrong < 0) {
            *found = scratch.packet;
            return 1;
        }
        wire.counts[wrong]++;
    } while (now_ns() < until);
    return 0;
}

/* Judge and count a measurement of a run: 1 where it is new, -1 for the newest once more, 0 for all else. */
static int is_new(const wire_measurement *found)
{
    int64_t number = found->head.sequence, back = wire.newest - number;

    if (found->head.flags != WIRE_RUNNING || number < 0 || number >= WIRE_TICKS) {
        wire.counts[WIRE_FOREIGN]++;
        return 0;
    }
    if (back < 0) {
        wire.counts[WIRE_RECEIVED]++;
        wire.counts[WIRE_MISSED] += (uint32_t)(-back - 1);
        wire.seen = -back < REMEMBERED ? wire.seen << -back | 1 : 1;
        wire.newest = number;
        return 1;
    }
    if (back >= REMEMBERED)
        wire.counts[WIRE_LATE]++;
    else if (wire.seen >> back & 1)
        wire.counts[WIRE_DOUBLED]++;
    else {
        wire.counts[WIRE_REORDERED]++;
        wire.seen |= (uint64_t)1 << back;
    }
    return back == 0 ? -1 : 0;
}

/* --- the tick and the program --- */

enum { PRIORITY = 50, SHORTEST_KEY = 16, REHEARSALS = 200, REPEAT_MS = 100 };

static const int64_t MS = 1000000;
static const char *const counters[WIRE_COUNTERS] = WIRE_COUNTER_NAMES;
static const char *const faults[MOC_FAULTS] = {"none",       "infeasible", "failed", "raised", "malformed",
                                               "not_finite", "outside",    "lied",   "late",   "lost"};

static struct {
    moc_reference tip;
    moc_trocar trocar;
} reference[WIRE_TICKS];
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
    wire.key_length = strcspn(text, "\r\n");
    while (wire.key_length && text[wire.key_length - 1] == ' ')
        wire.key_length--;
    if (wire.key_length < SHORTEST_KEY || wire.key_length > WIRE_KEY)
        return "a key has 16 to 32 bytes, in one line";
    memcpy(wire.key, text, wire.key_length);
    return NULL;
}

/* Send a packet over and over until a measurement comes that waits, or one that does not. */
static int ask(int kind, int waiting, wire_measurement *found)
{
    int64_t until = now_ns() + (int64_t)(1e9 * WIRE_WAIT_S);

    while (now_ns() < until) {
        wire_hello request = {0};
        int64_t again = now_ns() + REPEAT_MS * MS;
        send_packet(&request.head, sizeof request, kind, 0);
        while (receive(again, found))
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
    if (asked) { /* else it stays the one before */
        double *row = report.subproblem;
        for (int i = 0; i < 6; i++)
            put(p->A[i], JOINTS, &row);
        put(p->b, 6, &row);
        put(p->grad_mu, JOINTS, &row);
        put(p->pull, JOINTS, &row);
        put(p->lower, JOINTS, &row);
        put(p->upper, JOINTS, &row);
        put((const double[]){p->c0, p->c1, p->c2, p->rho}, 4, &row);
        put(state.terms.q, JOINTS, &row);
    }
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
    int64_t begin = now_ns(), number = m->head.sequence;
    const moc_input now = {measured(m), reference[number].tip, reference[number].trocar, NULL};
    moc_stop reason = moc_step(&moc_constants, &now, &state, command.tau);

    command.head.flags = WIRE_REPORTED;
    command.limited = (uint32_t)state.watch.limited;
    if (reason != MOC_RUNNING) {
        command.head.flags |= WIRE_STOP;
        strncpy(command.reason, moc_reason(reason), sizeof command.reason - 1);
        moc_guard_hold(moc_constants.guard, moc_constants.arm, m->wrench, &state.watch, command.friction);
    }
    command.control_us = 1e-3 * (double)(now_ns() - begin);
}

static void send_answer(int64_t number)
{
    send_packet(&command.head, sizeof command, WIRE_KIND_COMMAND, number);
    send_packet(&report.head, sizeof report, WIRE_KIND_REPORT, number);
}

/* Begin at a measurement. */
static int start(const wire_measurement *m)
{
    moc_measurement first = measured(m);
    return moc_start(&moc_constants, &first, &state) == MOC_RUNNING;
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
    if ((wrong = read_reference(argv[3])) || (wrong = open_link(argv[1], argv[2])))
        return fail(argv[3], wrong);
    if ((wrong = read_key(argc > 4 ? argv[4] : NULL, argv[1])))
        return fail(argc > 4 ? argv[4] : argv[1], wrong);
    if (!ask(WIRE_KIND_HELLO, 1, &m))
        return fail("no plant answers there", "start `python -m moc_opt plant` with the same robot and key");
    if (m.head.scenario != WIRE_SCENARIO)
        return fail("the plant runs another scenario", "export this program from that one");
    wire.session = m.head.session;
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
            send_packet(&bye.head, sizeof bye, WIRE_KIND_BYE, 0);
            ended = m.head.sequence + 1 >= WIRE_TICKS ? "completed" : "the plant ended the run early";
            break;
        }
        int fresh = is_new(&m);
        if (fresh > 0) {
            tick(&m);
            fill_report();
            ticks++;
        }
        if (fresh)
            send_answer(m.head.sequence);
    } while (receive(now_ns() + (int64_t)(1e9 * WIRE_SILENCE_S), &m));
    if (state.reason != MOC_RUNNING)
        ended = moc_reason(state.reason);
    printf("{\"ended\": \"%s%s\", \"ticks\": %ld, ", state.reason ? "stopped: " : "", ended, ticks);
    print_counts("quality", wire.counts);
    printf(", ");
    print_counts("plant", m.counters);
    printf(", \"system\": {\"scheduling\": \"%s\", \"memory\": \"%s\"}}\n", scheduling, memory);
    return strcmp(ended, "completed") == 0 ? 0 : 3;
}
