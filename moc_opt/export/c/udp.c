/* The controller over UDP (docs/realtime.md).
 * Usage: moc_udp HOST PORT reference.bin. HOST and PORT are the plant's address. MOC_OPT_WIRE_KEY holds the key. */
#define _POSIX_C_SOURCE 200809L
#include <arpa/inet.h>
#include <math.h>
#include <openssl/core_names.h>
#include <openssl/crypto.h>
#include <openssl/evp.h>
#include <openssl/params.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>

#include "constants.h"
#include "shared.h"
#include "wire_packets.h"

enum { TAG = 16, LONGEST_KEY = 32, SHORTEST_KEY = 16, TURN_US = 50000, REPEAT_NS = 100000000, PRIORITY = 50 };

/* --- the signature at the end of every packet: BLAKE2s (RFC 7693) with a key --- */

static EVP_MAC_CTX *check; /* holds the key */

static int take_key(const char *key, size_t length)
{
    size_t size = TAG;
    const OSSL_PARAM sizes[] = {OSSL_PARAM_construct_size_t(OSSL_MAC_PARAM_SIZE, &size), OSSL_PARAM_construct_end()};
    EVP_MAC *blake = EVP_MAC_fetch(NULL, "BLAKE2SMAC", NULL);

    check = blake ? EVP_MAC_CTX_new(blake) : NULL;
    return check && EVP_MAC_init(check, (const uint8_t *)key, length, sizes);
}

static int sign(const uint8_t *data, size_t length, uint8_t tag[TAG])
{
    return EVP_MAC_init(check, NULL, 0, NULL) && EVP_MAC_update(check, data, length) &&
           EVP_MAC_final(check, tag, &length, TAG);
}

/* --- the link --- */

static struct {
    int socket;
    struct sockaddr_in plant;
    uint64_t session; /* 0: unknown */
    unsigned ignored;
} wire;

static int64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

/* Returns NULL, or an error message. */
static const char *open_link(const char *host, const char *port)
{
    struct timeval turn = {.tv_usec = TURN_US}; /* timeout of recvfrom */
    const char *key = getenv("MOC_OPT_WIRE_KEY");
    char *end;
    long number = strtol(port, &end, 10);

    wire.plant = (struct sockaddr_in){.sin_family = AF_INET, .sin_port = htons((uint16_t)number)};
    if (*end || number < 1 || number > 65535 || inet_pton(AF_INET, host, &wire.plant.sin_addr) != 1)
        return "give HOST and PORT as numbers, such as 127.0.0.1 30200";
    if ((!key || !*key) && strncmp(host, "127.", 4) != 0)
        return "other machines can reach that address: set a secret key in MOC_OPT_WIRE_KEY";
    key = key && *key ? key : WIRE_LOOPBACK_KEY;
    if (strlen(key) < SHORTEST_KEY || strlen(key) > LONGEST_KEY)
        return "the key in MOC_OPT_WIRE_KEY must have 16 to 32 bytes";
    if (!take_key(key, strlen(key)))
        return "OpenSSL gives no BLAKE2s";
    wire.socket = socket(AF_INET, SOCK_DGRAM, 0);
    if (wire.socket < 0 || setsockopt(wire.socket, SOL_SOCKET, SO_RCVTIMEO, &turn, sizeof turn) != 0)
        return "the system gives no socket";
    return NULL;
}

/* Complete the header, sign and send. Errors of sending are ignored. */
static void send_packet(wire_header *packet, size_t size, uint8_t kind, int64_t number)
{
    uint8_t *bytes = (uint8_t *)packet;

    *packet = (wire_header){"", WIRE_VERSION, kind, WIRE_JOINTS, packet->flags, wire.session, WIRE_SCENARIO, number};
    memcpy(packet->magic, WIRE_MAGIC, sizeof packet->magic); /* without the string's final 0 */
    if (sign(bytes, size - TAG, bytes + size - TAG))
        (void)!sendto(wire.socket, packet, size, 0, (const struct sockaddr *)&wire.plant, sizeof wire.plant);
}

/* Whether a datagram is a correctly signed measurement from the plant, of the session wire.session if this is known. */
static int is_sound(const uint8_t *bytes, size_t size, const struct sockaddr_in *sender)
{
    const wire_header *head = (const wire_header *)bytes;
    uint8_t tag[TAG];

    if (size != sizeof(wire_measurement) || head->kind != WIRE_KIND_MEASUREMENT || !sign(bytes, size - TAG, tag))
        return 0;
    return CRYPTO_memcmp(tag, bytes + size - TAG, TAG) == 0 &&
           memcmp(head->magic, WIRE_MAGIC, sizeof head->magic) == 0 && head->version == WIRE_VERSION &&
           head->joints == WIRE_JOINTS && (!wire.session || head->session == wire.session) &&
           sender->sin_addr.s_addr == wire.plant.sin_addr.s_addr && sender->sin_port == wire.plant.sin_port;
}

/* Wait for a valid measurement until the time `until` [ns], at most TURN_US longer. Returns 0 if none has arrived. */
static int receive(int64_t until, wire_measurement *found)
{
    do {
        struct sockaddr_in sender;
        socklen_t length = sizeof sender;
        union { /* the extra byte reveals longer datagrams */
            wire_measurement packet;
            uint8_t bytes[sizeof(wire_measurement) + 1];
        } scratch;
        ssize_t size = recvfrom(wire.socket, &scratch, sizeof scratch, 0, (struct sockaddr *)&sender, &length);
        if (size < 0)
            continue; /* timeout, or the plant's machine rejected the previous packet */
        if (is_sound(scratch.bytes, (size_t)size, &sender)) {
            *found = scratch.packet;
            return 1;
        }
        wire.ignored++;
    } while (now_ns() < until);
    return 0;
}

/* Repeat a packet until a measurement has (waiting = 1) or lacks (0) the flag WIRE_WAITING. */
static int ask(uint8_t kind, int waiting, wire_measurement *found)
{
    int64_t until = now_ns() + (int64_t)(1e9 * WIRE_WAIT_S);

    while (now_ns() < until) {
        wire_hello request = {0};
        int64_t again = now_ns() + REPEAT_NS;
        send_packet(&request.head, sizeof request, kind, 0);
        while (now_ns() < again && receive(again, found))
            if ((found->head.flags == WIRE_WAITING) == waiting)
                return 1;
    }
    return 0;
}

/* --- the tick --- */

static struct {
    moc_reference tip;
    moc_trocar trocar;
} reference[WIRE_TICKS];
static moc_state state;
static wire_command command;
static unsigned ticks;

static void report(void)
{
    static const char *const statuses[] = {"solved", "infeasible", "numerical"};
    static const char *const faults[MOC_FAULTS] = {"none",       "infeasible", "failed", "raised", "malformed",
                                                   "not_finite", "outside",    "lied",   "late",   "lost"};
    int asked = state.reason == MOC_RUNNING && moc_constants.law->third_level, solved = asked && state.status == MOC_OK;

    for (int i = 0; i < JOINTS; i++) {
        command.x_rad_per_s[i] = solved ? state.answer[i] : (double)NAN;
        command.applied_x_rad_per_s[i] = asked ? state.x[i] : (double)NAN;
    }
    for (int i = 0; i < 6; i++)
        command.dual[i] = solved ? state.y[i] : (double)NAN;
    if (asked) /* otherwise, `command` keeps the previous subproblem */
        moc_copy_problem(&state.problem, JOINTS, command.subproblem, PACK);
    strncpy(command.status, asked ? statuses[state.status] : "none", sizeof command.status - 1);
    strncpy(command.fault, asked ? faults[state.fault] : state.reason ? "stopped" : "none", sizeof command.fault - 1);
    command.solve_us = (double)NAN;
}

static moc_measurement measured(const wire_measurement *m)
{
    return (moc_measurement){m->q, m->v, m->stamp, 1, m->commanded, m->wrench};
}

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
    report();
}

/* --- the program --- */

static int fail(const char *what, const char *cure)
{
    fprintf(stderr, "moc_udp: %s: %s\n", what, cure);
    return 2;
}

/* Answer measurements, beginning with `m`. Returns how the run ended. */
static const char *answer(wire_measurement *m)
{
    int64_t newest = -1;

    do {
        int64_t number = m->head.sequence;
        if (m->head.flags == WIRE_ENDED) {
            static wire_bye bye;
            send_packet(&bye.head, sizeof bye, WIRE_KIND_BYE, 0);
            return number + 1 >= WIRE_TICKS ? "completed" : "the plant ended the run early";
        }
        if (m->head.flags != WIRE_RUNNING || number < 0 || number >= WIRE_TICKS) {
            wire.ignored++;
            continue;
        }
        if (number > newest) {
            ticks++;
            newest = number;
            tick(m);
        }
        if (number == newest) /* also for a repeated measurement, whose answer was lost */
            send_packet(&command.head, sizeof command, WIRE_KIND_COMMAND, number);
    } while (receive(now_ns() + (int64_t)(1e9 * WIRE_SILENCE_S), m));
    return "the plant has been silent";
}

int main(int argc, char **argv)
{
    struct sched_param priority = {.sched_priority = PRIORITY};
    const char *wrong, *ended;
    wire_measurement m;

    if (argc != 4)
        return fail("usage", "moc_udp HOST PORT REFERENCE.bin");
    FILE *file = fopen(argv[3], "rb");
    if (!file || fread(reference, sizeof reference[0], WIRE_TICKS, file) != WIRE_TICKS)
        return fail(argv[3], "is not the file that was exported with this program");
    fclose(file);
    if ((wrong = open_link(argv[1], argv[2])))
        return fail(argv[1], wrong);
    if (!ask(WIRE_KIND_HELLO, 1, &m))
        return fail("no plant answers there", "start `moc-opt plant` with the same robot and key");
    if (m.head.scenario != WIRE_SCENARIO)
        return fail("the plant runs another scenario", "export moc_udp again, from the plant's scenario");
    wire.session = m.head.session;
    moc_measurement first = measured(&m);
    if (moc_start(&moc_constants, &first, &state) != MOC_RUNNING)
        return fail("the first measurement cannot be used", "look at the plant's sensors");
    int real_time = sched_setscheduler(0, SCHED_FIFO, &priority) == 0;
    int locked = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
    if (!ask(WIRE_KIND_START, 0, &m))
        return fail("the plant does not begin", "start it again");
    ended = answer(&m);
    printf("{\"ended\": \"%s%s\", \"ticks\": %u, \"ignored\": %u, ", state.reason ? "stopped: " : "",
           state.reason ? moc_reason(state.reason) : ended, ticks, wire.ignored);
    printf("\"system\": {\"scheduling\": \"%s\", \"memory\": \"%s\"}}\n",
           real_time ? "SCHED_FIFO 50" : "as other processes", locked ? "locked" : "not locked");
    return state.reason == MOC_RUNNING && strcmp(ended, "completed") == 0 ? 0 : 3;
}
